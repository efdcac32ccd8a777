"""Explanations of a policy's choices: probabilities, values, attention.

This is slower than acting, and separate from it.
"""

from collections.abc import Callable
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional
from torch.nn.utils.rnn import pad_sequence

from ..base.observation_layout import MASK, OWN
from .networks import Extractor
from .policy import NEVER, ActorCritic, Networks
from .rows import Observed, Rows
from .torch_settings import FLOAT, INDEX

Array = np.ndarray[Any, Any]
Answer = tuple[list[Array], Tensor | None]  # result of a policy: arrays (batch, ...), and its memory afterwards
Question = Callable[[Networks, Observed, Tensor | None, Tensor | None], Answer]  # then memory, and where episodes begin


class PolicyExplainer:
    """An explainer of a player's policy; created by `Player.explainer`.

    entities: (key of the observation, rows) of each kind of entities in the attention.
    """

    def __init__(self, player: Any) -> None:
        """player: A copy of a Player, with a memory of its own."""
        self._player, self._layout, self.reset = player, player.layout, player.reset
        self.entities = [(kind.key, kind.rows) for kind in self._layout.kinds]

    def __call__(self, observations: dict[str, Array]) -> tuple[Array, Array, Array]:
        """Explain the next action of each agent; memory advances by a step.

        Returns:
            Values float32 (..., agents), of the critic, in the units of its training; NaN without a critic, or with one
            that learned from the state of the world. Probabilities float32 (..., agents, values), of each value of each
            action, one action after the other. Attention float32 (..., agents, rows), the share of each row of
            `entities`, averaged over heads and over the rows that attend; the sum is at most 1. It is 0 for the user's
            own networks.
        """
        values, likely, attention, packed = self._player._ask(observations, self._explain)
        if packed.any():
            attention = np.where(packed[:, None], self._spread(attention, observations), attention)
        leading = observations[OWN].shape[:-1]
        return values.reshape(leading), likely.reshape(*leading, -1), attention.reshape(*leading, attention.shape[1])

    def _explain(self, policy: Networks, seen: Observed, memory: Tensor | None, begins: Tensor | None) -> Answer:
        if self._player.critic and not policy.state:
            logs, values, after = policy(seen, memory, begins)
        else:  # its critic is missing, or needs the state of the world, which play lacks
            logs, after = policy.logs(seen, memory, begins)
            values = torch.full((len(seen),), torch.nan, **FLOAT)
        likely = torch.cat([logs[:size, k].exp() for k, size in enumerate(self._player.header["actions"])]).T
        if isinstance(policy, ActorCritic):
            attention = attended(cast(Extractor, policy.extractors[0]), seen)
        else:
            attention = torch.zeros((len(seen), self._layout.rows), **FLOAT)
        packed = np.full(len(seen), isinstance(seen, Rows))
        return [values.numpy(), likely.numpy(), attention.numpy(), packed], after

    def _spread(self, packed: Array, observations: dict[str, Array]) -> Array:
        """Return the attention of all rows, (batch, rows), from that of visible ones, which come first in `packed`."""
        kinds = self._layout.kinds
        masks = [observations[kind.key + MASK].reshape(len(packed), kind.rows) != 0 for kind in kinds]
        visible = np.concatenate([*masks, np.zeros((len(packed), 0), bool)], 1)
        spread = np.zeros(visible.shape, np.float32)
        spread[visible] = packed[np.arange(visible.shape[1]) < visible.sum(1)[:, None]]
        return spread


def attended(extractor: Extractor, seen: Observed) -> Tensor:
    """Return the attention to each row, (batch, rows), computed by torch.nn.MultiheadAttention itself.

    With Rows, attention is to visible rows only: their shares come first, in order, and then zeros.
    """
    weight, bias = extractor.weight * extractor.scale, extractor.bias
    if isinstance(seen, Rows):
        embedded = extractor._active(seen.entities @ torch.cat([weight, bias]))
        rows = pad_sequence(list(torch.split(embedded, seen.known.tolist())), batch_first=True)
        visible = torch.arange(rows.shape[1], **INDEX) < seen.count[:, None]
        shares = _shares(extractor, rows, visible, (~visible).float() * NEVER)
        return functional.pad(shares, (0, extractor.layout.rows - rows.shape[1]))
    matrices = torch.split(weight, [kind.features for kind in extractor.layout.kinds])
    parts = zip(torch.split(seen.rows, [kind.rows for kind in extractor.layout.kinds], 1), matrices, bias, strict=True)
    known = [torch.tanh(part[:, :, : len(matrix)] @ matrix + own) for part, matrix, own in parts]
    padding = torch.zeros(len(seen), 1, weight.shape[1], **FLOAT)  # a row that all rows see, and attends like them
    visible = functional.pad(seen.seen, (0, 1), value=1.0)
    return _shares(extractor, torch.cat([*known, padding], 1), visible > 0, 1 - visible)[:, :-1]


def _shares(extractor: Extractor, rows: Tensor, visible: Tensor, raised: Tensor) -> Tensor:
    """Return the share of each row in the attention of visible rows: (batch, rows).

    rows: embedded, (batch, rows, width). visible: bool (batch, rows). raised: added to logits, (batch, rows).
    """
    heads, count = extractor.preset.heads, rows.shape[1]
    if not count:
        return rows.new_zeros(len(rows), 0)
    mask = raised[:, None, None].expand(-1, heads, count, -1).reshape(-1, count, count)
    _, weights = extractor.attention(rows, rows, rows, attn_mask=mask)
    shares = (weights * visible[:, :, None]).sum(1) / visible.sum(1, keepdim=True).clamp(min=1)
    return cast(Tensor, shares)

"""Trained policies as functions (observations) -> actions, which every adapter accepts, and their explanations."""

import contextlib
import copy
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np

from outlast.ecs import Clock
from outlast.envs.core.validation import check_count
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import needed
from outlast.envs.rollout.policies import GOLDEN, hashed, mix64
from outlast.envs.rollout.saved import REVEALED, cameras_mode, located
from outlast.envs.scenarios.scenario import Scenario

with needed("train", "saved policies need PyTorch"):
    import torch
    from torch import Tensor
    from torch.nn import functional
    from torch.nn.utils.rnn import pad_sequence

    from ..base import policy_file
    from . import checkpoint

from ..base.errors import TrainingError
from ..base.observation_layout import MASK, OWN, ObservationLayout, scales
from ..base.presets import Form, preset
from .policy import NEVER, ActorCritic, Extractor, Networks, networks_named
from .rows import Observed, Rows, packers_of
from .torch_settings import FLOAT, INDEX, playing

Array = np.ndarray[Any, Any]
Answer = tuple[list[Array], Tensor | None]  # result of a policy: arrays (batch, ...), and its memory afterwards
Question = Callable[[Networks, Observed, Tensor | None, Tensor | None], Answer]  # then memory, and where episodes begin
STREAM = 2  # separates them from other random numbers of the same seed


class Player:
    """The policy of a checkpoint: a function of observations, float32 (..., agents, ...), to actions.

    >>> duel = player.scenario(outlast.variant("ffa_2"))  # with the observations of its training
    >>> env = gymnasium.make("outlast/FreeForAll2-v1", scenario=duel, others=player)

    Actions are int64 (..., agents, actions), sampled by a generator of its own, or the likeliest ones without a seed.
    They are computed on one thread, for any setting of PyTorch, and that setting is restored.

    A policy with a memory keeps the memory of each agent, and `reset` marks where episodes begin. Environments call
    `reset`; in your own loops, `outlast.envs.rollout.memory.told` does. It plays in one batch of worlds at a time.

    Attributes:
        memory: Numbers of the memory of each agent; 0: none.
        state: Numbers of the state of a world that its critic learned from, and that it plays without; 0: none.
        critic: Whether its file has the critic, without which it plays, but its values are unknown.
        networks: Of each policy, the full name of the class of its networks, if it is the user's own; otherwise "".
        reset: None for a policy without a memory. Otherwise a function of the worlds in which episodes begin, a bool
            array with the axes of observations before the axis of agents, (worlds,). It must be called for all worlds
            before the first call of the player.
    """

    def __init__(self, path: str | Path | dict[str, bytes], seed: int | None = 0) -> None:
        """Read a policy. Only tensors and numbers are read; nothing in the file is executed. Raises TrainingError.

        path: A model's name, a file, or the content of the files in a checkpoint. seed: See `load_policy`.
        """
        if isinstance(path, dict):
            self._origin, self.header, weights = "", checkpoint.header_of(path), checkpoint.policies_in(path)
        else:
            self._origin = f"{path}: "
            self.header, weights = checkpoint.read_policies(located(path))
        self.shapes = {key: tuple(shape) for key, shape in self.header["observations"].items()}
        self.layout = ObservationLayout(self.shapes, self.header["fields"])
        self.preset = preset(self.header["preset"])
        self.presets = [preset(name) for name in self.header.get("presets", [self.preset.name] * len(weights))]
        self.packers = packers_of(self.layout, self.presets)
        self.memory: int = self.header["memory"]
        self.state: int = self.header["state"]
        self.reset = self._reset if self.memory else None
        self._begins: Array | None = None  # bool, whether an episode begins in each world
        self._remembered: torch.Tensor | None = None  # float32 (agents of all worlds, memory)
        named: Any = self.header.get("networks", "")
        self.networks: list[str] = named if isinstance(named, list) else [named] * len(weights)
        self.critic = any(self.networks) or any(_is_of_critic(name) for own in weights for name in own)
        try:
            with playing(), torch.inference_mode(False), torch.random.fork_rng(devices=[]):  # for first weights
                self.policies = self._make_policies(weights)
        except TrainingError as error:
            raise TrainingError(f"{path} is broken: {error}") from None
        self.generator = None if seed is None else torch.Generator().manual_seed(seed)
        self._noise: Callable[[], Array] | None = None  # see `key_by`
        self._shifts: tuple[float, ...] = (0.0,)  # see `doubted`

    def _make_policies(self, weights: list[dict[str, torch.Tensor]]) -> list[Networks]:
        """Return the policies. Sizes in run.json are first checked against those of their weights."""
        layout, actions = self.layout, self.header["actions"]
        for what, each in (("networks", self.networks), ("presets", self.presets)):
            if len(each) != len(weights):
                raise TrainingError(f"run.json has {what} of {len(each)} policies, and {len(weights)} are saved")
        kinds = [networks_named(name) for name in self.networks]
        self.team = np.array(self.header["team"])
        self.id = list(self.header["fields"][OWN]).index("id") if len(weights) > 1 else 0
        if not 0 <= self.team.min() <= self.team.max() < len(weights):
            raise TrainingError(f"run.json has a team that does not fit the {len(weights)} policies that are saved")
        inputs = layout.own + sum(kind.features for kind in layout.kinds)
        state = self.state if self.critic else 0
        least = self.preset.width * inputs + self.preset.hidden * (sum(actions) + state) + 3 * self.memory**2
        held = sum(each.numel() for own in weights for each in own.values())
        if {*kinds} == {ActorCritic} and least * len(weights) > held:
            raise TrainingError("the saved weights are too small for the observations, actions and memory in run.json")
        sizes, policies = scales(layout, self.header["fields"]), list[Networks]()
        for kind, chosen, own in zip(kinds, self.presets, weights, strict=True):
            policy = kind(actions, layout=layout, preset=chosen, scales=sizes, memory=self.memory, state=self.state)
            if not self.critic:
                blank = {
                    name: torch.zeros_like(each) for name, each in policy.state_dict().items() if _is_of_critic(name)
                }
                own = blank | own
            checkpoint.load_weights(policy, own)
            policies.append(policy)
        return policies

    def scenario(self, scenario: Scenario) -> Scenario:
        """Return the scenario with the observations of this policy's training."""
        return self.preset.scenario(scenario)

    def check(self, env: SurvivalVectorEnv, counts: bool = True) -> None:
        """Raise TrainingError unless it can play in these worlds. counts: Whether kinds are as large as in training."""
        with self._named():
            self._check(env._reader.views, counts)  # views do not depend on the form for learners
            checkpoint.check_fields(self.header, env)
            known, asked = self.header["actions"], [int(size) for size in env.action_sizes]
            if known != asked:
                raise TrainingError(
                    f"the policy was trained where actions have {known} values, but here they have {asked}: take the "
                    "mechanics of its training, as by --with 'FineMotors()'"
                )
            trained, here = self.preset.cameras, cameras_mode(env.scenario)
            if here not in (None, trained, REVEALED):  # "masked" policies ignore revealed rows, see common_scenario
                raise TrainingError(
                    f"the policy was trained with cameras_mode = '{trained}', here it is '{here}'; "
                    f"make the environment with cameras_mode='{trained}', or of player.scenario(scenario)"
                )

    @contextlib.contextmanager
    def _named(self) -> Iterator[None]:
        """Add the name of the file to errors, since other policies may play, too."""
        try:
            yield
        except TrainingError as error:
            raise TrainingError(f"{self._origin}{error}") from None

    def __call__(self, observations: dict[str, Array]) -> Array:
        """Choose the actions for these observations. Raises TrainingError if they do not fit, or without `reset`."""
        (logs,) = self._ask(observations, _logs)
        with playing():
            batch_last, uniform = torch.from_numpy(logs).permute(1, 2, 0), None  # the likeliest actions
            if self._noise is not None:
                uniform = torch.from_numpy(self._noise())
            elif self.generator is not None:
                uniform = torch.rand((len(logs), logs.shape[2]), generator=self.generator, **FLOAT)
            numbers = [uniform if uniform is None else uniform + shift for shift in self._shifts]
            actions: Array = torch.cat([self.policies[0].choose(batch_last, each) for each in numbers], 1).numpy()
        return actions.reshape(*observations[OWN].shape[:-1], actions.shape[1])

    def key_by(self, env: SurvivalVectorEnv, agents: Any) -> None:
        """Sample actions by the keys of worlds from now on, see EpisodeNoise. agents: Those that it plays in each."""
        self._noise = EpisodeNoise(env, agents)

    def doubted(self, slack: float) -> None:
        """Return three choices from now on: for numbers decreased by `slack`, as drawn, and increased by it.

        The choice of another machine, whose cumulative probabilities differ by less, lies between the first and the
        last. Actions become int64 (..., agents, 3 * actions).
        """
        self._shifts = (-slack, 0.0, slack)

    @property
    def remembered(self) -> Array:
        """The memories of all agents after the last call, float32 (agents of all worlds, memory)."""
        assert self._remembered is not None, "it has not been called yet"
        return self._remembered.numpy()

    def explainer(self) -> "PolicyExplainer":
        """Return an explainer of the policy, with a memory of its own; for outlast.record(policy=player)."""
        own = copy.copy(self)
        own._begins = own._remembered = None
        own.reset = own._reset if self.memory else None
        return PolicyExplainer(own)

    def _reset(self, where: Array) -> None:
        """See `reset`."""
        where = np.asarray(where, bool)
        if where.all():
            self._begins, self._remembered = where.copy(), None
        elif self._begins is not None and self._begins.shape == where.shape:
            self._begins |= where
        else:
            known = None if self._begins is None else self._begins.shape
            with self._named():
                raise TrainingError(
                    f"episodes begin in some of {where.shape} worlds, and the policy has a memory of {known}: "
                    "tell it of all worlds first, by player.reset(numpy.ones(worlds, bool))"
                )

    def _recall(self, worlds: tuple[int, ...], agents: int) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the memory of agents, and where it is reset. Raises TrainingError."""
        known = None if self._begins is None else self._begins.shape
        if self._begins is None or known != worlds:
            raise TrainingError(
                f"the policy has a memory of {known} worlds, but observes {worlds}: tell it where episodes begin, by "
                "player.reset(numpy.ones(worlds, bool)) before the first call, or let "
                "outlast.envs.rollout.memory.told(player, env) do it"
            )
        begins = torch.from_numpy(np.repeat(self._begins.ravel(), agents))
        self._begins[...] = False
        if self._remembered is None:
            self._remembered = torch.zeros(len(begins), self.memory, **FLOAT)
        if len(self._remembered) != len(begins):
            raise TrainingError(
                f"the policy has a memory of {len(self._remembered)} agents, but observes {len(begins)}: "
                "load the file again for these"
            )
        return self._remembered, begins

    def _ask(self, observations: dict[str, Array], question: Question) -> list[Array]:
        """Ask the policy, or each about its own agents, and advance memory. Return arrays (batch, ...)."""
        memory, begins = None, None
        with self._named():
            self._check(observations)
            if self.memory:
                leading = observations[OWN].shape[:-1]
                memory, begins = self._recall(leading[:-1], math.prod(leading[-1:]))
        with playing():
            seen = {form: packer(observations) for form, packer in self.packers.items()}
            return self._answers(seen, memory, begins, question)

    def _answers(
        self, seen: dict[Form, Observed], memory: torch.Tensor | None, begins: torch.Tensor | None, question: Question
    ) -> list[Array]:
        if len(self.policies) == 1:
            (whole,) = seen.values()
            answers, self._remembered = question(self.policies[0], whole, memory, begins)
            return answers
        joined: list[Array] = []
        number = self.team[next(iter(seen.values())).own[:, self.id].numpy().astype(int)]
        for k in np.unique(number):
            where = torch.from_numpy(np.flatnonzero(number == k))
            own = (None, None) if memory is None or begins is None else (memory[where], begins[where])
            policy = self.policies[k]
            answers, after = question(policy, seen[policy.preset.form].select(where), *own)
            if memory is not None and after is not None:
                memory[where] = after
            joined = joined or [np.zeros((len(number), *answer.shape[1:]), answer.dtype) for answer in answers]
            for every, answer in zip(joined, answers, strict=True):
                every[number == k] = answer
        return joined

    def _check(self, observations: dict[str, Array], counts: bool = True) -> None:
        given = {key: array.shape[array.ndim - len(self.shapes.get(key, ())) :] for key, array in observations.items()}
        if (given if counts else _rows(given)) != (self.shapes if counts else _rows(self.shapes)):
            raise TrainingError(
                f"the policy was trained on {self.header['scenario']['name']} and does not fit here: "
                f"{_differences(self.shapes, given)}; give it a scenario with the same mechanics and counts"
            )


def _is_of_critic(name: str) -> bool:
    return name.startswith(policy_file.CRITIC)


def _logs(policy: Networks, seen: Observed, memory: torch.Tensor | None, begins: torch.Tensor | None) -> Answer:
    """Return the log probabilities of actions, float32 (batch, values, actions)."""
    logs, after = policy.logs(seen, memory, begins)
    return [logs.permute(2, 0, 1).numpy()], after


def _rows(shapes: dict[str, tuple[int, ...]]) -> dict[str, tuple[int, ...]]:
    """Return the shapes of one row of each kind."""
    return {key: shape[-1:] for key, shape in shapes.items() if not key.endswith("_mask")}


def _differences(trained: dict[str, tuple[int, ...]], here: dict[str, tuple[int, ...]]) -> str:
    """Describe the difference between the shapes of an agent's observations; masks only if nothing else differs."""
    own = [{key: shape for key, shape in shapes.items() if not key.endswith("_mask")} for shapes in (trained, here)]
    if own[0] == own[1]:  # as in synthetic observations: only the masks differ
        own = [trained, here]
    known, found = own
    more, gone = sorted(found.keys() - known.keys()), sorted(known.keys() - found.keys())
    parts = [f"it was trained without {', '.join(more)}"] if more else []
    parts += [f"it needs {', '.join(gone)}"] if gone else []
    for key in sorted(known.keys() & found.keys()):
        if known[key] != found[key]:
            sizes = (" x ".join(map(str, shape)) or "one number" for shape in (known[key], found[key]))
            parts.append("{} is {} in training but {} here".format(key, *sizes))
    return "; ".join(parts)


def weights_of(path: Path, critic: bool = True) -> tuple[policy_file.Header, list[dict[str, Array]]]:
    """Return run.json of a saved policy, and the weights of each of its policies by name. Raises TrainingError."""
    player = Player(path)
    left_out = () if any(player.networks) or (critic and player.critic) else policy_file.CRITIC
    return player.header, [
        {name: values.numpy() for name, values in policy.state_dict().items() if not name.startswith(left_out)}
        for policy in player.policies
    ]


def load_policy(path: str | Path, seed: int | None = 0) -> Player:
    """Load a saved policy, to play with or against: a model by its name, or a file or folder of `outlast train`.

    >>> env = gymnasium.make("outlast/Teams3-v1", others=outlast.load_policy("teams_3/fast-0"))
    >>> env = gymnasium.make("outlast/FreeForAll2-v1", others=outlast.load_policy("runs/duel/steps_0001000000.zip"))

    Args:
        path: The name of a model, of which `outlast models` prints a list; the file, `steps_0001000000.zip` or
            FILE.safetensors; or the folder of a run, for its newest checkpoint. The name of a model is never
            read as a path: name the folder "./teams_3/fast-0", or as a pathlib.Path.
        seed: Seed of the generator that samples actions; None: the likeliest actions.

    Returns:
        A function of observations, float32 (..., agents, ...) by key, to actions, int64 (..., agents, actions); see
        Player.

    Raises:
        TrainingError: The file cannot be read, or is damaged.
        UsageError: A folder does not hold a single run, or a model cannot be fetched.
        ValueError: The seed is not valid.
    """
    if seed is not None:
        check_count("seed", seed, 0, 2**64 - 1)
    return Player(path, seed)


class PolicyExplainer:
    """An explainer of a player's policy; created by `Player.explainer`. It is slower than acting.

    entities: (key of the observation, rows) of each kind of entities in the attention.
    """

    def __init__(self, player: Any) -> None:
        self._player, self._layout, self.reset = player, player.layout, player.reset
        self.entities = [(kind.key, kind.rows) for kind in self._layout.kinds]

    def __call__(self, observations: dict[str, Array]) -> tuple[Array, Array, Array]:
        """Explain the next action of each agent; memory advances by a step.

        Returns:
            Values float32 (..., agents), of the critic, in the units of its training; NaN without a critic, or with one
            that learned from the state of the world. Probabilities float32 (..., agents, values), of each value of each
            action, one action after the other. Attention float32 (..., agents, rows), the share of each row of
            `entities`, averaged over heads and over the rows that attend; 0 for the user's own networks.
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
    """Return the attention to each row, (batch, rows), by torch.nn.MultiheadAttention; of Rows, visible ones first."""
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
    """Return the share of each row, (batch, rows), in the attention of visible rows; raised: added to logits."""
    heads, count = extractor.preset.heads, rows.shape[1]
    if not count:
        return rows.new_zeros(len(rows), 0)
    mask = raised[:, None, None].expand(-1, heads, count, -1).reshape(-1, count, count)
    _, weights = extractor.attention(rows, rows, rows, attn_mask=mask)
    shares = (weights * visible[:, :, None]).sum(1) / visible.sum(1, keepdim=True).clamp(min=1)
    return cast(Tensor, shares)


class ActionNoise:
    """Uniform numbers for every action of every agent: a function of (seed, step, world, agent, action).

    A world is therefore played the same way in every batch, and a resumed run needs no saved state. Each agent has its
    own SplitMix64 generator (Steele, Lea and Flood, OOPSLA 2014).
    """

    def __init__(self, seed: int, worlds: Array, agents: int, actions: int) -> None:
        """Derive keys. worlds: Their numbers, int (worlds,). agents, actions: How many each world and agent has."""
        (key,) = np.random.SeedSequence([seed, STREAM]).generate_state(1, np.uint64)
        world = mix64(key + worlds.astype(np.uint64))[:, None]
        self._start = mix64(world + np.arange(agents, dtype=np.uint64)).reshape(-1, 1)
        self._actions = actions

    def __call__(self, step: int) -> Array:
        """Return the numbers of a step, float32 (agents of all worlds, actions), from 0 to below 1."""
        place = np.arange(step * self._actions, (step + 1) * self._actions, dtype=np.uint64)
        return _uniform(mix64(self._start + place * GOLDEN))


class EpisodeNoise:
    """Uniform numbers for every action of some agents: a function of (seed, world, episode, tick, agent, action).

    An episode that is repeated, or continued from a saved state, is therefore played the same way.
    """

    def __init__(self, env: SurvivalVectorEnv, agents: Any) -> None:
        """Keep `env`, whose worlds are read at every call. agents: Indices of the agents, integers (agents,)."""
        self._clock, self._agents = env.worlds[Clock], np.asarray(agents, np.uint64)[None]
        self._actions = GOLDEN * np.arange(1, len(env.action_sizes) + 1, dtype=np.uint64)

    def __call__(self) -> Array:
        """Return the numbers of the next step, float32 (agents of all worlds, actions), from 0 to below 1."""
        clock = self._clock
        words = hashed(np.uint64(STREAM), clock.seed, clock.world, clock.episode, clock.tick, self._agents)
        return _uniform(mix64(words.reshape(-1, 1) + self._actions))


def _uniform(words: Array) -> Array:
    """Turn uniform uint64 numbers into float32 of the same shape, from 0 to below 1."""
    return (words >> np.uint64(40)).astype(np.float32) * np.float32(2**-24)

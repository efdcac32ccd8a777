"""The policies that play in an evaluation: by name, from checkpoints or folders of runs, or as functions."""

import copy
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch

from outlast.envs.core.validation import checked_actions
from outlast.envs.core.vector_env import Actions, Arrays, SurvivalVectorEnv
from outlast.envs.rollout.lineup import OWN_AS, checked_entries, is_own, maker
from outlast.envs.rollout.memory import check_memories, told
from outlast.envs.rollout.policies import POLICIES, Policy
from outlast.envs.rollout.saved import SAVED_AS, is_saved, models, newest, runs_in, similar, text_of

from ..base.errors import TrainingError
from ..policies.player import EpisodeNoise, Player
from .match import Act, AgentIndices

Given = str | Path | Policy  # a name of POLICIES, a checkpoint, a folder of a run or around several, or a function


class Contender:
    """A policy with a label that can be part of file names.

    label: Name in tables and files. text: Source: a name, the path of its checkpoint, or the name of a function.
    player: Player of a checkpoint; None for any other policy.
    """

    def __init__(self, label: str, policy: str | Policy, seed: int | None = None) -> None:
        """Raise TrainingError for what is not a policy. seed: In place of that of `act`, for a user's function."""
        self.label, self.player = label, policy if isinstance(policy, Player) else None
        self.text = policy if isinstance(policy, str) else getattr(policy, "__name__", type(policy).__name__)
        self._function = None if isinstance(policy, (str, Player)) else policy
        if isinstance(policy, str) and not (policy in POLICIES or is_own(policy)):
            self.player = Player(policy)
        self._make, self._seed = maker(self.player or policy), seed

    @property
    def foreign(self) -> bool:
        """Return whether it is a function of the user's, which others cannot ask what it would do."""
        return self.player is None and self.text not in POLICIES

    def check(self, env: SurvivalVectorEnv) -> None:
        """Raise TrainingError unless the policy can play in these worlds."""
        if self.player is not None:
            self.player.check(env)

    def act(self, env: SurvivalVectorEnv, seed: int, *, keyed: bool = False, slack: float = 0.0) -> Act:
        """Return the function that plays the policy.

        seed: Seed of its random generator. keyed: Whether a saved policy draws by the keys of worlds instead, see
        EpisodeNoise: then the course of a world does not depend on other worlds. slack: If not 0, a saved policy
        returns three choices side by side, see Player.doubted.
        """
        player = self.player
        if player is None:
            play = self._make(env, seed if self._seed is None else self._seed)
            if self._function is not None or is_own(self.text):
                play = self._checked(play, env)
            return lambda seen, indices: np.asarray(play(seen)[indices])
        player = copy.copy(player)  # the caller's player must not change
        player.reset = player._reset if player.memory else None
        if player.generator is not None:  # without a generator it takes the likeliest actions
            player.generator = torch.Generator().manual_seed(seed)
        if slack:
            player.doubted(slack)
        noise = EpisodeNoise(env, np.arange(env.num_agents)) if keyed and player.generator else None
        if player.memory:  # memory advances for all agents, not only for those it plays
            player._noise, remembering = noise, told(player, env)
            return lambda seen, indices: np.asarray(remembering(seen)[indices])

        def act(seen: Arrays, indices: AgentIndices) -> Actions:
            if noise is not None:
                player._noise = lambda: noise().reshape(env.num_worlds, env.num_agents, -1)[indices]
            return player({key: values[indices] for key, values in seen.items()})

        return act

    def _checked(self, function: Policy, env: SurvivalVectorEnv) -> Policy:
        """Return a user's function, whose actions are checked."""
        shape, playing = (env.num_worlds, env.num_agents, len(env.action_sizes)), told(function, env)
        what, axes = f"the actions that {self.label} returned", "(worlds, agents, actions)"
        keys = [key for key, _ in env.action_columns]

        def act(seen: Arrays) -> Actions:
            own = {key: values.copy() for key, values in seen.items()}  # copies: the function may keep them
            return checked_actions(playing(own), shape, env.action_sizes, what=what, axes=axes, keys=keys)

        return act


def contenders(given: Given | Sequence[Given] | Mapping[str, Given]) -> list[Contender]:
    """Return a contender for each policy; a folder of a run or several runs stands for each run's newest checkpoint.

    given: Names, paths, functions; a mapping gives their labels; otherwise labels are made from names and paths. Raises
    TrainingError, or UsageError: none are given, one is named twice, or is not a policy or a folder with a checkpoint.
    """
    if isinstance(given, (str, Path)) or callable(given):
        given = [given]
    if not given:
        raise TrainingError("policies are empty: name some, as in ('scripted', 'runs/duel')")
    if isinstance(given, Mapping):
        found = list[Contender]()
        for label, policy in given.items():
            (_, own), *more = _expanded(policy)
            if more:
                raise TrainingError(f"{label}: {policy} holds {1 + len(more)} runs: name one of them")
            found.append(Contender(re.sub(r"[^\w.]+", "-", label), own))
        names = [contender.label for contender in found]
        if twice := [name for name in names if names.count(name) > 1]:
            raise TrainingError(f"{', '.join(given)}: two get the name {twice[0]} in files; choose other labels")
        check_memories([contender._function for contender in found])
        return found
    chosen = [each for policy in given for each in _expanded(policy)]
    named = labels([text for text, _ in chosen])
    return [Contender(label, policy) for label, (_, policy) in zip(named, chosen, strict=True)]


def _expanded(policy: Given) -> list[tuple[str, str | Policy]]:
    """Return pairs of a text to make a label from, and a policy, never a folder."""
    if not isinstance(policy, (str, Path)):
        checked_entries([(policy, 1)])
        return [(getattr(policy, "__name__", type(policy).__name__), policy)]
    place, text = Path(policy), text_of(policy)
    if text in (*POLICIES, *models()) or not place.is_dir():
        if len(place.parts) > 1 and not (is_saved(text) or is_own(text)):
            raise TrainingError(
                f"{text} is not a saved policy: {similar(text)}it must be {SAVED_AS}, or {OWN_AS} of your own"
            )
        checked_entries([(text, 1)])
        return [(text, text)]
    return [(f"{folder}/", str(newest(folder))) for folder in runs_in(place)]


def labels(texts: Sequence[str]) -> list[str]:
    """Return a unique label for each text; for a path, the shortest unique end. Raises TrainingError."""
    parts_of, ends = [_parts(text) for text in texts], list[list[str]]()
    if len(set(parts_of)) < len(parts_of):
        raise TrainingError(f"a policy is named twice: {', '.join(texts)}")
    for parts in parts_of:
        joined = ("-".join(parts[-length:]) for length in range(1, len(parts) + 1))
        ends.append([re.sub(r"[^\w.]+", "-", name).strip("-") for name in joined])
    others = [{name for other in ends if other is not own for name in other} for own in ends]
    return [next((name for name in own if name not in taken), own[-1]) for own, taken in zip(ends, others, strict=True)]


def _parts(text: str) -> tuple[str, ...]:
    """Return parts of a path, without the ending of a file; a name unchanged."""
    if text in POLICIES or is_own(text) or not (is_saved(text) or re.search(r"[/\\]", text)):
        return (text,)
    if text in models():
        return tuple(text.split("/"))
    path = Path(text).resolve()
    return path.parts if text.endswith("/") else path.with_suffix("").parts

"""Cross-play: every policy against every other and itself, with standard errors."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from outlast.envs.core.agents import fewest_agents
from outlast.envs.core.make import make_vec
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.rollout.memory import told
from outlast.envs.rollout.policies import POLICIES
from outlast.envs.rollout.saved import common_scenario
from outlast.envs.rollout.sides import ROLES
from outlast.envs.scenarios.scenario import Scenario

from ..errors import TrainingError
from ..player import Player
from .matches import Act, Match, MatchResults
from .ratings import elo, linked

Array = np.ndarray[Any, Any]
Estimates = dict[str, tuple[float, float]]  # mean and standard error by name


class Contender:
    """A policy with a label that can be part of file names. player: that of a checkpoint; None: one of POLICIES."""

    def __init__(self, label: str, text: str) -> None:
        """text: a name, or the path of a checkpoint. Raises TrainingError."""
        self.label, self.text = label, text
        self.player = None if text in POLICIES else Player(text)

    def check(self, env: SurvivalVectorEnv) -> None:
        """Check that it can play in these worlds. Raises TrainingError."""
        if self.player is not None:
            self.player.check(env)

    def act(self, env: SurvivalVectorEnv, seed: int) -> Act:
        """The function that plays it, with a generator of that seed."""
        player = self.player
        if player is None:
            whole = POLICIES[self.text](env, seed)
            return lambda seen, indices: np.asarray(whole(seen)[indices])
        player.generator = torch.Generator().manual_seed(seed)
        if player.memory:  # it goes on for all agents, whoever of them it plays
            remembering = told(player, env)
            return lambda seen, indices: np.asarray(remembering(seen)[indices])
        return lambda seen, indices: player({key: values[indices] for key, values in seen.items()})


def contenders(texts: Sequence[str]) -> list[Contender]:
    """A contender for each name or path. Raises TrainingError, also where one is named twice."""
    return [Contender(label, text) for label, text in zip(labels(texts), texts, strict=True)]


def labels(texts: Sequence[str]) -> list[str]:
    """A unique label for each: of paths, as few parts from the end as it takes. Raises TrainingError."""
    whole = [(text,) if text in POLICIES else Path(text).resolve().with_suffix("").parts for text in texts]
    if len(set(whole)) < len(whole):
        raise TrainingError(f"a policy is named twice: {', '.join(texts)}")
    return [_shortest(parts, [other for other in whole if other != parts]) for parts in whole]


def _shortest(parts: tuple[str, ...], others: list[tuple[str, ...]]) -> str:
    taken = {_joined(other, length) for other in others for length in range(1, len(other) + 1)}
    found = (_joined(parts, length) for length in range(1, len(parts) + 1))
    return next((name for name in found if name not in taken), _joined(parts, len(parts)))


def _joined(parts: tuple[str, ...], length: int) -> str:
    return re.sub(r"[^\w.]+", "-", "-".join(parts[-length:])).strip("-")


@dataclass(frozen=True)
class Pairing:
    """A pairing that was played: the indices of its policies, which may be the same one, and all of its episodes."""

    pair: tuple[int, int]
    results: MatchResults

    def estimates(self, role: int) -> Estimates:
        """Estimates of the policy in that role. NaN where there was nothing to measure."""
        return {name: ratio(figure[:, :, role].reshape(-1, 2)) for name, figure in self.results.figures.items()}

    def won_drawn_lost(self) -> tuple[int, int, int]:
        """Episodes that the first policy won, that were drawn, and that it lost."""
        wins = self.results.figures["wins"][:, :, 0, 0]
        return int((wins == 1).sum()), int((wins == 0.5).sum()), int((wins == 0).sum())


class Evaluation:
    """Cross-play in `worlds` worlds at once.

    Each pairing plays `episodes`, or a few more: every world plays as many, and each policy plays each side as often. A
    pairing's numbers are a function of the seed and of the places of its two policies in the list; threads make no
    difference. Raises ScenarioError, TrainingError.
    """

    def __init__(
        self,
        scenario: Scenario,
        chosen: Sequence[Contender],
        *,
        episodes: int = 1000,
        worlds: int = 64,
        seed: int = 0,
        threads: int = 1,
    ) -> None:
        players = [contender.player for contender in chosen if contender.player is not None]
        self.scenario, self.chosen, self.seed = common_scenario(scenario, players), list(chosen), seed
        self.each = -(-episodes // worlds)
        self.each += self.each * worlds % ROLES  # or one assignment of sides is played more often
        options: dict[str, Any] = {"autoreset_mode": "Disabled", "copy": False, "check_actions": False}
        self.env = make_vec(self.scenario, worlds, seed=seed, threads=threads, **options)
        try:
            self._check()
        except BaseException:
            self.close()
            raise
        self.pairings: list[Pairing] = []

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """All pairings, in the order in which they are played; of each policy with itself, too."""
        return [(i, j) for j in range(len(self.chosen)) for i in range(j + 1)]

    @property
    def episodes(self) -> int:
        """Episodes of each pairing."""
        return self.each * self.env.num_worlds

    def play_pair(self, pair: tuple[int, int], progress: Callable[[int], None] = lambda episodes: None) -> Pairing:
        """Play a pairing; it is kept in `pairings` once it is complete. progress: see Match.play."""
        words = np.random.SeedSequence([self.seed, *pair]).generate_state(1 + ROLES, np.uint64) >> np.uint64(1)
        world, *seeds = (int(word) for word in words)
        players = dict.fromkeys(pair)  # one, if it meets itself
        acts = [self.chosen[k].act(self.env, own) for k, own in zip(players, seeds, strict=False)]
        self.pairings.append(Pairing(pair, Match(self.env, acts, self.each, world).play(progress)))
        return self.pairings[-1]

    def play(self, progress: Callable[[int], None] = lambda episodes: None) -> list[Pairing]:
        """Play all pairings, one after the other."""
        return [self.play_pair(pair, progress) for pair in self.pairs]

    def ratings(self) -> tuple[Array, Array] | None:
        """Elo ratings and their standard errors, see ratings.elo; None until a chain of games joins all policies."""
        wins, draws = np.zeros((2, len(self.chosen), len(self.chosen)))
        for pairing in self.pairings:
            i, j = pairing.pair
            if i != j:
                wins[i, j], draws[i, j], wins[j, i] = pairing.won_drawn_lost()
                draws[j, i] = draws[i, j]
        return elo(wins, draws) if len(self.chosen) > 1 and linked(wins + wins.T + draws) else None

    def close(self) -> None:
        """Close the worlds."""
        self.env.close()

    def _check(self) -> None:
        self.env.reset()
        if min(self.env.worlds.dims["sides"], fewest_agents(self.env.worlds)) < ROLES:
            raise TrainingError(f"{self.scenario.name} has worlds of one side: there is no opponent to play against")
        for contender in self.chosen:
            contender.check(self.env)


def ratio(pairs: Array) -> tuple[float, float]:
    """The sum of all sums over the sum of all counts, and its standard error to first order.

    pairs: float64 (episodes, 2), sums and counts; with counts of 1, a mean and its error. NaN where all counts are 0.
    """
    total, count = pairs.sum(0)
    if not count:
        return float("nan"), float("nan")
    mean = total / count
    rest = pairs[:, 0] - mean * pairs[:, 1]
    spread = (rest * rest).sum() * len(pairs) / max(1, len(pairs) - 1)
    return float(mean), float(np.sqrt(spread) / count)

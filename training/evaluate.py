"""Evaluation: every policy meets every other and itself; what comes of it, with standard errors."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Side
from outlast.envs.core.make import make_vec
from outlast.envs.errors import TrainingError
from outlast.envs.scenarios.scenario import Scenario

from .contenders import Contender, common
from .matches import ROLES, Games, Match
from .ratings import elo, linked

Array = np.ndarray[Any, Any]
Figures = dict[str, tuple[float, float]]  # mean and standard error by name


@dataclass(frozen=True)
class Meeting:
    """A pairing that was played: the numbers of its policies, which may be the same one, and all of its episodes."""

    pair: tuple[int, int]
    games: Games

    def figures(self, role: int) -> Figures:
        """Of the policy in that role. NaN where there was nothing to be seen."""
        return {name: ratio(figure[:, :, role].reshape(-1, 2)) for name, figure in self.games.figures.items()}

    def results(self) -> tuple[int, int, int]:
        """Episodes that the first one won, that were drawn, and that it lost."""
        wins = self.games.figures["wins"][:, :, 0, 0]
        return int((wins == 1).sum()), int((wins == 0.5).sum()), int((wins == 0).sum())


class Evaluation:
    """Cross-play in `worlds` worlds at once.

    Each pairing plays `episodes`, or a few more, so that every world plays as many and both seatings are as frequent.
    A pairing's numbers are a function of the seed and of the places of its two policies in the list; threads make no
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
        self.scenario, self.chosen, self.seed = common(scenario, chosen), list(chosen), seed
        self.each = -(-episodes // worlds)
        self.each += self.each * worlds % ROLES  # or one seating would be played once more than the other
        self.env = make_vec(
            self.scenario,
            worlds,
            seed=seed,
            threads=threads,
            autoreset_mode="Disabled",
            copy=False,
            check_actions=False,
        )
        try:
            self._check()
        except BaseException:
            self.close()
            raise
        self.meetings: list[Meeting] = []

    @property
    def pairs(self) -> list[tuple[int, int]]:
        """All pairings, in the order in which they are played; of each policy with itself, too."""
        return [(i, j) for j in range(len(self.chosen)) for i in range(j + 1)]

    @property
    def episodes(self) -> int:
        """Of each pairing."""
        return self.each * self.env.num_worlds

    def meet(self, pair: tuple[int, int], progress: Callable[[int], None] = lambda episodes: None) -> Meeting:
        """Play a pairing; it is kept in `meetings` once it is complete. progress: see Match.play."""
        words = np.random.SeedSequence([self.seed, *pair]).generate_state(1 + ROLES, np.uint64) >> np.uint64(1)
        world, *seeds = (int(word) for word in words)
        players = dict.fromkeys(pair)  # one, if it meets itself
        acts = [self.chosen[k].act(self.env, own) for k, own in zip(players, seeds, strict=False)]
        self.meetings.append(Meeting(pair, Match(self.env, acts, self.each, world).play(progress)))
        return self.meetings[-1]

    def play(self, progress: Callable[[int], None] = lambda episodes: None) -> list[Meeting]:
        """Play all pairings, one after the other."""
        return [self.meet(pair, progress) for pair in self.pairs]

    def ratings(self) -> tuple[Array, Array] | None:
        """Elo ratings and their standard errors, see ratings.elo; None until games join all policies."""
        wins, draws = np.zeros((2, len(self.chosen), len(self.chosen)))
        for meeting in self.meetings:
            i, j = meeting.pair
            if i != j:
                wins[i, j], draws[i, j], wins[j, i] = meeting.results()
                draws[j, i] = draws[i, j]
        return elo(wins, draws) if len(self.chosen) > 1 and linked(wins + wins.T + draws) else None

    def close(self) -> None:
        """Let the worlds go."""
        self.env.close()

    def _check(self) -> None:
        self.env.reset()
        if len(np.unique(self.env.worlds[Side].side[0, self.env.worlds.span("agent")])) < ROLES:
            raise TrainingError(f"{self.scenario.name} has one side: there is nobody to play against")
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

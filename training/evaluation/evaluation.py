"""Cross-play: every policy against every other and itself, with standard errors."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from outlast.envs.core.agents import fewest_sides
from outlast.envs.core.make import make_vec
from outlast.envs.core.validation import check_count
from outlast.envs.rollout.lineup import ROLES
from outlast.envs.rollout.saved import common_scenario
from outlast.envs.scenarios.scenario import Scenario

from ..base.errors import TrainingError
from ..base.metrics import check_statistics
from ..base.ratings import elo, linked
from .contenders import Contender
from .groups import Groups, group_policies, rate_groups
from .matches import Match
from .pairing import Estimates, Pairing
from .report import text

Array = np.ndarray[Any, Any]


class Evaluation:
    """Cross-play in `worlds` worlds at once.

    Each pairing plays `episodes`, or a few more: every world plays equally many, and each policy plays each side
    equally often. A pairing's numbers are a function of the seed and of the places of its two policies in the list;
    threads make no difference. `str(evaluation)` has all tables.

    Attributes:
        scenario: What is played, with observations that all policies can play with.
        chosen: The policies.
        pairings: The pairings that are complete.
        each: Episodes of a pairing that each world plays.
        worlds: How many worlds there are.
        seed: The seed of the evaluation.

    Raises:
        ScenarioError: The scenario cannot be played.
        TrainingError: A policy cannot play there, or there is no side to play against.
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
        check_count("episodes", episodes, 1)
        check_count("worlds", worlds, 1)
        players = [contender.player for contender in chosen if contender.player is not None]
        self.scenario, self.chosen, self.seed = common_scenario(scenario, players), list(chosen), seed
        self.worlds, self.each = worlds, -(-episodes // worlds)
        self.each += self.each * worlds % ROLES  # else one assignment of sides would be played more often
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
        """All pairings, in the order in which they are played, including each policy with itself."""
        return [(i, j) for j in range(len(self.chosen)) for i in range(j + 1)]

    @property
    def episodes(self) -> int:
        """How many episodes each pairing plays."""
        return self.each * self.worlds

    @property
    def complete(self) -> bool:
        """Whether all pairings have been played."""
        return len(self.pairings) == len(self.pairs)

    def play_pair(self, pair: tuple[int, int], progress: Callable[[int], None] = lambda episodes: None) -> Pairing:
        """Play a pairing, and store it in `pairings` once it is complete. progress: see Match.play."""
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
        """Return Elo ratings and standard errors, see ratings.elo; None until a chain of games links all policies."""
        wins, draws = self._games()
        return elo(wins, draws) if len(self.chosen) > 1 and linked(wins + wins.T + draws) else None

    def groups(self) -> Groups | None:
        """Ratings and wins of groups of runs that differ by their seeds only, with intervals over seeds and games.

        None if no such group has several runs or there is only one group, and until all pairings are complete.

        Raises:
            TrainingError: Two of the policies are the same run, or runs of one seed.
        """
        return self._groups if self.complete else None

    @functools.cached_property
    def _groups(self) -> Groups | None:
        grouped = group_policies(self.chosen)
        several = len(self.chosen) > len(grouped) > 1
        return rate_groups(grouped, *self._games(), self.seed) if several else None

    def estimates(self, policy: str, against: str) -> Estimates:
        """Mean and standard error of each column, for a policy against another one: see training.columns.

        Args:
            policy: The label of the policy.
            against: The label of the other one, or the same label.

        Raises:
            TrainingError: There is no such pairing, or it is not complete.
        """
        names = [contender.label for contender in self.chosen]
        for pairing in self.pairings:
            pair = tuple(names[k] for k in pairing.pair)
            if policy in pair and against in pair and {policy, against} == set(pair):
                return pairing.estimates(pair.index(policy))
        raise TrainingError(f"{policy} against {against} is not complete; the policies are {', '.join(names)}")

    def __str__(self) -> str:
        return text(self)

    def close(self) -> None:
        """Close the worlds."""
        self.env.close()

    def _games(self) -> tuple[Array, Array]:
        """Games that each policy won against each other, and draws, (policies, policies) both; 0 against itself."""
        wins, draws = np.zeros((2, len(self.chosen), len(self.chosen)))
        for pairing in self.pairings:
            i, j = pairing.pair
            if i != j:
                wins[i, j], draws[i, j], wins[j, i] = pairing.won_drawn_lost()
                draws[j, i] = draws[i, j]
        return wins, draws

    def _check(self) -> None:
        self.env.reset()
        check_statistics(self.env, "length", "return", "kills")
        if fewest_sides(self.env.worlds) < ROLES:
            raise TrainingError(f"{self.scenario.name} has worlds of one side: there is no opponent to play against")
        for contender in self.chosen:
            contender.check(self.env)

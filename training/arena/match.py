"""Matches: two policies against each other in many worlds, each side equally often; and estimates of the results."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from outlast.components import Kills, Outcome
from outlast.ecs import Statistic
from outlast.envs.core.spaces import published
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.rollout.lineup import ROLES, Standings, role_of, wins
from outlast.envs.rollout.summary import MOMENTS

from ..base.metrics import AgentMetrics

Array = np.ndarray[Any, Any]
Estimates = dict[str, tuple[float, float]]  # mean and standard error by name
MATE = ROLES  # the role of agents that play beside the first policy
COUNTED = ("deaths",)  # statistics that AgentMetrics counts for each policy, by the type of damage
AgentIndices = tuple[Array, Array]  # indices of worlds and of agents in them, of equal length
Act = Callable[[dict[str, Array], AgentIndices], Array]  # observations to actions of these agents, (agents, actions)


class MatchResults:
    """The outcomes of the episodes of a match.

    figures: float64 (worlds, episodes of each, roles, 2) by name: sum and count, whose ratio is the figure. The count
    is 1 for most; for behaviour, it is the number of ticks in which it could be measured. spans: int (worlds,
    episodes, 2): the first and the last tick record of each episode in a recording of the match.
    """

    def __init__(self, worlds: int, each: int) -> None:
        self.figures: dict[str, Array] = {}
        self.spans = np.zeros((worlds, each, 2), int)

    def enter(self, where: AgentIndices, name: str, values: Array, counts: Any = 1.0) -> None:
        """Enter a figure (entries, roles) of these worlds and episodes."""
        figure = self.figures.setdefault(name, np.zeros((*self.spans.shape[:2], ROLES, 2)))
        figure[where] = np.stack(np.broadcast_arrays(values, counts), -1)

    def typical(self) -> tuple[int, int]:
        """Return world and number of the first episode of median length, the lower one of two medians."""
        length = self.figures["length"][:, :, 0, 0]
        median = np.sort(length, axis=None)[(length.size - 1) // 2]
        world, episode = np.argwhere(length == median)[0]
        return int(world), int(episode)


class Match:
    """A player of `each` episodes in every world, however long they take: stopping early would favour short ones.

    base_env: worlds with autoreset DISABLED. acts: the policy of each role, see lineup.role_of, or one for both; a
    third one plays the team-mates of the first, which is then one agent of each of its sides, each equally often.
    lineup.wins gives the winners; a draw counts half.
    """

    def __init__(self, base_env: SurvivalVectorEnv, acts: Sequence[Act], each: int, seed: int) -> None:
        self.base_env, self.acts, self.each = base_env, acts, each
        base_env.reset(seed=seed)
        self.metrics, self.results = AgentMetrics(base_env), MatchResults(base_env.num_worlds, each)
        self.standings = Standings(base_env.worlds)
        self.done, self.begun = np.zeros(base_env.num_worlds, int), np.zeros(base_env.num_worlds, int)
        self.records = 0  # the number of the last tick record
        self.dims = {key: column.dims for key, _, _, column in published(base_env.worlds, Statistic)}
        self._assign()

    def play(self, progress: Callable[[int], None] = lambda episodes: None) -> MatchResults:
        """Play the match to its end. progress: Called with the number of episodes that have just ended."""
        while (self.done < self.each).any():
            if ended := self._step():
                progress(ended)
        return self.results

    def _assign(self) -> None:
        """Assign agents to policies, in the worlds that are not done."""
        worlds = np.arange(self.base_env.num_worlds)
        sides, absent = self.metrics.sides, self.metrics.sides < 0
        self.role = np.where(absent, -1, role_of(sides, worlds[:, None], self.done[:, None]))
        if len(self.acts) > ROLES:
            same = (sides[:, :, None] == sides[:, None, :]) & ~absent[:, None]
            turn = (worlds // ROLES + self.done)[:, None] % same.sum(2)
            self.role[(self.role == 0) & (np.tril(same, -1).sum(2) != turn)] = MATE
        going = (self.done < self.each)[:, None]
        both = len(self.acts) == 1
        masks = (going & ((both & ~absent) | (self.role == role)) for role in range(len(self.acts)))
        self.indices: list[AgentIndices] = [(worlds, agents) for worlds, agents in map(np.nonzero, masks)]

    def _step(self) -> int:
        """Step all worlds. Return the number of counted episodes that ended."""
        observations = self.base_env.observe()
        actions = np.tile(self.base_env.noop, (self.base_env.num_worlds, self.base_env.num_agents, 1))
        for act, indices in zip(self.acts, self.indices, strict=True):
            if len(indices[0]):
                actions[indices] = act(observations, indices)
        self.metrics.before_step(actions)
        _, _, terminated, truncated, info = self.base_env.step(actions)
        self.metrics.after_step()
        self.standings.watch()
        self.records += 1
        done = terminated | truncated
        return self._finish(done, info["statistics"]) if done.any() else 0

    def _finish(self, done: Array, statistics: dict[str, Array]) -> int:
        """Enter the episodes that ended and begin the next ones. Return the number entered."""
        rows = np.flatnonzero(done & (self.done < self.each))
        where = rows, self.done[rows]
        self.results.spans[where] = np.stack([self.begun[rows], np.full(len(rows), self.records)], 1)
        self._enter(rows, where, statistics)
        self.base_env.reset(options={"reset_mask": done})
        self.metrics.reset(done)
        self.standings.begin(done)
        self.records += 1
        self.begun[done] = self.records
        self.done[rows] += 1
        self._assign()
        return len(rows)

    def _enter(self, rows: Array, where: AgentIndices, statistics: dict[str, Array]) -> None:
        mine = self.role[rows][:, None] == np.arange(ROLES)[:, None]  # (rows, roles, agents)
        sides = np.arange(self.base_env.worlds.dims["sides"])
        by_side = role_of(sides, rows[:, None], self.done[rows, None])[:, None] == np.arange(ROLES)[:, None]
        won = wins(np.where(by_side, self.standings.of(rows)[:, None], -np.inf).max(2))
        first = role_of(0, rows, self.done[rows])[:, None] == np.arange(ROLES)
        self.results.enter(where, "wins", won)
        self.results.enter(where, "wins_first", won * first, first)
        self.results.enter(where, "wins_second", won * ~first, ~first)
        if Kills in self.base_env.worlds or Outcome not in self.base_env.worlds:  # otherwise survival decides nothing
            self.results.enter(where, "life", (self.standings.life[rows][:, None] * by_side).max(2))
        for name, values in statistics.items():  # for agents, the mean over those of a role; for sides, the sum
            if self.dims.get(name) == ("agents",):
                there = mine.sum(2)
                mean = (values[rows, None] * mine).sum(2) / np.maximum(there, 1)
                self.results.enter(where, name, mean, there > 0)
            elif self.dims.get(name) == ("sides",):
                self.results.enter(where, name, (values[rows, None] * by_side).sum(2))
            elif values.ndim == 2 and name not in COUNTED:  # other entries are named as in training logs
                for k, entry in enumerate(values[rows].T):
                    self.results.enter(where, f"{name}{k}", np.repeat(entry[:, None], ROLES, 1))
        for name, total in self.metrics.totals.items():
            self.results.enter(where, name, (total[rows][:, None] * mine).sum(2))
        for name, rate in self.metrics.rates.items():
            summed = (rate[rows][:, None] * mine[..., None]).sum(2)
            self.results.enter(where, name, summed[..., 0], summed[..., 1])
        for name, values in statistics.items():
            if values.ndim == 1 and name not in self.metrics.totals:  # for the world: the same for both roles
                known = values[rows, None] > 0 if name in MOMENTS else 1.0
                self.results.enter(where, name, np.repeat(values[rows, None], ROLES, 1), known)


@dataclass(frozen=True)
class Pairing:
    """A pairing that was played: the indices of its policies, which may be the same policy, and all its episodes."""

    pair: tuple[int, int]
    results: MatchResults

    def estimates(self, role: int, side: int | None = None) -> Estimates:
        """Return estimates for the policy in that role. NaN for quantities without a measurement.

        side: From the episodes in which it plays that side only; against itself, these are all. None: from all.
        """
        figures = self.results.figures
        if side is None:
            return {name: ratio(figure[:, :, role].reshape(-1, 2)) for name, figure in figures.items()}
        worlds, episodes = np.indices(self.results.spans.shape[:2])
        player = role_of(side, worlds, episodes)
        counts = (player == role) | (self.pair[0] == self.pair[1])
        own = worlds[counts], episodes[counts], player[counts]
        return {name: ratio(figure[own]) for name, figure in figures.items()}

    def won_drawn_lost(self) -> tuple[int, int, int]:
        """Return the numbers of episodes that the first policy won, drew and lost."""
        wins = self.results.figures["wins"][:, :, 0, 0]
        return int((wins == 1).sum()), int((wins == 0.5).sum()), int((wins == 0).sum())


def ratio(pairs: Array) -> tuple[float, float]:
    """Return the sum of all sums over the sum of all counts, and its standard error to first order.

    pairs: float64 (episodes, 2), sums and counts. Both are NaN if all counts are 0; the error also if all but one are.
    """
    total, count = pairs.sum(0)
    there = np.count_nonzero(pairs[:, 1])
    if not count:
        return float("nan"), float("nan")
    rest = pairs[:, 0] - total / count * pairs[:, 1]
    spread = (rest * rest).sum() * there / (there - 1) if there > 1 else np.nan
    return float(total / count), float(np.sqrt(spread) / count)

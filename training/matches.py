"""Matches: two policies meet in many worlds, with the sides dealt out evenly."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from outlast.envs.core.vector_env import SurvivalVectorEnv

from .watch import Watch

Array = np.ndarray[Any, Any]
Seats = tuple[Array, Array]  # numbers of worlds and of agents
Act = Callable[[dict[str, Array], Seats], Array]  # what the agents in some seats do, (seats, actions)

ROLES = 2


def role_of(side: Any, world: Any, episode: Any) -> Any:
    """Which role plays a side: they alternate, and swap from world to world and from episode to episode."""
    return (side + world + episode) % ROLES


class Games:
    """What came of the episodes of a match.

    figures: float64 (worlds, episodes of each, roles, 2) by name: sum and count, whose ratio is the figure. Of most, an
    episode has one; of behaviour, as many as there were ticks in which it could be seen. spans: int (worlds, episodes,
    2): the first and last run of the tick of each episode, counted from the reset of all worlds on.
    """

    def __init__(self, worlds: int, each: int) -> None:
        self.figures: dict[str, Array] = {}
        self.spans = np.zeros((worlds, each, 2), int)

    def put(self, where: Seats, name: str, values: Array, counts: Any = 1.0) -> None:
        """Enter a figure (entries, roles) of the episodes `where`."""
        figure = self.figures.setdefault(name, np.zeros((*self.spans.shape[:2], ROLES, 2)))
        figure[where] = np.stack(np.broadcast_arrays(values, counts), -1)

    def typical(self) -> tuple[int, int]:
        """World and number of an episode of median length, the lower one if there are two: the first such."""
        length = self.figures["length"][:, :, 0, 0]
        median = np.sort(length, axis=None)[(length.size - 1) // 2]
        world, episode = np.argwhere(length == median)[0]
        return int(world), int(episode)


class Match:
    """Plays `each` episodes in every world of `core`, which resets by itself never (autoreset DISABLED).

    Every world plays as many, however long they take, so short ones are not favoured. Sides are dealt out by role_of.
    acts: of each role, or one that plays both. The policy whose longest-lived side lives longer than the other's wins;
    a draw counts half.
    """

    def __init__(self, core: SurvivalVectorEnv, acts: Sequence[Act], each: int, seed: int) -> None:
        self.core, self.acts, self.each = core, acts, each
        core.reset(seed=seed)
        self.watch, self.games = Watch(core), Games(core.num_worlds, each)
        self.done, self.begun = np.zeros(core.num_worlds, int), np.zeros(core.num_worlds, int)
        self.runs = 0  # the number of the last run of the tick
        self._sit()

    def play(self, progress: Callable[[int], None] = lambda episodes: None) -> Games:
        """All of it. progress is told how many more episodes have ended."""
        while (self.done < self.each).any():
            if ended := self._step():
                progress(ended)
        return self.games

    def _sit(self) -> None:
        """Who plays which agent, in the worlds that go on."""
        worlds = np.arange(self.core.num_worlds)
        self.role = role_of(self.watch.sides, worlds[:, None], self.done[:, None])
        going = (self.done < self.each)[:, None]
        both = len(self.acts) == 1
        masks = (going & (both | (self.role == role)) for role in range(len(self.acts)))
        self.seats: list[Seats] = [(seats[0], seats[1]) for seats in map(np.nonzero, masks)]

    def _step(self) -> int:
        """One step of all worlds; how many episodes ended that count."""
        observations = self.core.observe()
        actions = np.zeros((self.core.num_worlds, self.core.num_agents, len(self.core.action_sizes)), np.int64)
        for act, seats in zip(self.acts, self.seats, strict=True):
            if len(seats[0]):
                actions[seats] = act(observations, seats)
        self.watch.before(actions)
        _, _, terminated, truncated, info = self.core.step(actions)
        self.watch.after()
        self.runs += 1
        over = terminated | truncated
        return self._finish(over, info["statistics"]) if over.any() else 0

    def _finish(self, over: Array, statistics: dict[str, Array]) -> int:
        """Enter the episodes that ended and begin the next ones; how many that were."""
        rows = np.flatnonzero(over & (self.done < self.each))
        where = rows, self.done[rows]
        self.games.spans[where] = np.stack([self.begun[rows], np.full(len(rows), self.runs)], 1)
        self._enter(rows, where, statistics)
        self.core.reset(options={"reset_mask": over})
        self.watch.forget(over)
        self.runs += 1
        self.begun[over] = self.runs
        self.done[rows] += 1
        self._sit()
        return len(rows)

    def _enter(self, rows: Array, where: Seats, statistics: dict[str, Array]) -> None:
        mine = self.role[rows][:, None] == np.arange(ROLES)[:, None]  # (rows, roles, agents)
        life = (self.watch.totals["life"][rows][:, None] * mine).max(2)
        self.games.put(where, "wins", (1 + np.sign(life - life[:, ::-1])) / 2)
        self.games.put(where, "life", life)
        self.games.put(where, "return", (statistics["return"][rows][:, None] * mine).sum(2), mine.sum(2))
        first = np.unique(self.watch.sides, return_index=True)[1]  # an agent of each side
        self.games.put(where, "kills", (statistics["kills"][rows][:, None] * mine[:, :, first]).sum(2))
        for name, total in self.watch.totals.items():
            if name != "life":
                self.games.put(where, name, (total[rows][:, None] * mine).sum(2))
        for name, rate in self.watch.rates.items():
            summed = (rate[rows][:, None] * mine[..., None]).sum(2)
            self.games.put(where, name, summed[..., 0], summed[..., 1])
        for name, values in statistics.items():
            if values.ndim == 1 and not name.startswith("deaths_"):  # of the world: the same for both
                known = values[rows, None] > 0 if name == "first_death" else 1.0  # 0: nobody died
                self.games.put(where, name, np.repeat(values[rows, None], ROLES, 1), known)

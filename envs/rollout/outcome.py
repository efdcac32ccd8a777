"""Winners of episodes: the side that lives longest or, in games with scores of sides, has the highest score."""

import numpy as np

from outlast.components import End, Outcome, Score
from outlast.ecs import Worlds

from ..core.agents import side
from ..core.validation import Array
from ..core.vector_env import Actions, Arrays, SurvivalVectorEnv
from ..errors import UsageError
from .lineup import Lineup, key_of, own_side
from .memory import tell
from .policies import Policy
from .summary import RESULTS

PLAYED = ("against", "own_side", "result")  # columns that tables of episodes get: text, int, text


class Standings:
    """Progress of each side of each world in its episode."""

    def __init__(self, worlds: Worlds) -> None:
        self._worlds = worlds
        self.life = np.zeros((worlds.count, worlds.dims["sides"]), int)  # ticks that ended with a living member

    def begin(self, where: Array) -> None:
        """Begin anew in the worlds `where`, bool (worlds,)."""
        self.life[where] = 0

    def watch(self) -> None:
        """Count the ticks that sides live; to be called after each step."""
        self.life += self._worlds[Score].alive > 0

    def of(self, rows: Array) -> Array:
        """Return scores in components.Outcome, or else ticks lived, float64 (rows, sides); -inf for absent sides."""
        come = self._worlds[Outcome].outcome[rows] if Outcome in self._worlds else self.life[rows]
        there = (side(self._worlds, rows)[:, :, None] == np.arange(come.shape[1])).any(1)
        return np.where(there, come, -np.inf)


def own_wins(come: Array, own: Array) -> Array:
    """Return whether the side `own` of each world wins against all others; see `wins`. come: (worlds, sides)."""
    mine = own[:, None] == np.arange(come.shape[1])
    return wins(np.stack([np.where(each, come, -np.inf).max(1) for each in (mine, ~mine)], 1))[:, 0]


def shares_beaten(come: Array, own: Array, sides: Array) -> Array:
    """Return the share of the other sides that the side `own` of each world came farther than; equally far is a half.

    For sides that play equally well it is 1/2 on average for any number; for two sides it is `own_wins`. sides: How
    many each world has, at least 2, (worlds,); those beyond are absent.
    """
    number = np.arange(come.shape[1])
    others = (number < sides[:, None]) & (number != own[:, None])
    return (_beats(np.take_along_axis(come, own[:, None], 1), come) * others).sum(1) / others.sum(1)


def wins(come: Array) -> Array:
    """Return who wins: 1, 0, or 0.5 in a draw, given how far the best side of each role came, float64 (..., roles)."""
    return _beats(come, come[..., ::-1])


def _beats(one: Array, other: Array) -> Array:
    return np.where(one > other, 1.0, np.where(one < other, 0.0, 0.5))


class Against:
    """A policy on one side of each world and a line-up on all others, as one policy with a memory.

    That side is lineup.own_side, and the result `own_wins`. If numbers of agents vary, an episode may have one side
    only; such episodes are not counted. Worlds must restart in the step after the end (NEXT_STEP). Policy and line-up
    get the observations of all agents. Raises UsageError if the game has only one side.

    counts: How many episodes the policy won, drew and lost against each one of the line-up, int (policies, 3).
    """

    def __init__(self, env: SurvivalVectorEnv, policy: Policy, others: Lineup) -> None:
        self._env, self.policy, self._others = env, policy, others
        sides = env.worlds.dims["sides"]
        if sides < 2:
            raise UsageError(f"{env.scenario.name} has one side: there is nobody to play against; leave out --others")
        self._own, self._sides = np.zeros((2, env.num_worlds), int)
        self._standings = Standings(env.worlds)
        self.counts = np.zeros((len(others.names), len(RESULTS)), int)
        self._results = np.full(env.num_worlds, len(RESULTS))  # of the last episode that ended in each world

    def reset(self, where: Array) -> None:
        """Choose sides and players for the episodes that begin in the worlds `where`, bool (worlds,)."""
        tell(self.policy, where)
        tell(self._others, where)
        _, worlds, episodes = key_of(self._env.worlds, where)
        self._sides[where] = side(self._env.worlds, where).max(1) + 1
        self._own[where] = own_side(worlds, episodes, self._sides[where])
        self._standings.begin(where)

    def __call__(self, observations: Arrays) -> Actions:
        """Return the actions of all agents, integers (worlds, agents, actions)."""
        return np.where(self.plays()[..., None], self.policy(observations), self._others(observations))

    def plays(self) -> Array:
        """Return which agents the policy plays in the current episodes, bool (worlds, agents)."""
        return side(self._env.worlds) == self._own[:, None]

    def watch(self, where: Array) -> None:
        """Count the episodes of the worlds `where`, bool (worlds,), that ended in a step; to be called after each."""
        self._standings.watch()
        end = self._env.worlds[End]
        ended = (end.terminated | end.truncated)[:, 0] & where
        rows = np.flatnonzero(ended & (self._sides > 1))
        self._results[ended] = len(RESULTS)
        self._results[rows] = 2 - 2 * own_wins(self._standings.of(rows), self._own[rows])
        np.add.at(self.counts, (self._others.drawn[rows], self._results[rows]), 1)

    def played(self, rows: Array) -> dict[str, Array]:
        """Return the columns PLAYED of the episodes that just ended in the worlds `rows`; "" for those of one side."""
        names, results = np.array(self._others.names), np.array([*RESULTS, ""])
        found = names[self._others.drawn[rows]], self._own[rows], results[self._results[rows]]
        return dict(zip(PLAYED, found, strict=True))

    @property
    def outcomes(self) -> dict[str, Array]:
        """The rows of `counts` by the names of the line-up: views, which are updated as counting goes on."""
        return dict(zip(self._others.names, self.counts, strict=True))

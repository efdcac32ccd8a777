"""Winners of episodes: the side that lives longest or, in games with scores of sides, has the highest score."""

import numpy as np

from outlast.components import Outcome, Score
from outlast.ecs import Worlds

from ..core.agents import side
from ..core.validation import Array


class Standings:
    """Progress of each side of each world in its episode.

    Attributes:
        life: int (worlds, sides), the ticks that each side has lived: those at whose end it had a living member.
    """

    def __init__(self, worlds: Worlds) -> None:
        self._worlds = worlds
        self.life = np.zeros((worlds.count, worlds.dims["sides"]), int)

    def begin(self, where: Array) -> None:
        """Begin anew in the worlds `where`, bool (worlds,)."""
        self.life[where] = 0

    def watch(self) -> None:
        """Count the ticks that sides live; to be called after each step."""
        self.life += self._worlds[Score].alive > 0

    def of(self, rows: Array) -> Array:
        """Return how far the sides of the worlds `rows` have come, float64 (rows, sides); absent ones -inf.

        That is the score in components.Outcome, or the ticks that they have lived.
        """
        come = self._worlds[Outcome].outcome[rows] if Outcome in self._worlds else self.life[rows]
        there = (side(self._worlds, rows)[:, :, None] == np.arange(come.shape[1])).any(1)
        return np.where(there, come, -np.inf)


def own_wins(come: Array, own: Array) -> Array:
    """Return whether one side of each world, `own`, wins against all others: 1, 0, or 0.5 for a draw, float64.

    come: How far each side came, (worlds, sides).
    """
    mine = own[:, None] == np.arange(come.shape[1])
    return wins(np.stack([np.where(each, come, -np.inf).max(1) for each in (mine, ~mine)], 1))[:, 0]


def shares_beaten(come: Array, own: Array, sides: Array) -> Array:
    """Return the share of the other sides that one side of each world came farther than, by living longer or otherwise.

    For sides that play equally well it is 1/2 on average for any number; for two sides it is `own_wins`, which has the
    same arguments and form. A side that came equally far counts half.

    sides: How many sides each world has, at least 2, (worlds,); those beyond are absent.
    """
    number = np.arange(come.shape[1])
    others = (number < sides[:, None]) & (number != own[:, None])
    return (_beats(np.take_along_axis(come, own[:, None], 1), come) * others).sum(1) / others.sum(1)


def wins(come: Array) -> Array:
    """Return who wins, the role whose best side came farther: 1, 0 for the other role, 0.5 for both in a draw, float64.

    come: How far the best side of each role came, (..., roles).
    """
    return _beats(come, come[..., ::-1])


def _beats(one: Array, other: Array) -> Array:
    """Return 1 where one is more than the other, 0 where it is less, 0.5 where neither is: float64."""
    return np.where(one > other, 1.0, np.where(one < other, 0.0, 0.5))

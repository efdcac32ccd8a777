"""A policy against a mixture of others: sides, and who wins."""

from typing import Any

import numpy as np

from outlast.components import End

from ..core.agents import side
from ..core.vector_env import Actions, Arrays, SurvivalVectorEnv
from ..errors import UsageError
from .memory import tell
from .mixture import Mixture, key_of
from .policies import Policy
from .sides import living_sides, own_side, own_wins

Array = np.ndarray[Any, Any]

RESULTS = ("won", "drawn", "lost")


class Against:
    """A policy on one side of each world and a mixture on all others, as one policy with a memory; `str` is a table.

    Sides: see sides.own_side. Who wins: see sides.own_wins.

    Attributes:
        counts: How many episodes the policy won, drew and lost against each of the mixture, int (policies, 3).

    Args:
        env: The worlds; they restart in the step after the end (NEXT_STEP).
        policy: It gets the observations of all agents.
        others: They do, too.

    Raises:
        UsageError: There is one side only.
    """

    def __init__(self, env: SurvivalVectorEnv, policy: Policy, others: Mixture) -> None:
        self._env, self._policy, self._others = env, policy, others
        sides = env.worlds.dims["sides"]
        if sides < 2:
            raise UsageError(f"{env.scenario.name} has one side: there is nobody to play against; leave out --others")
        self._own, self._life = np.zeros(env.num_worlds, int), np.zeros((env.num_worlds, sides), int)
        self.counts = np.zeros((len(others.names), len(RESULTS)), int)

    def reset(self, where: Array) -> None:
        """Episodes begin in the worlds `where`, bool (worlds,)."""
        tell(self._policy, where)
        tell(self._others, where)
        _, worlds, episodes = key_of(self._env.worlds, where)
        self._own[where] = own_side(worlds, episodes, side(self._env.worlds, where).max(1) + 1)
        self._life[where] = 0

    def __call__(self, observations: Arrays) -> Actions:
        """The actions of all agents, integers (worlds, agents, actions)."""
        mine = side(self._env.worlds) == self._own[:, None]
        return np.where(mine[..., None], self._policy(observations), self._others(observations))

    def watch(self, where: Array) -> None:
        """Count after each step the episodes that ended in it, of the worlds `where`, bool (worlds,)."""
        self._life += living_sides(self._env.worlds)
        end = self._env.worlds[End]
        rows = np.flatnonzero((end.terminated | end.truncated)[:, 0] & where)
        won = own_wins(self._life[rows], self._own[rows])
        np.add.at(self.counts, (self._others.drawn[rows], (2 - 2 * won).astype(int)), 1)

    def __str__(self) -> str:
        """Shares of the episodes against each of the mixture, with standard errors."""
        width = max(20, *map(len, self._others.names))
        lines = [f"{'against':<{width}} {'episodes':>12}" + "".join(f" {name:>17}" for name in RESULTS)]
        for name, counts in zip(self._others.names, self.counts.tolist(), strict=True):
            cells = [_share(count, sum(counts)) for count in counts]
            lines.append(f"{name:<{width}} {sum(counts):>12,}" + "".join(f" {cell:>17}" for cell in cells))
        return "\n".join(lines)


def _share(count: int, episodes: int) -> str:
    """A share and its standard error."""
    if not episodes:
        return "-"
    share = count / episodes
    return f"{share:.4f} ± {(share * (1 - share) / max(episodes - 1, 1)) ** 0.5:.4f}"

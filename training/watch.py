"""What is counted of running episodes, tick by tick, for each agent."""

from typing import Any

import numpy as np

from outlast.components import Death, Item, Score, Side
from outlast.ecs import Entity
from outlast.envs.core.vector_env import SurvivalVectorEnv

from .behaviour import Behaviour

Array = np.ndarray[Any, Any]


class Watch:
    """Sums over the running episode of every world; make it when the worlds have been reset.

    totals: float64 (worlds, agents) by name. life: ticks to whose end its side lived; deaths_CAUSE; heals_given.
    rates: float64 (worlds, agents, 2), sums over the ticks that the agent lived in, and how many ticks those are: see
    Behaviour.quantities, and heals_held.
    """

    def __init__(self, core: SurvivalVectorEnv) -> None:
        self.core, self.behaviour = core, Behaviour(core)
        self.agents = core.worlds.span("agent")
        self.sides = core.worlds[Side].side[0, self.agents].copy()
        names = ["life", *(f"deaths_{cause}" for cause in core.worlds.layout.damage_types)]
        names += ["heals_given"] * (self.behaviour.heals is not None)
        self.totals = {name: np.zeros((core.num_worlds, core.num_agents)) for name in names}
        self.rates: dict[str, Array] = {}

    def before(self, actions: Array) -> None:
        """Count what agents are about to do. Call before every step."""
        alive = self.core.worlds[Entity].alive[:, self.agents] != 0
        found = self.behaviour.quantities(self.core.observe(), actions, alive)
        self.behaviour.before()
        if self.behaviour.heals is not None:
            holder, rows = self.core.worlds[Item].holder[:, self.behaviour.heals], np.r_[self.agents]
            found["heals_held"] = (holder[:, :, None] == rows).sum(1), alive
        for name, (values, where) in found.items():
            rate = self.rates.setdefault(name, np.zeros((*alive.shape, 2)))
            rate[..., 0] += values * where
            rate[..., 1] += where

    def after(self) -> None:
        """Count who lives, who died, who gave. Call after every step."""
        death = self.core.worlds[Death]
        now, cause = death.now[:, self.agents] != 0, death.damage_type[:, self.agents]
        self.totals["life"] += self.core.worlds[Score].alive[:, self.sides] > 0
        if now.any():
            for k, name in enumerate(self.core.worlds.layout.damage_types):
                self.totals[f"deaths_{name}"] += now & (cause == k)
        if self.behaviour.heals is not None:
            self.totals["heals_given"] += self.behaviour.gifts()

    def forget(self, where: Array) -> None:
        """Begin anew in the worlds `where`."""
        for sums in (*self.totals.values(), *self.rates.values()):
            sums[where] = 0

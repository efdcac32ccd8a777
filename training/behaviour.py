"""What agents do, beyond the paper's quantities: means over the living agents of a rollout."""

from typing import Any

import numpy as np

from outlast.components import Item, Side
from outlast.ecs import Entity
from outlast.envs.core.vector_env import SurvivalVectorEnv

from .buffer import Rollout

Array = np.ndarray[Any, Any]


class Behaviour:
    """Watches the worlds tick by tick, where the rollout does not hold what is asked, and reports on a rollout."""

    def __init__(self, core: SurvivalVectorEnv) -> None:
        self.core, self.numbers = core, core.scenario.numbers()
        self.heals = core.worlds.span("heal") if "heals" in core.scenario and Item in core.worlds else None
        self.agents = core.worlds.span("agent")
        self.names = [name for name, _ in core.action_columns]
        self.held = self.given = 0
        self.holder: Array = np.empty(0)

    def before(self) -> None:
        """Call before every step."""
        if self.heals is not None:
            self.holder = self.core.worlds[Item].holder[:, self.heals].copy()

    def after(self) -> None:
        """Count heals in bags, and those that were given. Call after every step."""
        if self.heals is not None:
            self.held += int((self.core.worlds[Item].holder[:, self.heals] >= 0).sum())
            self.given += int(self.gifts().sum())

    def gifts(self) -> Array:
        """Heals that each agent gave to another since `before`, int (worlds, agents); of those who live still."""
        worlds, given = self.core.worlds, np.zeros((self.core.num_worlds, self.core.num_agents), int)
        now = worlds[Item].holder[:, self.heals]
        moved = np.nonzero((self.holder >= 0) & (now >= 0) & (now != self.holder))
        givers = self.holder[moved]
        np.add.at(given, (moved[0], givers - self.agents.start), worlds[Entity].alive[moved[0], givers])
        return given

    def report(self, rollout: Rollout) -> dict[str, float]:
        """Means over the living agents of the rollout, by tag; what was never the case is left out."""
        shape = (rollout.buffer_size, self.core.num_worlds, self.core.num_agents)
        views = rollout.layout.views(rollout.observations[:-1].reshape(*shape, -1))
        alive, count = rollout.alive.reshape(shape), max(1, int(rollout.alive.sum()))
        found = self.quantities(views, rollout.actions.reshape(*shape, -1), alive)
        tags = {"behaviour/alive": float(rollout.alive.mean())}
        tags |= {f"behaviour/{name}": _mean(values, where) for name, (values, where) in found.items()}
        if self.heals is not None:
            tags["behaviour/heals_held"] = self.held / count
            tags["behaviour/heals_given"] = 1000 * self.given / count  # in 1000 agent-steps
        self.held = self.given = 0
        return {tag: value for tag, value in tags.items() if not np.isnan(value)}

    def quantities(self, views: dict[str, Array], actions: Array, alive: Array) -> dict[str, tuple[Array, Array]]:
        """By name: values (..., worlds, agents), and for whom they count, bool of the same shape.

        views: observations by key. actions: (..., worlds, agents, actions). attack_near and attack_far: whether it
        attacks, with a living enemy in reach and without; near: whether there is one.
        """
        found = {}
        teams = views["self"].shape[-1] - 8  # 1 if rows hold a team
        place = views["self"][..., teams + 2 : teams + 4]
        if "zone" in views:
            found["zone_distance"] = _length(place - views["zone"][..., :2]), alive
        if "attack" in self.names:
            attack, near = actions[..., self.names.index("attack")], self._near(place, alive)
            found |= {"attack_near": (attack, alive & near), "attack_far": (attack, alive & ~near)}
            found["near"] = near, alive
        return found

    def _near(self, place: Array, alive: Array) -> Array:
        """Whether a living enemy is near enough to be struck by who faces it: its centre, reach and radius."""
        reach = self.numbers["melee_reach"] + self.numbers["agents_radius"]
        sides = self.core.worlds[Side].side[0, self.agents]
        enemies = sides[:, None] != sides
        apart = _length(place[..., :, None, :] - place[..., None, :, :])
        near: Array = ((apart <= reach) & enemies & alive[..., None, :]).any(-1)
        return near


def _mean(values: Array, where: Array) -> float:
    """NaN where there is nothing."""
    return float(values[where].mean()) if where.any() else float("nan")


def _length(vectors: Array) -> Array:
    length: Array = np.sqrt((vectors * vectors).sum(-1))
    return length

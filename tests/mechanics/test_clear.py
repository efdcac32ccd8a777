"""Solids that are clear, as sensors are: sight, rays of the lidar and strikes pass through them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import systems
from outlast.components import Body, Filter, Health, Shape, Sight, Solid
from outlast.components.sight import is_set
from outlast.ecs import Archetype, Module, number
from outlast.envs.web.world_json import describe


@dataclass(frozen=True)
class Pane(Module):
    """A wall between two agents."""

    sensor: int = number(0, low=0, high=1)
    clear: int = number(-1, low=-1, high=1)  # -1: as usual
    count: int = number(1, low=1, high=400)  # all but one are far away

    def archetypes(self) -> list[Archetype]:
        look = {} if self.clear < 0 else {"clear": self.clear}
        place = Body(x=[1.0, *[9.0] * (self.count - 1)], y=[0.0, *[9.0] * (self.count - 1)])
        solid = Shape(half_width=0.1, half_height=1.0), Solid(), Filter(sensor=self.sensor, **look)
        return [Archetype("pane", (place, *solid), self.count)]


def faced(module: Module, blocked: bool, x: float, other: float, y: float = 0.0) -> tuple[Any, list[Any]]:
    """Agents 0 and 1 look along +x, and 0 strikes. Returns what it sees, what its ray reads, and what 1 has left."""
    lidar = systems.Lidar(rays=1, angle=0.1, targets="solids")
    numbers = {"melee_reach": 5.0, "melee_damage": 10, "melee_blocked": blocked, "cameras_items_occlude": False}
    env: Any = outlast.make_vec(outlast.variant("ffa_1").with_(module, lidar).replace(**numbers), 1, seed=0)
    env.reset()
    env.place("agent", 0, x=x, y=y, angle=0)
    env.place("agent", 1, x=other, y=y, angle=0)
    actions = np.tile(env.noop, (1, 2, 1))
    actions[0, 0, [name for name, _ in env.action_columns].index("attack")] = 1
    far = env.step(actions)[0]["lidar"][0, 0, 0]
    return env, [is_set(env.worlds[Sight].visible[0], 0, 1), far, env.worlds[Health].points[0, 1]]


@pytest.mark.parametrize("count", [1, 200])  # as few bodies, and as a crowd
@pytest.mark.parametrize(("sensor", "clear", "passes"), [(0, -1, 0), (1, -1, 1), (0, 1, 1), (1, 0, 0)])
@pytest.mark.parametrize("blocked", [True, False])
def test_what_is_clear_blocks_nothing(sensor: int, clear: int, passes: int, count: int, blocked: bool) -> None:
    env, found = faced(Pane(sensor=sensor, clear=clear, count=count), blocked, 0, 2)
    expected = [passes, 1.5 if passes else 0.9, 90 if passes or not blocked else 100]
    assert found == pytest.approx(expected, abs=1e-3)
    panes = [each for each in describe(env.worlds, 0)["objects"] if each["kind"] == "pane"]
    assert panes[0]["hides"] != passes

"""The index of bodies in games: in every phase it lists what plain loops over the tables find."""

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import systems
from outlast.components import Body, Phase, Shape, Side
from outlast.ecs import Array, Bitset, Entity, Module, Read, Rows, Singleton, Write, column
from outlast.systems.geometry.bodies import FEW, Bodies, in_box, near, on_ray, refresh
from outlast.systems.geometry.rays import NO_HIT, raycast_entity
from tests.conftest import scaled

WORLDS = scaled(40, least=2)  # more than go through a tick together, if compiled
TICKS = 12
FAR = np.float32(3)
PHASES = [Phase[name] for name in ("SPAWN", "GIVE", "MELEE", "MOVE", "SEE", "DIE", "PICKUP", "OBSERVE")]


class Checked(Singleton):
    wrong: Array = column("i4", len(PHASES))  # rows that a query missed, or listed without reason, in this episode
    found: Array = column("i4", len(PHASES))  # rows that queries listed
    lines: Array = column("i4", len(PHASES))  # the most blocks with living bodies


class Asks(Module):
    """A system in each of the phases, behind all that moves bodies there."""

    def singletons(self) -> Iterable[Singleton]:
        return [Checked()]


def _ask(n: int) -> Any:
    def ask(
        checked: Write[Checked],
        body: Read[Body],
        shape: Read[Shape],
        entities: Read[Entity],
        agents: Rows[Side],
        everything: Rows[Shape],
        shaped: Bitset[Shape],
        bodies: Bodies,
    ) -> None:
        checked.lines[n] = max(checked.lines[n], refresh(bodies))
        for i in range(agents.size):
            x, y = body.x[agents[i]], body.y[agents[i]]
            dx, dy = FAR * body.cosine[agents[i]], FAR * body.sine[agents[i]]
            for query in range(3):
                if query == 0:
                    count = near(bodies, shaped, x, y, FAR)
                elif query == 1:
                    count = in_box(bodies, shaped, x - FAR, x + FAR, y - FAR, y + FAR)
                else:
                    count = on_ray(bodies, bodies.members, x, y, dx, dy)
                checked.found[n] += count
                at = 0
                for e in everything:
                    listed = at < count and bodies.rows[at] == e
                    at += listed
                    way = math.hypot(body.x[e] - x, body.y[e] - y)
                    hit = query == 2 and raycast_entity(body, shape, x, y, dx, dy, e) < NO_HIT
                    must = entities.alive[e] != 0 and (hit or (query < 2 and way < FAR))
                    may = entities.alive[e] != 0 and way < 2 * (FAR + shape.bound[e] + 1)
                    checked.wrong[n] += (must and not listed) or (listed and not may)
                checked.wrong[n] += at != count

    ask.__name__ = ask.__qualname__ = f"ask_{n}"
    return ask


for _n, _phase in enumerate(PHASES):
    Asks.system(_phase, after=(Body, Shape, Entity))(_ask(_n))


@pytest.mark.parametrize("heals", [6, 300])
def test_the_index_is_what_is_there_in_every_phase(heals: int) -> None:
    """Through deaths and respawns, dropped items, boxes that break and are pushed, resets, and writes between ticks."""
    numbers = {"n_agents": 4, "n_boxes": 5, "boxes_dynamic": True, "n_heals": heals, "spawn_grid_cells": 20}
    rules = {"agents_health": 10, "boxes_toughness": 1, "ending_rule": "never", "ending_limit": 1000}
    mechanics = Asks(), systems.Respawn(ticks=2), systems.DropLast(), systems.Walls()
    scenario = outlast.variant("ffa_4").with_(*mechanics).replace(**numbers, **rules)
    env, rng = outlast.make_vec(scenario, WORLDS, seed=0), np.random.default_rng(0)
    env.reset()
    saved = env.worlds.block.copy()
    for tick in range(TICKS):
        checked = env.worlds[Checked]
        assert not checked.wrong.any(), [phase.name for phase, wrong in zip(PHASES, checked.wrong.T) if wrong.any()]
        env.worlds[Body].x[rng.integers(WORLDS), :4] = rng.uniform(-5, 5, 4)
        env.worlds[Entity].alive[rng.integers(WORLDS), env.worlds.span("heal").start] = 0
        if tick % 3 == 1:
            env.worlds.block[rng.integers(WORLDS)] = saved[rng.integers(WORLDS)]
        if tick == TICKS // 2:
            env.reset(options={"reset_mask": np.arange(WORLDS) % 2 == 0})
        env.step(rng.integers(0, env.action_sizes, (WORLDS, env.num_agents, len(env.action_sizes))))
    checked = env.worlds[Checked]
    assert not checked.wrong.any()
    assert checked.found.any(0).all()
    assert (checked.lines.max() > FEW) == (heals > 100)

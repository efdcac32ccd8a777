"""Naive forms of the rules of hide and seek: one agent and one thing at a time, float64, from their description."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from outlast.components import Body, ObservationMasks, Shape, Side, Sight, Weld
from outlast.components.hide_and_seek import Aloft, Movable
from outlast.ecs import Entity
from tests.helpers.naive_geometry import box_corners, edge_distance, in_polygon


@dataclass
class Thing:
    row: int
    kind: str
    locked_by: int
    lockable: bool
    x: float
    y: float
    angle: float
    half_width: float
    half_height: float
    vx: float
    vy: float

    def distance(self, x: float, y: float) -> float:
        corners = box_corners((self.x, self.y), self.angle, self.half_width, self.half_height)
        return 0.0 if in_polygon((x, y), corners) else edge_distance((x, y), corners)


@dataclass
class Agent:
    row: int
    side: int
    x: float
    y: float
    vx: float
    vy: float
    angle: float
    radius: float
    holds: int
    aloft: int
    sees: set[int]  # rows
    observes: set[int]


@dataclass
class Naive:
    """One world of a game, as its tables have it."""

    agents: list[Agent]
    things: list[Thing]
    walls: list[Thing]
    close: list[str] = field(default_factory=list)  # what float32 might decide otherwise
    events: list[tuple[int, int, int]] = field(default_factory=list)  # agent, thing, locked

    def gap(self, agent: Agent, thing: Thing, limit: float) -> float:
        found = thing.distance(agent.x, agent.y) - agent.radius
        if abs(found - limit) < 1e-4:
            self.close.append(f"{thing.kind} {thing.row} at {found} of {limit}")
        return found

    def nearest(self, agent: Agent, reach: float, fits: Any) -> Thing | None:
        gaps = [(max(self.gap(agent, t, reach), 0.0), t) for t in self.things if t.row in agent.sees and fits(t)]
        gaps = sorted(((gap, t) for gap, t in gaps if gap <= reach), key=lambda each: (each[0], each[1].row))
        if len(gaps) > 1 and 0 < gaps[1][0] - gaps[0][0] < 1e-4:
            self.close.append("two things are as near")
        return gaps[0][1] if gaps else None

    def handle(self, actions: Any, reach: float) -> None:
        """Lock in order of agents, then grab in order of agents."""
        for agent, (_, lock) in zip(self.agents, actions, strict=True):
            if lock == 0 or agent.aloft:
                continue
            owner = -1 if lock > 0 else agent.side
            thing = self.nearest(agent, reach, lambda t, o=owner: t.locked_by == o and (o >= 0 or t.lockable))
            if thing is not None:
                thing.locked_by = agent.side if lock > 0 else -1
                self.events.append((agent.row, thing.row, int(lock > 0)))
                for other in self.agents:
                    if lock > 0 and other.holds == thing.row:
                        other.holds = -1
        for agent, (grab, _) in zip(self.agents, actions, strict=True):
            if not grab or agent.aloft:
                agent.holds = -1
            elif agent.holds < 0:
                thing = self.nearest(agent, reach, lambda t: t.locked_by < 0)
                agent.holds = thing.row if thing else -1

    def idle(self, reach: float) -> list[tuple[int, int]]:
        """For each agent, whether neither value of grab, and no value of lock, changes anything."""
        found = []
        for agent in self.agents:
            able = not agent.aloft
            grabs = able and self.nearest(agent, reach, lambda t: t.locked_by < 0)
            side = agent.side
            locks = able and self.nearest(
                agent, reach, lambda t, s=side: t.locked_by == s or (t.locked_by < 0 and t.lockable)
            )
            found.append((int(not grabs and agent.holds < 0), int(not locks)))
        return found

    def steer(self, actions: Any, speed: float, waits: bool) -> None:
        """Set the velocities that agents want; seekers who wait have none."""
        for agent, (ahead, left) in zip(self.agents, actions, strict=True):
            wanted = complex(ahead, left) * complex(math.cos(agent.angle), math.sin(agent.angle)) * speed / 3
            agent.vx, agent.vy = (0.0, 0.0) if waits and agent.side == 1 else (wanted.real, wanted.imag)

    def climb(self, ticks: int) -> None:
        """Say who is aloft, from where all stand and how agents want to move."""
        for agent in self.agents:
            if agent.aloft:
                below = [t for t in self.things if self.gap(agent, t, 0.0) <= 0]
                over = bool(below) or any(self.gap(agent, wall, 0.0) <= 0 for wall in self.walls)
                if any(t.kind == "ramp" for t in below):
                    agent.aloft = ticks
                elif agent.aloft > 1 or not over:
                    agent.aloft -= 1
                continue
            for ramp in (t for t in self.things if t.kind == "ramp"):
                turn = complex(math.cos(ramp.angle), -math.sin(ramp.angle))
                place = complex(agent.x - ramp.x, agent.y - ramp.y) * turn
                up = (complex(agent.vx - ramp.vx, agent.vy - ramp.vy) * turn).real
                low = -ramp.half_width - agent.radius - 0.2, -ramp.half_width + 0.2
                edges = abs(place.imag) - ramp.half_height, place.real - low[0], place.real - low[1], up
                if min(map(abs, edges)) < 1e-4:
                    self.close.append("at the edge of a ramp")
                if edges[0] < 0 and low[0] < place.real < low[1] and up > 0:
                    agent.aloft = ticks
                    break

    def pays(self, reward: float, rule: str) -> list[float]:
        """The rewards of a tick after the preparation."""
        hiders, seekers = ([a for a in self.agents if a.side == side] for side in (0, 1))
        hidden = [1.0 if not any(h.row in s.observes for s in seekers) else -1.0 for h in hiders]
        seen = [1.0 if any(h.row in s.observes for h in hiders) else -1.0 for s in seekers]
        if rule == "joint":
            hidden, seen = [min(hidden)] * len(hiders), [max(seen)] * len(seekers)
        elif rule == "mean":
            hidden, seen = [float(np.mean(hidden))] * len(hiders), [float(np.mean(seen))] * len(seekers)
        return [reward * value for value in (*hidden, *seen)]


def naive(env: Any, w: int) -> Naive:
    """Read world `w` of an environment."""
    worlds = env.worlds
    body, shape, alive = worlds[Body], worlds[Shape], worlds[Entity].alive
    bits = lambda table, i: {e for e in range(worlds.layout.dims["rows"]) if table[w, i, e // 16] >> e % 16 & 1}  # noqa: E731

    def thing(kind: str, e: int) -> Thing:
        place = (float(getattr(body, name)[w, e]) for name in ("x", "y", "angle"))
        half = float(shape.half_width[w, e]), float(shape.half_height[w, e])
        movable, motion = kind in ("crate", "plank", "ramp"), (float(body.vx[w, e]), float(body.vy[w, e]))
        locks = (int(worlds[Movable].locked_by[w, e]), bool(worlds[Movable].lockable[w, e])) if movable else (-1, False)
        return Thing(e, kind, *locks, *place, *half, *motion)

    def rows(kind: str) -> list[Thing]:
        found = worlds.span(kind) if kind in worlds.layout.archetypes else slice(0, 0)
        return [thing(kind, e) for e in range(found.start, found.stop) if alive[w, e]]

    agents = []
    for i, e in enumerate(range(worlds.span("agent").start, worlds.span("agent").stop)):
        numbers = (float(table[w, e]) for table in (body.x, body.y, body.vx, body.vy, body.angle, shape.radius))
        aloft = int(worlds[Aloft].ticks[w, e])
        sight = bits(worlds[Sight].visible, i), bits(worlds[ObservationMasks].mask, i)
        agents.append(Agent(e, int(worlds[Side].side[w, e]), *numbers, int(worlds[Weld].other[w, e]), aloft, *sight))
    things = [each for kind in ("crate", "plank", "ramp") for each in rows(kind)]
    return Naive(agents, things, [*rows("inner_wall"), *rows("wall")])

"""Situations: small scenes of the survival game with a known solution, which a policy passes or fails.

Each puts the first agent into a scene of its own game, at a random place and heading in each world, and plays it for
some ticks. Other agents stand still, unless the scene has an attacker; those that are not part of it are far behind.
"""

import contextlib
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import outlast
from outlast.components import Body, Box, Health, Item, Wall, Zone
from outlast.ecs import Clock, Entity
from outlast.envs.core.spaces import side
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.rollout import policies
from outlast.envs.rollout.policies import AIMED, STRIKE, SWEEP, Intent, Seen, closer, first, follow, unit
from outlast.envs.rollout.saved import common_scenario
from outlast.envs.scenarios.scenario import Scenario

from ..arena.match import Act
from ..arena.players import Contender
from .tasks import SITUATION_SEED

Array = np.ndarray[Any, Any]
Places = dict[str, tuple[float, ...]]  # the arguments of `Scene.put` by name
WORLDS, SEED = 64, SITUATION_SEED  # games of a situation, and the seed of their worlds, which training may not use
MIDDLE = 1.0  # metres: the first agent begins at most so far from the middle of the room, along both axes
AWAY, APART = -10.5, 1.5  # metres: where agents wait that are not part of a scene, and how far from each other
WEAK, HURT, FULL = 10, 30, 100  # hit points
FAR = 3.0  # metres: beyond what an agent slows down for
PHASE = 3  # of the zone, in a scene with a rim
SHARE = 0.9  # of the games: a policy that passes at least so many passes the situation
OPEN, FIXED = "open floor", "fixed number of agents"  # what every situation needs
NEEDS = {"heal": "heal", "box": "box", "box_item": "box", "mate": "mate", "other": "enemies", "zone": "zone"}


class Scene:
    """Worlds that have been reset, seen from the first agent: `ahead` of it, and to its `left`.

    Names are "me", "mate", "enemy" and "other", an enemy too, of agents; "heal", "box" and "box_item".
    """

    def __init__(self, env: SurvivalVectorEnv, seed: int) -> None:
        """Put all agents but the first far behind, and remove all else."""
        self.env, self.worlds, rng = env, env.worlds, np.random.default_rng(seed)
        self.heading = rng.uniform(-math.pi, math.pi, env.num_worlds)
        self.x, self.y = rng.uniform(-MIDDLE, MIDDLE, (2, env.num_worlds))
        sides = side(env.worlds)[0]
        mates, enemies = np.flatnonzero(sides == sides[0])[1:].tolist(), np.flatnonzero(sides != sides[0]).tolist()
        self.agents: dict[str | int, Any] = {number: number for number in (*mates, *enemies)} | {"me": 0}
        self.agents |= {**dict(zip(["mate"], mates)), **dict(zip(["enemy", "other"], enemies))}
        for kind in ("heal", "box", "box_item"):
            self.worlds[Entity].alive[:, self.worlds.span(kind)] = 0
        for k, number in enumerate((*mates, *enemies)):
            self.put(number, AWAY, APART * (k - 1), math.pi)
        self.put("me")

    def put(self, name: str | int, ahead: float = 0, left: float = 0, turned: float = 0, points: float = FULL) -> None:
        """Put an entity somewhere, turned to the left by so many radians; or the rim of the zone so far ahead."""
        if name == "zone":  # a phase of it begins, so that the first agent is so far beyond its rim, which is ahead
            numbers = self.env.scenario.numbers()
            centre = np.stack(self._at(numbers["safe_zone_radii"][PHASE] + ahead), -1)
            self.worlds[Zone].centres[:, PHASE : PHASE + 2] = centre[:, None]
            self.worlds[Clock].tick[:] = PHASE * (numbers["safe_zone_stand"] + numbers["safe_zone_shrink"])
            return
        (x, y), angle = self._at(ahead, left), self.heading + turned
        if name in self.agents:
            self.env.place("agent", self.agents[name], x=x, y=y, angle=angle, points=points)
        else:
            self.env.place(str(name), 0, x=x, y=y, angle=angle)

    def _at(self, ahead: float, left: float = 0.0) -> tuple[Array, Array]:
        cosine, sine = np.cos(self.heading), np.sin(self.heading)
        return self.x + ahead * cosine - left * sine, self.y + ahead * sine + left * cosine

    def row(self, name: str) -> int:
        """Return the row of an entity."""
        kind = "agent" if name in self.agents else name
        return int(self.worlds.span(kind).start + self.agents.get(name, 0))

    def points(self) -> Array:
        """Return the hit points of the first agent, (worlds,)."""
        return self.worlds[Health].points[:, self.row("me")]

    def carries(self, name: str, item: str) -> Array:
        """Return whether an agent carries an item, bool (worlds,)."""
        return self.worlds[Item].holder[:, self.row(item)] == self.row(name)

    def healed(self) -> Array:
        """Return whether the first agent carries the heal or has used it unhurt, bool (worlds,)."""
        return self.carries("me", "heal") | (self.points() > FULL)

    def alive(self, name: str) -> Array:
        """Return whether an agent lives, bool (worlds,)."""
        return self.worlds[Entity].alive[:, self.row(name)] > 0

    def safe(self) -> Array:
        """Return whether the first agent lives inside the zone, bool (worlds,)."""
        zone, body, me = self.worlds[Zone], self.worlds[Body], self.row("me")
        away = np.hypot(body.x[:, me] - zone.x[:, 0], body.y[:, me] - zone.y[:, 0])
        return self.alive("me") & (away <= zone.radius[:, 0])

    def shielded(self) -> Array:
        """Return whether a box that was set up is between the first agent and the enemy, bool (worlds,)."""
        rows = self.worlds.span("box")
        placed = (self.worlds[Entity].alive[:, rows] * self.worlds[Box].placed[:, rows]).any(1)
        found = placed & self.alive("enemy") & self.alive("me")
        for w in np.flatnonzero(found):
            found[w] = not self.env.query(int(w)).line_of_sight(self.row("me"), self.row("enemy"))
        return found


@dataclass(frozen=True)
class Situation:
    """A scene, and what it takes to pass it.

    scene: What is where. passed: Returns in which worlds the agent has done it, bool (worlds,). solution: A style that
    passes. ticks: How long the agent has. lasting: Whether it must be so at the end, and not only at some time. capped:
    Whether the game must have a limit of hit points. attacked: Whether the enemy is a hunter, and does not stand still.
    """

    name: str
    scene: Places
    passed: Callable[[Scene], Array]
    solution: Callable[[Seen], Intent]
    ticks: int = 120
    lasting: bool = False
    capped: bool = False
    attacked: bool = False

    def lacks(self, env: SurvivalVectorEnv) -> str:
        """Return what the game lacks for this situation; "" if it can be played."""
        layout, sides = env.worlds.layout, side(env.worlds)[0]
        there = {
            OPEN: not len(layout.rows(Wall)),
            FIXED: len(layout.agent_counts) == 1,
            "heal": len(layout.spans.get("heal", ())),
            "box": len(layout.spans.get("box", ())),
            "mate": (sides == sides[0]).sum() > 1,
            "enemies": (sides != sides[0]).sum() > 1,
            "cap": env.scenario.numbers().get("mortality_limit", 0) > 0,
            "zone": "safe_zone" in env.scenario,
        }
        needs = [OPEN, FIXED, *(NEEDS[name] for name in self.scene if name in NEEDS), *["cap"] * self.capped]
        return next((need for need in needs if not there[need]), "")


def weakest(seen: Seen) -> Intent:
    """Strike the weakest enemy in sight; without one, turn on the spot."""
    health = np.where(seen.enemies > 0, seen.health_of("others"), np.inf)
    enemy = seen.nearest("others", seen.enemies * (health == health.min(-1, keepdims=True)))
    return Intent(enemy.place_or(seen.position), seen.towards(enemy, SWEEP), enemy.distance < STRIKE)


def breaking(seen: Seen) -> Intent:
    """Fetch the nearest item; without one in sight, break the nearest box."""
    item, box = closer(seen.nearest("heals"), seen.nearest("box_items")), seen.nearest("boxes")
    target = first(item, box)
    return Intent(target.place_or(seen.position), seen.towards(target, SWEEP), ~item.seen & (box.distance < STRIKE))


def fleeing(seen: Seen) -> Intent:
    """Run straight away from the nearest enemy in sight, and keep it in sight."""
    enemy = seen.nearest("others", seen.enemies)
    away = seen.position + FAR * unit(seen.position - enemy.place)
    return Intent(np.where(enemy.seen[..., None], away, seen.position), seen.towards(enemy, SWEEP), attack=False)


def covering(seen: Seen) -> Intent:
    """Turn to an enemy, set up a box as soon as that is straight ahead, and step behind it."""
    enemy, box, armed = seen.nearest("others", seen.enemies), seen.nearest("boxes"), seen.holds("box_slot")
    error = seen.towards(enemy, SWEEP)
    behind = box.place + unit(box.place - enemy.place)
    goal = np.where((box.seen & enemy.seen & ~armed)[..., None], behind, seen.position)
    return Intent(goal, error, attack=False, use=armed & enemy.seen & (np.abs(error) < AIMED / 2))


BACK, RIGHT = math.pi, -math.pi / 2  # radians: towards the first agent, from ahead of it and from its left
TWO: Places = {"enemy": (1.2, 0.7), "other": (1.5, -0.7, 0, WEAK)}
CHASE: Places = {"me": (0, 0, 0, WEAK), "enemy": (6, 0, BACK)}
PAIR: Places = {"heal": (0.2,), "mate": (3, 0, BACK, HURT)}
SITUATIONS = (
    Situation("heal behind", {"heal": (-4, 0.5)}, Scene.healed, policies.hoarder),
    Situation("hurt", {"heal": (0.2,), "me": (0, 0, 0, HURT)}, lambda scene: scene.points() > HURT, policies.scripted),
    Situation(
        "unhurt", {"heal": (3,)}, lambda scene: scene.carries("me", "heal"), policies.hoarder, lasting=True, capped=True
    ),
    Situation("beyond the rim", {"zone": (3,)}, Scene.safe, policies.scripted, lasting=True),
    Situation("weak enemy", {"enemy": (1.5, 0, 0, WEAK)}, lambda scene: ~scene.alive("enemy"), policies.hunter),
    Situation("enemy behind", {"enemy": (-4, 0.5, 0, WEAK)}, lambda scene: ~scene.alive("enemy"), weakest),
    Situation("weakest first", TWO, lambda scene: ~scene.alive("other"), weakest, ticks=15),
    Situation("hunted", CHASE, lambda scene: scene.alive("me"), fleeing, ticks=45, lasting=True, attacked=True),
    Situation("wounded mate", PAIR, lambda scene: scene.carries("mate", "heal"), policies.healer),
    Situation("box", {"box": (2,)}, lambda scene: scene.carries("me", "box_item"), breaking),
    Situation("heal behind a box", {"heal": (4.5,), "box": (2.5,)}, Scene.healed, breaking),
    Situation("cover", {"box_item": (0.2,), "enemy": (0, 9, RIGHT)}, Scene.shielded, covering, attacked=True),
)


def attempt(
    situation: Situation, scenario: Scenario, contender: Contender | None = None, worlds: int = WORLDS
) -> Array | str:
    """Return in which worlds a policy, or the solution, passes, bool (worlds,), or what the game lacks for that."""
    game = common_scenario(scenario, [contender.player] if contender and contender.player else [])
    with contextlib.closing(outlast.make_vec(game, worlds, seed=SEED, autoreset_mode="Disabled")) as env:
        env.reset(seed=SEED)
        if lacking := situation.lacks(env):
            return lacking
        solution, attacker = follow(situation.solution, env), follow(policies.hunter, env)
        act: Act = lambda seen, where: solution(seen)[where]  # noqa: E731
        if contender is not None:
            contender.check(env)
            act = contender.act(env, SEED, keyed=True)
        scene = Scene(env, SEED)
        for name, place in situation.scene.items():
            scene.put(name, *place)
        me, done, found = (np.arange(worlds), np.zeros(worlds, int)), *np.zeros((2, worlds), bool)
        for tick in range(situation.ticks):
            actions = np.tile(env.noop, (worlds, env.num_agents, 1))
            if tick:  # the scene is observed from the second tick on
                seen = env.observe()
                actions[me] = act(seen, me)
                if situation.attacked:
                    actions[:, scene.agents["enemy"]] = attacker(seen)[:, scene.agents["enemy"]]
            _, _, terminated, truncated, _ = env.step(actions)
            now = situation.passed(scene)
            found = np.where(done, found, now if situation.lasting else found | now)
            if (over := terminated | truncated).any():  # what comes after an episode does not count
                done |= over
                env.reset(options={"reset_mask": over})
            if done.all():
                break
    return found


def shares(
    scenario: Scenario, contender: Contender | None, progress: Callable[[int], None] = lambda done: None
) -> dict[str, float | str]:
    """Return the share of worlds in which a policy, or the solution, passes each situation, or what the game lacks."""
    found = dict[str, float | str]()
    for situation in SITUATIONS:
        played = attempt(situation, scenario, contender)
        found[situation.name] = played if isinstance(played, str) else float(played.mean())
        progress(1)
    return found


def passed(scenario: Scenario, contender: Contender) -> dict[str, float]:
    """Return the share of worlds in which a policy passes each situation that the game has."""
    return {name: value for name, value in shares(scenario, contender).items() if not isinstance(value, str)}


def table(columns: Sequence[dict[str, float | str]]) -> list[tuple[str, ...]]:
    """Return a row for each situation: its name, and the results of `shares` of its solution and of each policy.

    The last row counts the situations that are passed in at least SHARE of the worlds.
    """
    rows = list[tuple[str, ...]]()
    for name, value in columns[0].items():
        lacking = [f"no {value}", *[""] * (len(columns) - 1)] if isinstance(value, str) else []
        rows.append((name, *(lacking or (f"{own[name]:.2f}" for own in columns))))
    played = [[value for value in own.values() if not isinstance(value, str)] for own in columns]
    return [*rows, ("passed", *(f"{sum(value >= SHARE for value in own)} of {len(own)}" for own in played))]

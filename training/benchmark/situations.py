"""Situations: small scenes of the survival game with a known solution, which a policy passes or fails.

Ratings show whom an agent beats, situations what it can do. Each puts the first agent into a scene of its own game, at
a random place and heading in each world, and plays it for some ticks. All other agents stand still, unless the scene
has an attacker; those that are not part of it are far behind. The solution of a situation, one of the scripted styles
or a function like these, passes it.
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
from outlast.envs.core.agents import side
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.rollout.policies import STYLES, Policy
from outlast.envs.rollout.saved import common_scenario
from outlast.envs.rollout.styles import AIMED, STRIKE, SWEEP, Intent, Seen, closer, first, follow, unit
from outlast.envs.scenarios.scenario import Scenario

from ..arena.players import Contender
from .tasks import SITUATION_SEED

Array = np.ndarray[Any, Any]
WORLDS, SEED = 64, SITUATION_SEED  # games of a situation, and the seed of their worlds, which training may not use
MIDDLE = 1.0  # metres: the first agent begins at most so far from the middle of the room, along both axes
AWAY, APART = -10.5, 1.5  # metres: where agents wait that are not part of a scene, and how far from each other
WEAK, HURT, FULL = 10, 30, 100  # hit points
FAR = 3.0  # metres: beyond what an agent slows down for
SHARE = 0.9  # of the games: a policy that passes at least so many passes the situation
OPEN, FIXED = "open floor", "fixed number of agents"  # what every situation needs


class Scene:
    """A situation in worlds that have been reset, seen from the first agent: `ahead` of it, and to its `left`.

    Attributes:
        me: Number of the agent that is tested: 0.
        mates: Numbers of the agents of its side.
        enemies: Numbers of all others.
    """

    def __init__(self, env: SurvivalVectorEnv, seed: int) -> None:
        """Put agents that are not part of the scene far behind, and remove all else."""
        self.env, self.worlds, rng = env, env.worlds, np.random.default_rng(seed)
        count = env.num_worlds
        self.heading = rng.uniform(-math.pi, math.pi, count)
        self.x, self.y = rng.uniform(-MIDDLE, MIDDLE, (2, count))
        sides = side(env.worlds)[0]
        self.me, self.mates = 0, [int(k) for k in np.flatnonzero(sides == sides[0])[1:]]
        self.enemies = [int(k) for k in np.flatnonzero(sides != sides[0])]
        for kind in ("heal", "box", "box_item"):
            self.worlds[Entity].alive[:, self.worlds.span(kind)] = 0
        for k, number in enumerate((*self.mates, *self.enemies)):
            self.agent(number, AWAY, APART * (k - 1), math.pi)
        self.agent(self.me, 0.0, 0.0)

    def put(self, kind: str, number: int, ahead: float, left: float, turned: float = 0.0, **values: Any) -> int:
        """Put an entity somewhere, and return its row. turned: How far it is turned to the left, radians."""
        cosine, sine = np.cos(self.heading), np.sin(self.heading)
        x, y = self.x + ahead * cosine - left * sine, self.y + ahead * sine + left * cosine
        return self.env.place(kind, number, x=x, y=y, angle=self.heading + turned, **values)

    def agent(self, number: int, ahead: float, left: float, turned: float = 0.0, points: int = FULL) -> int:
        """Put an agent somewhere, and return its row."""
        return self.put("agent", number, ahead, left, turned, points=points)

    def heal(self, number: int, ahead: float, left: float = 0.0) -> int:
        """Put a heal somewhere, and return its row."""
        return self.put("heal", number, ahead, left)

    def zone(self, phase: int, beyond: float) -> None:
        """Let a phase of the zone begin, so that the first agent is so many metres beyond its rim, which is ahead."""
        numbers = self.env.scenario.numbers()
        ahead = numbers["safe_zone_radii"][phase] + beyond
        place = self.x + ahead * np.cos(self.heading), self.y + ahead * np.sin(self.heading)
        self.worlds[Zone].centres[:, phase : phase + 2] = np.stack(place, -1)[:, None]
        self.worlds[Clock].tick[:] = phase * (numbers["safe_zone_stand"] + numbers["safe_zone_shrink"])

    def points(self, number: int) -> Array:
        """Return the hit points of an agent, (worlds,)."""
        return np.asarray(self.worlds[Health].points[:, self.row(number)])

    def row(self, number: int) -> int:
        """Return the row of an agent."""
        return int(self.worlds.span("agent").start + number)

    def carries(self, number: int, item: int) -> Array:
        """Return whether an agent carries the item in row `item`, bool (worlds,)."""
        return np.asarray(self.worlds[Item].holder[:, item] == self.row(number))

    def alive(self, number: int) -> Array:
        """Return whether an agent lives, bool (worlds,)."""
        return np.asarray(self.worlds[Entity].alive[:, self.row(number)] > 0)

    def safe(self, number: int) -> Array:
        """Return whether an agent lives inside the zone, bool (worlds,)."""
        zone, body, row = self.worlds[Zone], self.worlds[Body], self.row(number)
        away = np.hypot(body.x[:, row] - zone.x[:, 0], body.y[:, row] - zone.y[:, 0])
        return np.asarray(self.alive(number) & (away <= zone.radius[:, 0]))

    def shielded(self, number: int) -> Array:
        """Return whether a box that was set up is between the first agent and another one, bool (worlds,)."""
        rows, (mine, other) = self.worlds.span("box"), map(self.row, (self.me, number))
        placed = (self.worlds[Entity].alive[:, rows] * self.worlds[Box].placed[:, rows]).any(1)
        found = placed & self.alive(number) & self.alive(self.me)
        for w in np.flatnonzero(found):
            found[w] = not self.env.query(int(w)).line_of_sight(mine, other)
        return np.asarray(found)


@dataclass(frozen=True)
class Situation:
    """A scene, and what it takes to pass it.

    Attributes:
        name: What tables call it.
        about: What an agent has to do.
        arrange: Puts entities into the scene. What it returns is handed on to `passed`.
        passed: Returns in which worlds the agent has done it, bool (worlds,).
        solution: The name of a style that passes, or a style.
        ticks: How long the agent has.
        lasting: Whether it must be so at the end, and not only at some time.
        needs: What a game must have, beside an open floor and always as many agents: "heal" and "box", entities;
            "mate"; "enemies", at least two; "cap", a limit of hit points; "zone".
        attacker: The style of the first enemy; "": it stands still, like all others.
    """

    name: str
    about: str
    arrange: Callable[[Scene], Any]
    passed: Callable[[Scene, Any], Array]
    solution: str | Callable[[Seen], Intent]
    ticks: int = 120
    lasting: bool = False
    needs: tuple[str, ...] = ()
    attacker: str = ""

    def lacks(self, env: SurvivalVectorEnv) -> str:
        """Return what the game lacks for this situation; "" if it can be played."""
        layout, numbers = env.worlds.layout, env.scenario.numbers()
        spans, sides = layout.spans, side(env.worlds)[0]
        there = {
            OPEN: not len(layout.rows(Wall)),
            FIXED: len(layout.agent_counts) == 1,
            "heal": len(spans.get("heal", ())) > 0,
            "box": len(spans.get("box", ())) > 0,
            "mate": int((sides == sides[0]).sum()) > 1,
            "enemies": int((sides != sides[0]).sum()) > 1,
            "cap": numbers.get("mortality_limit", 0) > 0,
            "zone": "safe_zone" in env.scenario,
        }
        return next((need for need in (OPEN, FIXED, *self.needs) if not there[need]), "")


def weakest(seen: Seen) -> Intent:
    """Strike the weakest enemy in sight."""
    health = np.where(seen.enemies > 0, seen.health_of("others"), np.inf)
    enemy = seen.nearest("others", seen.enemies * (health == health.min(-1, keepdims=True)))
    return Intent(enemy.place_or(seen.position), seen.towards(enemy, 0.0), enemy.distance < STRIKE)


def searching(seen: Seen) -> Intent:
    """Turn on the spot until an enemy comes into sight, then go and strike it."""
    enemy = seen.nearest("others", seen.enemies)
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


def _mate(scene: Scene) -> int:
    scene.agent(scene.mates[0], 3.0, 0.0, math.pi, HURT)
    return scene.heal(0, 0.2)


def _two_enemies(scene: Scene) -> None:
    scene.agent(scene.enemies[0], 1.2, 0.7)
    scene.agent(scene.enemies[1], 1.5, -0.7, points=WEAK)


def _box_and_heal(scene: Scene) -> int:
    scene.put("box", 0, 2.5, 0.0)
    return scene.heal(0, 4.5)


def _cover(scene: Scene) -> None:
    scene.put("box_item", 0, 0.2, 0.0)
    scene.agent(scene.enemies[0], 0.0, 9.0, -math.pi / 2)


SITUATIONS = (
    Situation(
        "heal behind",
        "turn around and fetch a heal",
        lambda scene: scene.heal(0, -4.0, 0.5),
        lambda scene, heal: scene.carries(scene.me, heal) | (scene.points(scene.me) > FULL),
        "hoarder",
        needs=("heal",),
    ),
    Situation(
        "hurt",
        "use a heal with few hit points left",
        lambda scene: (scene.agent(scene.me, 0.0, 0.0, points=HURT), scene.heal(0, 0.2)),
        lambda scene, _: scene.points(scene.me) > HURT,
        "scripted",
        needs=("heal",),
    ),
    Situation(
        "unhurt",
        "fetch a heal, and keep it while it would be wasted",
        lambda scene: scene.heal(0, 3.0),
        lambda scene, heal: scene.carries(scene.me, heal),
        "hoarder",
        lasting=True,
        needs=("heal", "cap"),
    ),
    Situation(
        "beyond the rim",
        "go into the zone and stay there",
        lambda scene: scene.zone(3, 3.0),
        lambda scene, _: scene.safe(scene.me),
        "scripted",
        lasting=True,
        needs=("zone",),
    ),
    Situation(
        "weak enemy",
        "kill an enemy in reach",
        lambda scene: scene.agent(scene.enemies[0], 1.5, 0.0, points=WEAK),
        lambda scene, _: ~scene.alive(scene.enemies[0]),
        "hunter",
    ),
    Situation(
        "enemy behind",
        "find an enemy behind, and kill it",
        lambda scene: scene.agent(scene.enemies[0], -4.0, 0.5, points=WEAK),
        lambda scene, _: ~scene.alive(scene.enemies[0]),
        searching,
    ),
    Situation(
        "weakest first",
        "kill the weaker of two enemies first",
        _two_enemies,
        lambda scene, _: ~scene.alive(scene.enemies[1]),
        weakest,
        ticks=15,
        needs=("enemies",),
    ),
    Situation(
        "hunted",
        "survive a hunter with few hit points left",
        lambda scene: (scene.agent(scene.me, 0.0, 0.0, points=WEAK), scene.agent(scene.enemies[0], 6.0, 0.0, math.pi)),
        lambda scene, _: scene.alive(scene.me),
        fleeing,
        ticks=45,
        lasting=True,
        attacker="hunter",
    ),
    Situation(
        "wounded mate",
        "give a mate with few hit points a heal",
        _mate,
        lambda scene, heal: scene.carries(scene.mates[0], heal),
        "healer",
        needs=("heal", "mate"),
    ),
    Situation(
        "box",
        "break a box and pick up its item",
        lambda scene: scene.put("box", 0, 2.0, 0.0),
        lambda scene, _: scene.carries(scene.me, scene.worlds.span("box_item").start),
        breaking,
        needs=("box",),
    ),
    Situation(
        "heal behind a box",
        "get a heal that a box hides",
        _box_and_heal,
        lambda scene, heal: scene.carries(scene.me, heal) | (scene.points(scene.me) > FULL),
        breaking,
        needs=("heal", "box"),
    ),
    Situation(
        "cover",
        "put a box between oneself and an enemy",
        _cover,
        lambda scene, _: scene.shielded(scene.enemies[0]),
        covering,
        needs=("box",),
        attacker="hunter",
    ),
)


def _style(style: str | Callable[[Seen], Intent], env: SurvivalVectorEnv) -> Policy:
    return follow(STYLES[style] if isinstance(style, str) else style, env)


def attempt(
    situation: Situation, scenario: Scenario, contender: Contender | None = None, worlds: int = WORLDS
) -> Array | str:
    """Play a situation. Raises TrainingError: the policy cannot play in this game.

    contender: The policy; None: the solution. Returns whether it passed in each world, bool (worlds,), or what
    the game lacks.
    """
    saved = [contender.player] if contender is not None and contender.player is not None else []
    game = common_scenario(scenario, saved)
    with contextlib.closing(outlast.make_vec(game, worlds, seed=SEED, autoreset_mode="Disabled")) as env:
        env.reset(seed=SEED)
        return situation.lacks(env) or _play(situation, env, contender)


def _play(situation: Situation, env: SurvivalVectorEnv, contender: Contender | None) -> Array:
    """Return in which worlds a policy, or the solution, passes, bool (worlds,). env: Just reset."""
    if contender is not None:
        contender.check(env)
    solution = _style(situation.solution, env)
    act = contender.act(env, SEED, keyed=True) if contender else lambda seen, where: solution(seen)[where]
    attacker = _style(situation.attacker, env) if situation.attacker else None
    scene, worlds = Scene(env, SEED), env.num_worlds
    known, me = situation.arrange(scene), (np.arange(worlds), np.full(worlds, scene.me))
    done, found = np.zeros((2, worlds), bool)
    for tick in range(situation.ticks):
        actions = np.tile(env.noop, (worlds, env.num_agents, 1))
        if tick:  # the scene is observed from the second tick on
            seen = env.observe()
            actions[me] = act(seen, me)
            if attacker is not None:
                actions[:, scene.enemies[0]] = attacker(seen)[:, scene.enemies[0]]
        _, _, terminated, truncated, _ = env.step(actions)
        now = situation.passed(scene, known)
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
    """Return the share of worlds in which a policy passes each situation, or what the game lacks for it.

    contender: The policy; None: the solutions. progress: Called with 1 for each situation.
    """
    found = dict[str, float | str]()
    for situation in SITUATIONS:
        played = attempt(situation, scenario, contender)
        found[situation.name] = played if isinstance(played, str) else float(played.mean())
        progress(1)
    return found


def passed(scenario: Scenario, contender: Contender) -> dict[str, float]:
    """Return the share of worlds in which a policy passes each situation that the game has."""
    found = shares(scenario, contender)
    return {name: value for name, value in found.items() if not isinstance(value, str)}


def table(columns: Sequence[dict[str, float | str]]) -> list[tuple[str, ...]]:
    """Return a row for each situation: its name, and the results of `shares` of its solution and of each policy.

    The row of a situation that the game lacks something for says what. The last row counts the situations passed, in at
    least SHARE of the worlds.
    """
    rows, counts, played = list[tuple[str, ...]](), [0] * len(columns), 0
    for name in columns[0]:
        values = [own[name] for own in columns]
        if isinstance(values[0], str):
            rows.append((name, f"no {values[0]}", *[""] * (len(columns) - 1)))
            continue
        played += 1
        numbers = [float(value) for value in values]
        counts = [count + (number >= SHARE) for count, number in zip(counts, numbers, strict=True)]
        rows.append((name, *(f"{number:.2f}" for number in numbers)))
    return [*rows, ("passed", *(f"{count} of {played}" for count in counts))]

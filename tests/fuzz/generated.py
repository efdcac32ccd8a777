"""The source of random mechanics, as a user would write them: most are right, some have a mistake."""

import re
from random import Random

HEAD = '''"""Generated."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from outlast import systems
from outlast.components import *
from outlast.components.health import hurt
from outlast.ecs import *
from outlast.ecs.kernels.random import uniform
from outlast.components import Phase

HALF, ONE = np.float32(0.5), np.float32(1)


@kernel
def clamped(x: Any, most: Any) -> Any:
    return min(max(x, -most), most)


@kernel
def slowed(body: Any, e: int, factor: Any) -> None:
    body.vx[e], body.vy[e] = factor * body.vx[e], factor * body.vy[e]

'''

# Phases that a system of each kind is put into, its parameters and the body of its loop over agents.
ENTITY = "entities: Read[Entity]"
SYSTEMS: tuple[tuple[tuple[str, ...], str, str], ...] = (
    (("DRIVE", "MELEE", "EFFECT"), "body: Write[Body]", "slowed(body, e, ONE - HALF * rate)"),
    (
        ("DRIVE", "USE"),
        f"push: Write[Push], {ENTITY}, key: Random",
        "push.x[e] += rate * (uniform(key, entities.identity[e]) - HALF)",
    ),
    (("EFFECT", "ZONE", "MELEE"), "health: Add[Health]", "health.points[e] += amount"),
    (("EFFECT", "GIVE"), "health: Add[Health], body: Read[Body]", "health.points[e] -= int(body.x[e] > 0)"),
    (
        ("MELEE", "ZONE", "BREAK"),
        "health: Write[Health], hits: Write[Hit], guard: Read[Guard], clock: Read[Clock], damage_type: DamageType",
        "hurt(health, guard, hits, e, amount, damage_type, -1, clock.tick[0])",
    ),
    (("RECORD", "END"), "tally: Add[{name}Tally], health: Read[Health]", "tally.{stat}[0] += health.points[e] < 50"),
    (
        ("ZONE", "DIE", "PICKUP"),
        "mark: Write[{name}Mark], body: Read[Body]",
        "mark.level[e] = int(clamped(body.x[e], np.float32(9)))",
    ),
    (("SPAWN", "DRAW"), "mark: Write[{name}Mark], key: Random", "mark.level[e] = int(np.float32(9) * uniform(key, e))"),
    (("MOVE", "SEE"), "mark: Add[{name}Mark], side: Read[Side]", "mark.level[e] += 1 + side.side[e]"),
    (("USE", "SEE"), "sightings: Write[{name}Sighting]", "sightings.agent[emit(sightings)] = e"),
    (
        ("RECORD", "END"),
        "tally: Add[{name}Tally], sightings: Read[{name}Sighting], hits: Read[Hit]",
        "tally.{stat}[0] += e < sightings.count[0] and sightings.agent[e] == e\n"
        "        tally.{stat}[0] += hits.amount[e] if e < hits.count[0] else 0",
    ),
    (
        ("OBSERVE",),
        "view: Write[SelfView], mark: Read[{name}Mark], own_{field}: Offset",
        "view.own[e, own_{field}] = rate * np.float32(mark.level[e])",
    ),
)
MISTAKES: tuple[tuple[tuple[str, ...], str, str], ...] = (
    (("DRIVE",), "body: Write[Body]", "body.velocity[e] = rate"),
    (("DRIVE",), "body: Read[Body]", "body.vx[e] = rate"),
    (("DRIVE",), "body: Read[Body]", "slowed(body, e, rate)"),
    (("EFFECT",), "health: Add[Health]", "health.points[e] = amount"),
    (("EFFECT",), "health: Add[Health]", "health.points[e] *= amount"),
    (("EFFECT",), "health: Add[Health]", "health.points[e] += amont"),
    (("DRIVE",), "body: Write[Body]", "body.vx[e] = np.random.random()"),
    (("ZONE",), "mark: Write[{name}Mark]", "mark.level[e + 100000] = amount"),
    (("ZONE",), "mark: Write[{name}Mark]", "mark.level[e] = clamped(amount)"),
    (("SEE",), "sightings: Write[{name}Sighting]", "for _ in range(9):\n            emit(sightings)"),
    (("SEE",), "secrets: Write[{name}Secret]", "secrets.agent[emit(secrets)] = e"),
    (("SEE",), "sightings: Write[{name}Sighting]", "sightings.who[emit(sightings)] = e"),
    (("OBSERVE",), "view: Write[SelfView], own_{stat}: Offset", "view.own[e, own_{stat}] = rate"),
)
FIELDS = "# fields"  # where a mechanic declares its field
OWNERS = {  # what has systems in these phases
    "DRIVE": "motors", "MELEE": "melee", "EFFECT": "heals", "ZONE": "safe_zone", "USE": "inventory",
    "GIVE": "give_last", "MOVE": "physics", "SEE": "cameras", "DIE": "mortality", "PICKUP": "pickup",
    "BREAK": "boxes", "RECORD": "record", "END": "ending", "SPAWN": "room", "DRAW": "safe_zone",
    "OBSERVE": "agents",
}  # fmt: skip


def source(rng: Random, name: str, mechanics: list[str]) -> str:
    """A file with MECHANICS, a list of classes. mechanics: classes of outlast's that can be subclassed."""
    text, classes = HEAD, []
    for k in range(rng.choice((1, 1, 2, 3))):
        classes.append(f"{name.title().replace('_', '')}{'ABC'[k]}")
        if mechanics and rng.random() < 0.3:
            text += _subclass(rng, classes[-1], mechanics.pop(rng.randrange(len(mechanics))))
        else:
            text += _mechanic(rng, classes[-1], [_snake(each) for each in mechanics])
    return text + f"\n\nMECHANICS = [{', '.join(classes)}]\n"


def _mechanic(rng: Random, name: str, others: list[str]) -> str:
    stat, field = f"{name.lower()}_low", "mark" if rng.random() < 0.05 else f"{name.lower()}_mark"
    text = f'''

class {name}Mark(Component):
    level: Array = column("i4", fill={rng.randrange(5)})


class {name}Tally(Statistic):
    {stat}: Array = column("i4")


class {name}Sighting(Event, capacity="{stat}"):
    agent: Array = column("i4", unit="entity")


class {name}Secret(Event, capacity=Side):  # which nobody brings
    agent: Array = column("i4", unit="entity")


@dataclass(frozen=True)
class {name}(Module):
    damage_type: ClassVar[str] = "{name.lower()}"

    rate: float = number({rng.choice((0.25, 0.5, 1.0))}, low=0)
    amount: int = number({rng.randrange(1, 6)}, low=0)

    def archetypes(self) -> Any:
        return [Archetype("agent", ({name}Mark(),))]

    def singletons(self) -> Any:
        return [{name}Tally(), {name}Sighting(), Hit()]

    def dims(self) -> dict[str, int | str]:
        return {{"hits": "agents + agents + agents", "{stat}": "agents + agents + agents"}}
{FIELDS}'''
    fields = f'''
    def fields(self) -> Any:
        return {{"own": (Field("{field}", "marks", scale=9.0, order={rng.choice((0, 0, -1))}),)}}
'''
    before = ""
    for k in range(rng.choice((1, 1, 2, 3))):
        phases, parameters, body = rng.choice(MISTAKES if rng.random() < 0.08 else SYSTEMS)
        parameters, body = (part.format(name=name, stat=stat, field=field) for part in (parameters, body))
        phase = rng.choice(phases)
        other = rng.choice([*others, "nobody"]) if rng.random() < 0.03 else OWNERS[phase]
        orders = [f', after="{other}"'] * 4 + [f', before="{other}"', ""]
        if written := re.findall(r"(?:Write|Add)\[(\w+)\]", parameters):
            orders += [f", after={written[0]}"] * 4 + [f", before={written[0]}"]
        after = f', after=("{other}", "{_snake(name)}.act{k - 1}")' if phase == before else rng.choice(orders)
        before = phase
        text += f"""

@{name}.system(Phase.{phase}{after})
def act{k}({parameters}, agents: Rows[Side], rate: float, amount: int) -> None:
    for e in agents:
        {body}
"""
    return text.replace(FIELDS, fields if f"own_{field}" in text else "")  # a field that nobody writes is refused


def _subclass(rng: Random, name: str, base: str) -> str:
    """A subclass with a changed number, and perhaps a mark that each of its agents gets."""
    text = f"\n\n\n@dataclass(frozen=True)\nclass {name}(systems.{base}):\n    # a {base} of its own\n    pass\n"
    if base == "Melee":
        text += f"\n    damage = {rng.randrange(1, 30)}\n"
        if rng.random() < 0.5:
            text += f'''

@{name}.system(Phase.MELEE, after="{_snake(name)}.aim")
def strike(weapon: Read[Weapon], health: Add[Health], agents: Rows[Weapon], damage: int) -> None:
    for me in agents:
        if weapon.target[me] >= 0:
            health.points[weapon.target[me]] -= damage
'''
    return text


def _snake(name: str) -> str:
    return "".join(f"_{c.lower()}" if c.isupper() else c for c in name).lstrip("_")

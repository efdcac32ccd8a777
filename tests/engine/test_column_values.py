"""Values that columns cannot hold, and indices that they do not have, are refused."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Bag, Body, Health, Hit, Item, ObservationMasks, Phase, Side
from outlast.components.inventory import place, push
from outlast.components.sight import is_set
from outlast.ecs import (
    AbsentError,
    Add,
    Archetype,
    Component,
    Entity,
    Module,
    RangeError,
    Read,
    Rows,
    Singleton,
    Write,
    column,
    exists,
    number,
    of,
)
from tests.conftest import COMPILED
from tests.helpers.mechanics import DUEL, duel, idle, kind, written

USED = Add, Bag, Body, Entity, Hit, Item, ObservationMasks, Read, exists, is_set, place, push  # by lines of systems
pytestmark = pytest.mark.usefixtures("untried")
interpreted = pytest.mark.parametrize("interpret", [False, True])


class Marks(Component):
    mark: Any = column("i4", unit="entity")
    last: Any = column("i4", low=5, fill=5)  # rows without the component hold 0


class Marked(Singleton):
    marked: Any = column("i4", 2, below="rows")


Marker = kind("Marker", archetypes=[Archetype("agent", (Marks(),))], singletons=[Marked()])


def acting(parameters: str, line: str, phase: Phase, interpret: bool, game: outlast.Scenario = DUEL) -> Any:
    """Two duels, or eight, with a mechanic `mine` whose system runs this line; e: the first agent."""
    given = [f"{table.lower()}: {access}[{table}]" for access, table in map(str.split, parameters.split(", "))]
    source = f"def act({', '.join(given)}, agents: Rows[Side]) -> None:\n    e = agents[0]\n    {line}\n"
    mine = kind("Mine", Marker)
    mine.system(phase, **({"before": "melee.strike"} if phase is Phase.MELEE else {}))(written(source, globals()))
    options = {"interpret": ("mine.act",)} if interpret else {}
    return duel(mine(), game=game, count=8 if game.varied else 2, **options)


@interpreted
@pytest.mark.parametrize(
    ("parameters", "line", "phase", "words"),
    [
        ("Write Side", "side.side[e] = 7", Phase.RESPAWN, r"agent\.Side\.side after mine\.act: .*: -1 to 1 is"),
        ("Write Bag", "bag.items[e, 0], bag.count[e] = -1, 99", Phase.MELEE, r"inventory\.Bag\.count .*: 0 to 4 is"),
        ("Write Entity", "entity.alive[e] += 1", Phase.RESPAWN, r"component\.Entity\.alive .*: 0 to 1 is needed"),
        ("Write Marks", "marks.mark[e] -= 2", Phase.MELEE, r"Marks\.mark after mine\.act: .*: -1 to \d+ is needed"),
        ("Add Marked", "marked.marked[1] -= 1", Phase.MELEE, r"Marked\.marked after mine\.act: .*: 0 to \d+ is"),
        ("Write Hit", "hit.count[0] -= 1", Phase.MELEE, r"Hit\.count after mine\.act: .*: 0 to 4 is needed"),
    ],
)
def test_integers_that_a_column_cannot_hold_are_refused(
    parameters: str, line: str, phase: Phase, words: str, interpret: bool
) -> None:
    env = acting(parameters, line, phase, interpret)
    with pytest.raises(RangeError, match=words):
        env.step(idle(env))


@interpreted
@pytest.mark.parametrize(
    ("parameters", "line"),
    [
        ("Write Bag, Write Item", "push(bag, item, e, 100_000)"),
        ("Write Body, Write Entity", "place(body, entity, 100_000 + e, 0.0, 0.0)"),
        ("Write Side, Read ObservationMasks",
         "side.side[e] = side.side[e] - is_set(observationmasks.filled, 10_000_000 + e, 3)"),
    ],
)  # fmt: skip
def test_functions_of_outlast_check_the_indices_that_others_give_them(
    parameters: str, line: str, interpret: bool
) -> None:
    env = acting(parameters, line, Phase.RESPAWN, interpret)
    named = "^mine.act.*" if COMPILED and not interpret else ""
    with pytest.raises(IndexError, match=f"{named}out of bounds"):
        env.step(idle(env))


@dataclass(frozen=True)
class Far(Module):
    harm: float = number(15.0, per_agent=True)


@Far.system(Phase.DRIVE)
def outside(health: Write[Health], agents: Rows[Side], harm: float) -> None:
    health.points[agents[0]] = np.int32(of(harm, 1000))


@interpreted
def test_the_row_of_a_number_is_checked(interpret: bool) -> None:
    game = DUEL.with_(Far()).roles(a=outlast.role(1, far_harm=100.0), b=outlast.role())
    env = duel(game=game, interpret=("far.outside",) if interpret else ())
    with pytest.raises(IndexError, match="the row is out of bounds"):
        env.step(idle(env))


RISE = "for k in agents:\n        if not entity.alive[k]{}:\n            entity.alive[k], health.points[k] = 1, 100"


@interpreted
def test_who_is_absent_is_not_brought_back(interpret: bool) -> None:
    varied = DUEL.replace(ending_rule="never", ending_limit=9).vary(n_agents=outlast.distributions.integers(1, 3))
    env = acting("Write Entity, Write Health", RISE.format(""), Phase.RESPAWN, interpret, varied)
    with pytest.raises(AbsentError, match=r"(after mine.act: )?an entity is alive .* exists\(entities, e\) is False"):
        env.step(idle(env))
    line = RISE.format(" and exists(entity, k)")
    env = acting("Write Entity, Write Health", line, Phase.RESPAWN, interpret, varied)
    present = env.reset()[1]["present"]
    assert not present.all()
    env.worlds[Health].points[:] = 0
    for _ in range(2):
        info = env.step(idle(env))[-1]
    assert (info["alive"] == present).all()

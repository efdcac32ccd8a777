"""Values that columns cannot hold, indices that they do not have and floats for integers are refused."""

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
    Array,
    Component,
    DeclarationError,
    Entity,
    Module,
    RangeError,
    Read,
    Rows,
    Singleton,
    Write,
    column,
    exists,
    kernel,
    number,
    of,
)
from tests.conftest import COMPILED
from tests.helpers.mechanics import DUEL, duel, idle, kind

pytestmark = pytest.mark.usefixtures("untried")
interpreted = pytest.mark.parametrize("interpret", [False, True])


class Marks(Component):
    mark: Any = column("i4", unit="entity")
    last: Any = column("i4", low=5, fill=5)  # rows without the component hold 0
    whole: Array = column("i4")
    small: Array = column("u1")
    real: Array = column("f4", fill=2.7)


class Marked(Singleton):
    marked: Any = column("i4", 2, below="rows")


Marker = kind("Marker", archetypes=[Archetype("agent", (Marks(),))], singletons=[Marked()])


def acting(function: Any, phase: Phase, interpret: bool, game: outlast.Scenario = DUEL) -> Any:
    """Two duels, or eight, with a mechanic `mine` that has this system, as Python or not."""
    mine = kind("Mine", Marker)
    mine.system(phase, **({"before": "melee.strike"} if phase is Phase.MELEE else {}))(function)
    label = f"mine.{function.__name__}"
    return duel(mine(), game=game, count=8 if game.varied else 2, interpret=(label,) if interpret else ())


def defect(side: Write[Side], agents: Rows[Side]) -> None:
    side.side[agents[0]] = 7


def overfill(bag: Write[Bag], agents: Rows[Bag]) -> None:
    for e in agents:
        bag.items[e, 0], bag.count[e] = -1, 1000


def double(entities: Write[Entity], agents: Rows[Side]) -> None:
    entities.alive[agents[1]] += 1


def point(marks: Write[Marks], marked: Write[Marked], agents: Rows[Marks]) -> None:
    marks.mark[agents[1]] -= 2
    marked.marked[0] = 0


def take(marked: Add[Marked]) -> None:
    marked.marked[1] -= 1


def cancel(hits: Write[Hit], agents: Rows[Side]) -> None:
    hits.count[0] -= 1


@interpreted
@pytest.mark.parametrize(
    ("function", "phase", "words"),
    [
        (defect, Phase.RESPAWN, r"agent\.Side\.side after mine\.defect: .*: -1 to 1 is needed"),
        (overfill, Phase.MELEE, r"inventory\.Bag\.count after mine\.overfill: .*: 0 to 4 is needed"),
        (double, Phase.RESPAWN, r"component\.Entity\.alive after mine\.double: .*: 0 to 1 is needed"),
        (point, Phase.MELEE, r"Marks\.mark after mine\.point: .*: -1 to \d+ is needed"),
        (take, Phase.MELEE, r"Marked\.marked after mine\.take: .*: 0 to \d+ is needed"),
        (cancel, Phase.MELEE, r"Hit\.count after mine\.cancel: .*: 0 to 4 is needed"),
    ],
)
def test_integers_that_a_column_cannot_hold_are_refused(
    function: Any, phase: Phase, words: str, interpret: bool
) -> None:
    """Ahead of the first system that would take them for an index, or for bits."""
    env = acting(function, phase, interpret)
    with pytest.raises(RangeError, match=words):
        env.step(idle(env))


def push_far(bag: Write[Bag], item: Write[Item], agents: Rows[Bag]) -> None:
    push(bag, item, agents[0], 100_000)


def place_far(body: Write[Body], entities: Write[Entity], agents: Rows[Side]) -> None:
    place(body, entities, 100_000 + agents[0], 0.0, 0.0)


def look_far(side: Write[Side], masks: Read[ObservationMasks], agents: Rows[Side]) -> None:
    if is_set(masks.filled, 10_000_000 + agents[0], 3):
        side.side[agents[0]] = 0


@interpreted
@pytest.mark.parametrize("function", [push_far, place_far, look_far])
def test_functions_of_outlast_check_the_indices_that_others_give_them(function: Any, interpret: bool) -> None:
    env = acting(function, Phase.RESPAWN, interpret)
    named = f"^mine.{function.__name__}.*" if COMPILED and not interpret else ""
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


def rise(entities: Write[Entity], health: Write[Health], agents: Rows[Side]) -> None:
    for e in agents:
        if not entities.alive[e]:
            entities.alive[e], health.points[e] = 1, 100


def bring_back(entities: Write[Entity], health: Write[Health], agents: Rows[Side]) -> None:
    for e in agents:
        if not entities.alive[e] and exists(entities, e):
            entities.alive[e], health.points[e] = 1, 100


@interpreted
def test_who_is_absent_is_not_brought_back(interpret: bool) -> None:
    varied = DUEL.replace(ending_rule="never", ending_limit=9).vary(n_agents=outlast.distributions.integers(1, 3))
    env = acting(rise, Phase.RESPAWN, interpret, varied)
    with pytest.raises(AbsentError, match=r"(after mine.rise: )?an entity is alive .* exists\(entities, e\) is False"):
        env.step(idle(env))
    env = acting(bring_back, Phase.RESPAWN, interpret, varied)
    present = env.reset()[1]["present"]
    assert not present.all()
    env.worlds[Health].points[:] = 0
    for _ in range(2):
        info = env.step(idle(env))[-1]
    assert (info["alive"] == present).all()


@kernel
def store(marks: Any, e: int, value: float) -> None:
    marks.whole[e] = value


@pytest.mark.skipif(not COMPILED, reason="the compiler knows the types")
@pytest.mark.parametrize(
    ("line", "right"),
    [
        ("marks.whole[e] = abs(marks.real[e])", False),
        ("marks.whole[e] = max(marks.real[e], 1)", False),
        ("marks.whole[e] = marks.real[e] if e > 0 else 0", False),
        ("marks.whole[e] = marks.real.sum()", False),
        ("marks.whole[e] += abs(marks.real[e])", False),
        ("part = marks.whole[1:]; part[0] = abs(marks.real[e])", False),
        ("marks.small[:] = np.abs(marks.real)", False),
        ("store(marks, e, abs(marks.real[e]))", False),
        ("marks.whole[e] = np.int32(abs(marks.real[e])); marks.small[:] = 3; marks.small[e] = True", True),
        ("marks.real[e] = abs(marks.real[e]); marks.real[:] = 2; marks.real[e] = e", True),
    ],
)
def test_no_float_is_cut_off(line: str, right: bool) -> None:
    """In a branch that no trial takes."""
    names: dict[str, Any] = {**globals(), "__name__": __name__}
    text = "def cut(marks: Write[Marks], agents: Rows[Marks]) -> None:\n    for e in agents:\n"
    exec(f"{text}        if marks.whole[e] > 100:\n            {line}\n", names)
    if right:
        acting(names["cut"], Phase.DRIVE, interpret=False)
        return
    with pytest.raises(DeclarationError, match=r"mine\.cut \(.*\):? writes a float to .*, which cuts it off; say so"):
        acting(names["cut"], Phase.DRIVE, interpret=False)

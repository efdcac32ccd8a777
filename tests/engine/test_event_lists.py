"""Events of the engine: lists that systems write, and that are empty again when the next tick begins."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import pytest

from outlast.ecs import (
    Add,
    Array,
    CapacityError,
    Clock,
    DeclarationError,
    Event,
    Read,
    Rows,
    Singleton,
    Worlds,
    Write,
    column,
    emit,
    number,
)
from tests.helpers.mechanics import kind, mechanic, taking
from tests.helpers.toy_game import GAME, RESET, SKIP, STEP, Energy, Phase, Place, Toy, make, run, walked


class Ring(Event, capacity="rings"):
    """A walker rings."""

    agent: Array = column("i4", unit="entity")
    mark: Array = column("i4")
    where: Array = column("f4", "memory", 2)
    marks: Array = column("i4", 3)


class Birth(Event, capacity=Energy):
    """A walker begins."""

    agent: Array = column("i4", unit="entity")


class Heard(Singleton):
    rings: Array = column("i4")


@dataclass(frozen=True)
class Bell(Toy):
    times: int = number(2, low=0)
    room: int = number(0, low=0)  # of a list that holds less than all

    def singletons(self) -> Iterable[Singleton]:
        return [Ring(), Birth(), Heard()]

    def dims(self) -> dict[str, int | str]:
        return {"rings": self.room or 2 * 3 * self.times}


@Bell.system(Phase.BEGIN, after=("walkers.scatter", "food.grow"))
def begin(births: Write[Birth], walkers: Rows[Energy]) -> None:
    for e in walkers:
        births.agent[emit(births)] = e


@Bell.system(Phase.MOVE, after="weather.blow")
def ring(rings: Write[Ring], place: Read[Place], clock: Read[Clock], walkers: Rows[Energy], times: int) -> None:
    """In ticks 1, 2, 4, 5 ... every walker, `times` or twice as often."""
    for n in range(times * (int(clock.tick[0]) % 3)):
        for e in walkers:
            k = emit(rings)
            rings.agent[k], rings.mark[k] = e, -1
            rings.marks[k, 2] = 255
            rings.where[k, 0, 0], rings.where[k, -1, 1] = place.x[e], n


@Bell.system(Phase.SHOW, after="walkers.show")
def hear(heard: Write[Heard], rings: Read[Ring]) -> None:
    heard.rings[0] = rings.count[0]


def belfry(count: int = 3, **numbers: Any) -> Worlds:
    return make(*GAME, Bell(**numbers), count=count)


def expected(worlds: Worlds, w: int, tick: int) -> list[tuple[int, float, int]]:
    """Row, place and number of each ring of world `w` in this tick, in order."""
    rows = range(worlds.dims["rows"])[worlds.span("walker")]
    places = worlds[Place].x[w]
    return [(e, float(places[e]), n) for n in range(2 * (tick % 3)) for e in rows]


def rings(worlds: Worlds, w: int) -> list[tuple[int, float, int]]:
    table = worlds[Ring]
    columns = table.agent[w], table.where[w, :, 0, 0], table.where[w, :, -1, 1].astype(int)
    return [*zip(*(column[: table.count[w, 0]].tolist() for column in columns), strict=True)]


def test_a_list_holds_what_happened_in_this_tick() -> None:
    worlds = belfry()
    for tick in range(1, 6):
        run(worlds, STEP)
        for w in range(3):
            assert rings(worlds, w) == expected(worlds, w, tick)
        assert worlds[Heard].rings[:, 0].tolist() == [6 * (tick % 3)] * 3
        assert worlds[Birth].count.sum() == 0


def test_events_are_rows_of_arrays() -> None:
    worlds = walked(belfry(), 2)
    run(worlds, [SKIP, STEP, RESET])
    assert worlds[Ring].count[:, 0].tolist() == [12, 0, 0]
    assert worlds[Birth].count[:, 0].tolist() == [0, 0, 3]
    found = worlds.events()
    assert found.keys() == {"ring", "birth"}
    rows, births = found["ring"], found["birth"]
    assert rows.dtype.names == ("world", "episode", "tick", "agent", "mark", "where", "marks")
    assert rows["where"].shape == (12, 3, 2)
    assert [(r["agent"], r["where"][0, 0], r["where"][-1, 1]) for r in rows] == expected(worlds, 0, 2)
    assert {tuple(row) for row in rows[["world", "episode", "tick"]].tolist()} == {(0, 1, 2)}
    assert births[["world", "episode", "tick"]].tolist() == [(2, 2, 0)] * 3
    assert births["agent"].tolist() == list(range(worlds.dims["rows"])[worlds.span("walker")])
    run(worlds, STEP)
    assert len(rows) == 12  # copies
    assert len(make().entries(Ring)) == 0  # nobody there rings


def test_an_entry_begins_as_zeros() -> None:
    worlds = walked(belfry(times=1), 4)
    for values in worlds[Ring][:-1]:
        values[:] = 77
    run(worlds, STEP)
    assert worlds[Ring].marks[0, :6].tolist() == [[0, 0, 255]] * 6


def test_the_state_of_a_world_is_as_without_events() -> None:
    silent = mechanic("Silent", Toy, singletons=[Ring(), Birth()])
    one, other = walked(make(count=4), 3), walked(make(*GAME, silent, count=4), 3)
    assert (one.block == other.block).all()


@pytest.mark.usefixtures("untried")
@pytest.mark.parametrize("room", [1, 5, 11])
def test_a_full_list_is_an_error_that_says_what_to_do(room: int) -> None:
    worlds = belfry(room=room)
    run(worlds, STEP) if room >= 6 else None
    with pytest.raises(CapacityError) as error:
        run(worlds, STEP)
    for words in (f"more than {room} of the event Ring, which bell.ring emits", "def dims(self)", "'rings': 'agents'"):
        assert words in str(error.value)
    assert f"tick {1 if room < 6 else 2}" in str(error.value)
    assert worlds[Ring].count.max() == room
    run(worlds, RESET)
    assert worlds[Ring].count.max() == 0


class Cry(Event, capacity=4):
    agent: Array = column("i4", unit="entity")


@dataclass(frozen=True)
class Loud(Toy):
    cries: int = number(4, low=0)
    births: int = number(3, low=0)

    def singletons(self) -> Iterable[Singleton]:
        return [Cry(), Birth()]


@Loud.system(Phase.FEED)
def shout(cry: Write[Cry], birth: Write[Birth], cries: int, births: int) -> None:
    for _ in range(cries):
        cry.agent[emit(cry)] = -1
    for _ in range(births):
        birth.agent[emit(birth)] = -1


@pytest.mark.usefixtures("untried")
def test_a_capacity_is_a_size_a_dimension_or_a_component() -> None:
    worlds = run(make(*GAME, Loud()), STEP)
    assert [worlds[kind].agent.shape for kind in (Cry, Birth)] == [(4, 4), (4, 3)]
    assert [worlds[kind].count.max() for kind in (Cry, Birth)] == [4, 3]
    for numbers, words in (
        ({"cries": 5}, "class Cry(Event, capacity=9)"),
        ({"births": 4}, "one for each entity with Energy"),
    ):
        with pytest.raises(CapacityError) as error:  # the other list is full, too, and as it should be
            run(make(*GAME, Loud(**numbers)), STEP)
        assert words in str(error.value)


def whisper(cry: Write[Cry]) -> None:
    cry.agent[0] = -1


def overhear(cry: Read[Cry], heard: Write[Heard]) -> None:
    for k in range(cry.agent.size):
        heard.rings[0] += cry.agent[k]


def turn(cry: Write[Cry]) -> None:
    for k in range(cry.count[0]):
        cry.agent[k] = -1


@pytest.mark.parametrize(
    ("function", "words"), [(whisper, r"k = emit\(cry\)"), (overhear, r"range\(cry\.count\[0\]\)"), (turn, "")]
)
def test_a_system_that_uses_entries_knows_which_there_are(function: Any, words: str) -> None:
    odd = kind("Odd", Loud, singletons=[Cry(), Birth(), Heard()])
    odd.system(Phase.MOVE)(function)
    if words:
        with pytest.raises(DeclarationError, match=rf"uses Cry\.agent, but neither emits .* {words}"):
            make(*GAME, odd())
    else:
        assert (run(make(*GAME, odd(cries=2)), STEP)[Cry].agent[:, :2] == -1).all()


def declared(capacity: Any = 3, **more: Any) -> type[Event]:
    columns = more.pop("columns", {"agent": column("i4")})
    return type("Odd", (Event,), columns, capacity=capacity, **more)


@pytest.mark.parametrize(
    ("declaration", "words"),
    [
        ({"columns": {}}, r'class Odd\(Event\) has no columns.*column\("i4", unit="entity"\)'),
        ({"capacity": None}, r'class Odd\(Event\) has no capacity.*capacity="agents"'),
        ({"columns": {"tick": column("i4")}}, "column 'tick' is reserved"),
        ({"columns": {"count": column("i4")}}, "column 'count' is reserved"),
        ({"who": "giver"}, "who='giver' is not one of its columns: agent"),
        ({"columns": {"spot": column("f4")}, "whom": "spot"}, "whom='spot' must hold entities.*unit=\"entity\""),
        ({"columns": {"agent": column("i4", fill=-1)}}, "leave out fill"),
    ],
)
def test_impossible_events_are_refused(declaration: dict[str, Any], words: str) -> None:
    with pytest.raises(DeclarationError, match=words):
        declared(**declaration)


def test_events_are_refused_in_a_game() -> None:
    other = mechanic("Other", Toy, singletons=[type("Ring", (Event,), {"agent": column("i4")}, capacity=1)()])
    with pytest.raises(DeclarationError, match=r"test_event_lists\.Ring and .* are both the event 'ring'; rename"):
        make(*GAME, Bell(), other)
    with pytest.raises(DeclarationError, match=r"'rings' is Add\[Ring\].*annotate it Write\[Ring\]"):
        Bell.system(Phase.MOVE)(taking("ring", rings=Add[Ring]))
    assert make(*GAME, mechanic("Bare", Toy, singletons=[Ring()]))[Ring].agent.shape == (4, 0)  # no capacity is defined


def test_names_and_roles_have_defaults() -> None:
    assert (Ring.name, Ring.who, Ring.whom) == ("ring", "agent", "")
    assert declared(whom="agent", who="target").whom == "agent"
    for target in (column("i4", unit="entity"), column("i4")):
        assert declared(columns={"target": target}).whom == "target"
    for target in (column("i4", unit="side"), column("f4"), column("i4", 2)):  # which are no entities
        assert declared(columns={"target": target}).whom == ""

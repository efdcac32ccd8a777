"""The schedule: the order of a tick follows from what systems declare, and what does not follow is refused."""

from collections.abc import Callable
from itertools import permutations
from typing import Any

import pytest

from outlast.ecs import Add, Component, Module, Read, Rows, ScheduleError, Singleton, Worlds, Write, column
from tests.conftest import digest
from tests.helpers import toy_game
from tests.helpers.toy_game import Energy, Line, Meals, Phase, Place, Toy, Walkers, Weather, Wind, make, run

TABLE = """\
phase     runs on      system                 reads                              writes                         adds
BEGIN     reset        # all are placed
                       walkers.scatter        Entity                             Place
                       food.grow                                                 Place Entity
MOVE      step         # all have moved
                       walkers.walk           Pace                               Place
                       weather.blow                                              Place Wind
FEED      step         # all have eaten
                       food.eat               Place                                                             Meals Energy
                       weather.freeze         Wind                                                              Energy
SHOW      reset, step  # everything is seen
                       walkers.show           Place Clock                        Line Pay
"""  # noqa: E501


class Nowhere(Component):
    left: Any = column("u1")


class Nothing(Singleton):
    left: Any = column("u1")


class Ghost(Component):
    """Brought by a mechanic, but not in these scenarios."""

    left: Any = column("u1")


class Haunted(Toy):
    def archetypes(self) -> Any:
        return [toy_game.Archetype("ghost", (Ghost(),), 1)]


class Placeless(Toy):
    """Food's systems without its entities, and without rows that could be empty."""

    def systems(self) -> Any:
        return [module("food.grow", reads).registered[0]]


def reads(place: Read[Place]) -> None: ...
def writes(place: Write[Place]) -> None: ...
def adds(place: Add[Place]) -> None: ...
def reads_pieces(energy: Read[Energy], line: Read[Line]) -> None: ...
def writes_pieces(line: Write[Line], energy: Write[Energy]) -> None: ...
def asks_nowhere(nowhere: Read[Nowhere]) -> None: ...
def asks_nothing(nothing: Read[Nothing]) -> None: ...
def needs_ghosts(place: Write[Place], none: Rows[Place, Ghost]) -> None: ...
def needs_none(place: Write[Place], none: Rows[Place, Nowhere]) -> None: ...


def module(label: str, function: Callable[..., None], phase: Phase = Phase.FEED, **order: Any) -> Module:
    """A module with one system, called `label`."""
    name, system = label.split(".")
    cls = type(name.capitalize(), (Toy,), {})
    cls.system(phase, **order)(named(function, system))
    return cls()


def named(function: Callable[..., None], name: str) -> Callable[..., None]:
    """The same function under another name."""
    copy = type(function)(function.__code__, function.__globals__, name)
    copy.__annotations__ = function.__annotations__
    return copy


def labels(*modules: Module) -> list[str]:
    """The systems in FEED, in order."""
    systems = Worlds([Walkers(), *modules], 1).schedule.systems
    return [system.label for system in systems if system.phase is Phase.FEED]


def test_the_schedule_prints_as_a_table() -> None:
    assert str(Worlds(toy_game.GAME, 1).schedule) == TABLE.rstrip("\n")


def test_the_order_in_which_modules_are_listed_never_matters() -> None:
    expected = digest(run(make(), toy_game.STEP, toy_game.STEP))
    for modules in permutations(toy_game.GAME):
        worlds = make(*modules)
        assert str(worlds.schedule) == TABLE.rstrip("\n")
        assert digest(run(worlds, toy_game.STEP, toy_game.STEP)) == expected


@pytest.mark.parametrize(
    ("one", "two"), [(writes, writes), (reads, writes), (writes, reads), (reads, adds), (adds, reads), (adds, writes)]
)
def test_ambiguous_orders_are_refused_with_the_cure(one: Any, two: Any) -> None:
    modules = [module("zebra.act", two), module("ape.act", one)]
    with pytest.raises(ScheduleError) as raised:
        labels(*modules)
    for words in ("ape.act and zebra.act", "phase FEED", "both touch Place", 'after="ape.act" on zebra.act', "Add"):
        assert words in str(raised.value)


def test_the_component_in_conflict_is_found_among_several() -> None:
    with pytest.raises(ScheduleError, match=r"both touch (Energy|Line)"):
        labels(module("ape.act", reads_pieces), module("zebra.act", writes_pieces))


@pytest.mark.parametrize(("one", "two"), [(reads, reads), (adds, adds), (writes, reads_pieces), (adds, reads_pieces)])
def test_orders_that_cannot_matter_are_free(one: Any, two: Any) -> None:
    assert labels(module("zebra.act", one), module("ape.act", two)) == ["ape.act", "zebra.act"]


def test_systems_of_different_phases_never_conflict() -> None:
    ape = module("ape.act", writes, Phase.SHOW, before="walkers.show")
    assert labels(module("zebra.act", writes), ape) == ["zebra.act"]


def test_after_and_before_are_honoured() -> None:
    """Also through systems in between, and against the alphabet that orders the rest."""
    ape = module("ape.act", writes, after="zebra.act")
    assert labels(ape, module("zebra.act", writes)) == ["zebra.act", "ape.act"]
    zebra = module("zebra.act", writes, before=("ape.act", "food.eat"))
    assert labels(module("ape.act", writes), zebra) == ["zebra.act", "ape.act"]
    chain = [
        module("ape.act", writes, after=("fox.act",)), module("fox.act", reads_pieces, after="zebra.act"),
        module("zebra.act", writes),
    ]  # fmt: skip
    assert labels(*chain) == ["zebra.act", "fox.act", "ape.act"]


def test_a_circle_is_refused() -> None:
    circle = [
        module("ape.act", reads, after="fox.act"), module("fox.act", reads, after="zebra.act"),
        module("zebra.act", reads, after="ape.act"), module("bee.act", reads),
    ]  # fmt: skip
    with pytest.raises(ScheduleError, match=r"run in a circle: ape\.act, fox\.act, zebra\.act; leave one"):
        labels(*circle)


def test_the_name_of_a_mechanic_stands_for_all_its_systems_of_the_phase() -> None:
    """But for the one that asks: a mechanic's system may come after its others."""
    zebra = module("zebra.act", reads)
    type(zebra).system(Phase.FEED)(named(reads, "bite"))
    type(zebra).system(Phase.SHOW)(named(reads, "show"))
    assert labels(module("ape.act", writes, after="zebra"), zebra) == ["zebra.act", "zebra.bite", "ape.act"]
    assert labels(module("zoo.act", writes, before="zebra"), zebra) == ["zoo.act", "zebra.act", "zebra.bite"]
    type(zebra).system(Phase.FEED, after="zebra")(named(writes, "aim"))
    assert labels(zebra) == ["zebra.act", "zebra.bite", "zebra.aim"]


def test_the_name_of_a_mechanic_stands_for_what_takes_its_place() -> None:
    """A subclass, or another mechanic of its slot; without any, for nothing."""
    zebra, horse, ape = module("zebra.act", reads), module("horse.run", reads), module("ape.act", writes, after="zebra")
    pony = type("Pony", (type(zebra),), {})()
    type(horse).slot = type(zebra).slot  # type: ignore[method-assign]
    for other, label in ((zebra, "zebra.act"), (pony, "pony.act"), (horse, "horse.run")):
        assert labels(ape, other) == [label, "ape.act"]
    assert labels(module("ape.act", writes, after="horse"), zebra) == ["zebra.act", "ape.act"]
    assert labels(ape) == ["ape.act"]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("zebra.snore", "'zebra.snore', which no module registers"),
        ("weather.freez", "'weather.freez', which no module registers; did you mean weather.freeze"),
        ("walker", "'walker', which no module registers; did you mean walkers"),
        ("toy", "'toy', which no module registers"),  # the base of several mechanics, itself without systems
        ("weather.blow", "phase FEED is to run after or before 'weather.blow', which is in MOVE: "),
        ("walkers", "phase FEED is to run after or before 'walkers', which is in BEGIN and MOVE and SHOW: "),
    ],
)
def test_a_name_that_means_nothing_is_refused(name: str, words: str) -> None:
    for order in ("after", "before"):
        with pytest.raises(ScheduleError, match=rf"ape\.act .*{words}"):
            labels(module("ape.act", reads, **{order: name}))


def test_a_label_of_a_mechanic_left_out_is_ignored() -> None:
    """weather.freeze exists somewhere, but is not in this scenario."""
    assert labels(module("ape.act", reads, after="weather.freeze", before="food.eat")) == ["ape.act"]


def test_a_missing_component_is_named_with_the_cure() -> None:
    named = r"ape\.act needs Nowhere .parameter 'nowhere'.*brings it; bring it, as in def archetypes.*leave ape out"
    with pytest.raises(ScheduleError, match=named):
        labels(module("ape.act", asks_nowhere))
    with pytest.raises(ScheduleError, match=r"ape\.act needs Nothing .*brings it; bring it, as in def singletons"):
        labels(module("ape.act", asks_nothing))
    with pytest.raises(ScheduleError, match=r"food\.grow needs Place .*leave food out"):
        Worlds([Placeless()], 1)


def test_a_system_without_rows_is_inactive() -> None:
    """It has nothing to do, so it is not scheduled, and needs nothing: another mechanic would bring its rows."""
    assert labels(module("ape.act", needs_ghosts), module("zebra.act", writes)) == ["zebra.act"]


def test_a_system_whose_rows_no_mechanic_brings_is_refused() -> None:
    with pytest.raises(ScheduleError, match=r"ape\.act is for entities with Nowhere, which no mechanic brings, so it"):
        labels(module("ape.act", needs_none))
    with pytest.raises(ScheduleError, match=r"ape\.act .*Nowhere.*def archetypes"):
        labels(module("ape.act", reads, needs=Nowhere))
    again = type("Energy", (Component,), {"__annotations__": {"points": Any}, "points": column("i4")})
    function = named(needs_none, "act")
    function.__annotations__ = {"place": Write[Place], "none": Rows[again], "return": None}
    with pytest.raises(ScheduleError, match=r"another class of that name is there: define both anew"):
        labels(module("ape.act", function))


def test_a_scenario_may_have_no_system_at_all() -> None:
    class Still(Toy):
        def archetypes(self) -> list[Any]:
            return [toy_game.Archetype("stone", (Energy(),), 2)]

    worlds = make(Still())
    run(worlds, toy_game.STEP)
    assert worlds[Energy].left.tolist() == [[10, 10]] * 4
    assert worlds[toy_game.Clock].tick.tolist() == [[1]] * 4


def test_what_touches_nothing_in_common_needs_no_order() -> None:
    """The toy game itself: both eat and freeze add to Energy, and only one reads Wind."""
    assert labels(toy_game.Food(), Weather()) == ["food.eat", "weather.freeze"]
    assert {Meals, Wind} <= set(Worlds(toy_game.GAME, 1).components)


def test_two_systems_of_one_label_are_refused() -> None:
    """As two users' files of one name would have; their order and random numbers go by label."""
    with pytest.raises(ScheduleError, match=r"two systems are called ape\.act .*rename"):
        labels(module("ape.act", reads), module("ape.act", adds))


def test_components_of_one_name_are_distinguished() -> None:
    """Two files may both have an Energy."""
    other = type("Energy", (Component,), {"spent": column("i4", fill=7)})

    def spend(energy: Write[Energy], mine: Write[other], stones: Rows[Energy, other]) -> None:  # type: ignore[valid-type]
        for e in stones:
            energy.left[e] -= 1
            mine.spent[e] += 10

    class Stones(Toy):
        def archetypes(self) -> list[Any]:
            return [toy_game.Archetype("stone", (Energy(left=3), other()), 2)]

    worlds = make(Stones(), module("ape.act", spend))
    run(worlds, toy_game.STEP, toy_game.STEP)
    assert worlds[Energy].left[0].tolist() == [1, 1]
    assert worlds[other].spent[0].tolist() == [27, 27]

"""The schedule: the order of a tick follows from what systems declare, and what does not follow is refused."""

import re
from collections.abc import Callable
from itertools import permutations
from typing import Any

import numpy as np
import pytest

from outlast.components import Body, Death, Spawned
from outlast.components import Phase as DuelPhase
from outlast.ecs import (
    Add,
    Archetype,
    Component,
    DeclarationError,
    Entity,
    Event,
    Module,
    Read,
    Rows,
    ScheduleError,
    Singleton,
    Worlds,
    Write,
    column,
    emit,
)
from outlast.ecs.compilation.schedule import order
from outlast.envs.scenarios.variants import variant
from outlast.systems import Maze, Pillars, Preparation, Rooms, Walls
from tests.conftest import digest
from tests.helpers import toy_game
from tests.helpers.mechanics import DUEL, duel, kind, mechanic, taking
from tests.helpers.toy_game import RESET, Energy, Food, Line, Phase, Place, Toy, Walkers, Weather, make, run

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


HAUNTED = kind("Haunted", Toy, archetypes=[Archetype("ghost", (Ghost(),), 1)])


def reads(place: Read[Place]) -> None: ...
def writes(place: Write[Place]) -> None: ...
def adds(place: Add[Place]) -> None: ...
def reads_pieces(energy: Read[Energy], line: Read[Line]) -> None: ...
def writes_pieces(line: Write[Line], energy: Write[Energy]) -> None: ...
def needs_ghosts(place: Write[Place], none: Rows[Place, Ghost]) -> None: ...
def needs_none(place: Write[Place], none: Rows[Place, Nowhere]) -> None: ...


def module(label: str, function: Callable[..., None], phase: Phase = Phase.FEED, **order: Any) -> Module:
    """A module with one system, called `label`."""
    name, system = label.split(".")
    made = kind(name.capitalize(), Toy)
    made.system(phase, **order)(named(function, system))
    return made()


def named(function: Callable[..., None], name: str) -> Callable[..., None]:
    return taking(name, **{key: hint for key, hint in function.__annotations__.items() if key != "return"})


def labels(*modules: Module) -> list[str]:
    systems = Worlds([Walkers(), *modules], 1).schedule.systems
    return [system.label for system in systems if system.phase is Phase.FEED]


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


def test_the_cure_is_addressed_to_the_users_mechanic() -> None:
    acid = kind("Acid")
    acid.system(DuelPhase.DRIVE)(taking("wade", body=Write[Body]))
    ape, pieces = module("ape.act", reads), module("ape.act", reads_pieces)
    for make_worlds, words in (
        (lambda: duel(acid()), r'Say after="motors.drive" on acid.wade \(or after=Body, .*ordered\("motors.drive"'),
        (lambda: labels(ape, module("zoo.act", writes)), r"on zoo\.act \(or before=Place,"),
        (lambda: labels(ape, module("zoo.act", writes, after=Place)), r"zoo\.act \(or the other"),
        (lambda: labels(pieces, module("zoo.act", writes_pieces)), r"both touch (Energy|Line)"),
    ):
        with pytest.raises(ScheduleError, match=words):
            make_worlds()


@pytest.mark.parametrize(("one", "two"), [(reads, reads), (adds, adds), (writes, reads_pieces), (adds, reads_pieces)])
def test_orders_that_cannot_matter_are_free(one: Any, two: Any) -> None:
    assert labels(module("zebra.act", one), module("ape.act", two)) == ["ape.act", "zebra.act"]


def test_after_and_before_are_honoured() -> None:
    ape = module("ape.act", writes, after="zebra.act")
    assert labels(ape, module("zebra.act", writes)) == ["zebra.act", "ape.act"]
    zebra = module("zebra.act", writes, before=("ape.act", "food.eat"))
    assert labels(module("ape.act", writes), zebra) == ["zebra.act", "ape.act"]
    ape, fox = module("ape.act", writes, after=("fox.act",)), module("fox.act", reads_pieces, after="zebra.act")
    assert labels(ape, fox, module("zebra.act", writes)) == ["zebra.act", "fox.act", "ape.act"]


def test_a_circle_is_refused() -> None:
    pairs = (("ape.act", "fox.act"), ("fox.act", "zebra.act"), ("zebra.act", "ape.act"))
    circle = [module(label, reads, after=after) for label, after in pairs]
    with pytest.raises(ScheduleError, match=r"run in a circle: ape\.act, fox\.act, zebra\.act; leave one"):
        labels(*circle, module("bee.act", reads))
    ape, fox = module("ape.act", writes_pieces, after=Place), module("fox.act", writes, after="zoo.act")
    with pytest.raises(ScheduleError, match=r"run in a circle: ape\.act, fox\.act, zoo\.act"):
        labels(ape, module("zoo.act", taking(place=Read[Place], energy=Read[Energy]), after=Energy), fox)


def test_the_name_of_a_mechanic_stands_for_all_its_systems_of_the_phase() -> None:
    zebra = module("zebra.act", reads)
    type(zebra).system(Phase.FEED)(named(reads, "bite"))
    type(zebra).system(Phase.SHOW)(named(reads, "show"))
    assert labels(module("ape.act", writes, after="zebra"), zebra) == ["zebra.act", "zebra.bite", "ape.act"]
    assert labels(module("zoo.act", writes, before="zebra"), zebra) == ["zoo.act", "zebra.act", "zebra.bite"]
    type(zebra).system(Phase.FEED, after="zebra")(named(writes, "aim"))
    assert labels(zebra) == ["zebra.act", "zebra.bite", "zebra.aim"]


def test_the_name_of_a_mechanic_stands_for_what_takes_its_place() -> None:
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
    for side in ("after", "before"):
        with pytest.raises(ScheduleError, match=rf"ape\.act .*{words}"):
            labels(module("ape.act", reads, **{side: name}))


def placeless() -> Module:
    """Food's systems without its entities, and without rows that could be empty."""
    return mechanic("Placeless", Toy, systems=[module("food.grow", reads).registered[0]])


@pytest.mark.parametrize(
    ("make_worlds", "words"),
    [
        (lambda: labels(module("ape.act", taking(nowhere=Read[Nowhere]))),
         r"ape\.act needs Nowhere .parameter 'nowhere'.*bring it, as in def archetypes.*leave ape out"),
        (lambda: labels(module("ape.act", taking(nothing=Read[Nothing]))), "needs Nothing .*as in def singletons"),
        (lambda: Worlds([placeless()], 1), r"food\.grow needs Place .*leave food out"),
        (lambda: order(Food.all_systems(), [Entity]), r"food\.eat needs Place .*; add .*Food .*or Walkers, or"),
        (lambda: Worlds([Weather()], 1), r"the dimension 'memory'.* Wind\.felt needs it: add .*Food.*Walkers"),
        (lambda: Worlds([kinds(Archetype("walker", (Ghost(),)))], 1), r"the archetype 'walker'.* add .*Walkers"),
        (lambda: labels(module("ape.act", needs_none)), r"ape\.act is for entities with Nowhere, which no mech"),
        (lambda: labels(module("ape.act", reads, needs=Nowhere)), r"ape\.act .*Nowhere.*def archetypes"),
        (lambda: labels(module("ape.act", taking(place=Write[Place], none=Rows[type("Energy", (Component,), {})]))),
         r"another class of that name is there: define both anew"),
        (lambda: labels(module("ape.act", reads), module("ape.act", adds)), r"two systems are called ape\.act "),
        (lambda: duel(early()), r"early.mourn in phase DRIVE .* Death, .* mortality.die in phase DIE"),
        (lambda: make(Walkers(), rings()), r"rings.hear in phase MOVE \(step\) reads Ring, .* rings.ring in phase B"),
    ],
)  # fmt: skip
def test_what_is_missing_or_comes_too_late_is_named_with_the_cure(make_worlds: Any, words: str) -> None:
    with pytest.raises((ScheduleError, DeclarationError), match=words):
        make_worlds()


def early() -> Module:
    made = kind("Early")
    made.system(DuelPhase.DRIVE)(taking("mourn", deaths=Read[Death]))
    return made()


class Ring(Event, capacity=2):
    who: Any = column("i4")


def rings() -> Module:
    made = kind("Rings", Toy, singletons=[Ring()])

    @made.system(Phase.BEGIN)
    def ring(rings: Write[Ring]) -> None:
        rings.who[emit(rings)] = 1

    made.system(Phase.MOVE)(taking("hear", rings=Read[Ring]))
    return made()


def test_a_system_without_rows_or_what_it_needs_is_inactive() -> None:
    """It has nothing to do, so it is not scheduled: another mechanic would bring its rows."""
    idle = module("fox.act", writes, needs=Ghost)
    assert labels(module("ape.act", needs_ghosts), idle, module("zebra.act", writes)) == ["zebra.act"]
    with pytest.raises(DeclarationError, match=r"act has needs='Ghost': the class of a component is needed"):
        module("ape.act", reads, needs="Ghost")


def test_a_scenario_may_have_no_system_at_all() -> None:
    worlds = make(kinds(Archetype("stone", (Energy(),), 2)))
    run(worlds, toy_game.STEP)
    assert worlds[Energy].left.tolist() == [[10, 10]] * 4
    assert worlds[toy_game.Clock].tick.tolist() == [[1]] * 4


def kinds(*archetypes: Archetype) -> Module:
    return mechanic("Kinds", Toy, archetypes=archetypes)


def test_rows_follow_the_orders_then_the_names() -> None:
    names = {"e": 3, "d": -1, "c": None, "b": None, "a": 3}
    given = [Archetype(name, (Energy(),), 2, order=number) for name, number in names.items()]
    for archetypes in (given, given[::-1]):
        layout = Worlds([kinds(*archetypes), kinds(Archetype("e", (Ghost(),)))], 1).layout  # which extends one
        assert list(layout.spans) == ["d", "a", "e", "b", "c"]
        assert layout.spans["a"] == range(2, 4)
    with pytest.raises(DeclarationError, match=r"modules give 'a' the orders (3 and 4|4 and 3)"):
        Worlds([kinds(*given), kinds(Archetype("a", (), order=4))], 1)


def test_kinds_of_other_mechanics_move_neither_rows_nor_spawn_places_nor_draws() -> None:
    scenario = variant("teams_4")
    extra = kinds(*(Archetype(name, (Body(), Spawned()), 3) for name in ("acid", "zed")))
    before, after = (Worlds(modules, 3) for modules in (scenario.modules, scenario.with_(extra).modules))
    assert list(before.layout.spans) == ["agent", "box", "box_item", "heal", "wall"]
    rows = before.dims["rows"]
    for worlds in (before, after):
        worlds.seed([7] * 3, np.arange(3))
        run(worlds, RESET)
    for component in before.components:
        if not issubclass(component, Singleton):
            for one, two in zip(before[component], after[component], strict=True):
                assert (two[:, :rows] == one).all(), component
    assert (after[Spawned].cell[:, rows:] >= 0).all()
    assert after[Entity].alive[:, rows:].all()


def test_a_component_stands_for_the_other_systems_that_write_or_read_it() -> None:
    bee, fox = module("bee.act", reads), module("fox.act", writes, after=Nowhere)  # nothing touches Nowhere
    for other in (reads, writes, adds):
        assert labels(module("ape.act", other, after=Place), fox) == ["fox.act", "ape.act"]
        assert labels(module("ape.act", other), module("zoo.act", writes, before=Place)) == ["zoo.act", "ape.act"]
    assert labels(module("ape.act", reads, after=Place), module("zoo.act", adds)) == ["zoo.act", "ape.act"]
    ape, zoo = module("ape.act", reads_pieces, after=(Place, Energy)), module("zoo.act", writes_pieces)
    assert labels(ape, zoo, module("yak.act", writes)) == ["yak.act", "zoo.act", "ape.act"]
    assert labels(module("ape.act", reads, after="weather.freeze", before="food.eat")) == ["ape.act"]  # not in the game
    with pytest.raises(ScheduleError, match=r"ape\.act and bee\.act .* ambiguous"):  # bee only reads it
        labels(module("ape.act", writes, after=Place), bee)


def test_labels_win_over_components() -> None:
    ape = module("ape.act", writes, after=Place)
    assert labels(ape, module("zoo.act", writes, after="ape.act")) == ["ape.act", "zoo.act"]
    chain = [module("fox.act", reads_pieces, after="ape.act"), module("zoo.act", writes, after="fox.act")]
    assert labels(ape, *chain) == ["ape.act", "fox.act", "zoo.act"]


def test_two_systems_that_are_both_after_a_component_have_no_order() -> None:
    both = [module(f"{name}.act", writes, after=Place) for name in ("ape", "zoo")]
    with pytest.raises(ScheduleError, match=r'ape\.act and zoo\.act .*Say before="ape\.act" on zoo\.act \(or the'):
        labels(*both)
    systems = [system for each in both for system in each.systems()]
    assert order(systems, [Place], [("zoo.act", "ape.act")]).systems == (*systems[::-1],)


@pytest.mark.parametrize("given", [3, Place(), int, ("food.eat", None)])
def test_what_is_neither_label_nor_component_is_refused(given: Any) -> None:
    for keyword in ("after", "before"):
        with pytest.raises(DeclarationError, match=rf"ape\.act has {keyword}=.*after=|ape\.act has before=.*Health"):
            module("ape.act", reads, **{keyword: given})


def in_phase(scenario: Any, phase: Any, parameters: dict[str, Any], **options: Any) -> list[str]:
    """The labels of a phase in order, with a user's system `yours.act` that has these parameters."""
    yours = kind("Yours")
    yours.system(phase, compiled=False, **options)(taking(**parameters))
    worlds = Worlds(scenario.modules, 1)
    found = order([*worlds.schedule.systems, *yours.all_systems()], worlds.components).systems
    return [system.label for system in found if system.phase is phase]


def test_the_proposed_order_keeps_last_what_is_to_be_last() -> None:
    """A user's system says after=C, as mortality.cap does, which keeps hit points within their limit."""
    game = variant("teams_4").with_(Preparation(ticks=1), Maze())
    systems = Worlds(game.modules, 1).schedule.systems
    given = [(system, each) for system in systems for each in system.after if not isinstance(each, str)]
    limits = [(system, each) for system, each in given if system.touches(each, "write", "add")]
    assert len(limits) > 5
    for system, component in limits:
        parameters = {"table": Write[component]}  # type: ignore[valid-type]
        with pytest.raises(ScheduleError) as caught:
            in_phase(game, system.phase, parameters, after=component)
        (line,) = [each for each in str(caught.value).splitlines() if f" {system.label} " in each]
        assert f'cancel out. Say before="{system.label}" on yours.act (' in line
        ahead = tuple(re.findall(r'Say before="(.*?)" on yours.act', str(caught.value)))
        found = in_phase(game, system.phase, parameters, after=component, before=ahead)
        assert found.index("yours.act") < found.index(system.label)


def test_all_ambiguities_are_named_at_once() -> None:
    with pytest.raises(ScheduleError) as caught:
        labels(*(module(f"{name}.act", writes) for name in ("ape", "fox", "zoo")))
    lines = str(caught.value).splitlines()
    assert [line.partition(" in phase")[0] for line in lines] == [
        f"the order of {one}.act and {two}.act" for one, two in (("ape", "fox"), ("ape", "zoo"), ("fox", "zoo"))
    ]
    assert [("put one into another phase" in line) for line in lines] == [True, False, False]


@pytest.mark.parametrize("walls", [Maze, Pillars, Rooms, Walls])
@pytest.mark.parametrize("name", ["walls", "maze", "inner_walls", "pillars.keep_out"])
def test_a_name_or_a_label_stands_for_whatever_is_in_its_slot(walls: type[Module], name: str) -> None:
    """So a door needs one name for all kinds of walls inside the room."""
    given: Any = DuelPhase.MOVE, {"body": Write[Body]}
    found = in_phase(DUEL.with_(walls()), *given, after=("room", name, Body))
    assert found[-2:] == [f"{walls.name}.keep_out", "yours.act"]
    assert in_phase(DUEL, *given, after=("room", name, Body))[-1] == "yours.act"


@pytest.mark.parametrize(
    ("old", "phase", "new"),
    [
        ("zone.burn", DuelPhase.ZONE, "safe_zone.apply_damage"),
        ("heals.cure", DuelPhase.EFFECT, "heals.heal"),
        ("room.hold", DuelPhase.MOVE, "room.keep_inside"),
    ],
)
def test_a_label_of_before_is_answered_with_those_of_today(old: str, phase: Any, new: str) -> None:
    acid = kind("Acid")
    acid.system(phase, after=old)(taking(entities=Read[Entity]))
    with pytest.raises(ScheduleError, match=rf"'{old}', which no module registers.* In phase {phase.name} .*{new}"):
        duel(acid())


# ---- chains


def test_a_chain_of_the_scenario_orders_what_says_nothing_itself() -> None:
    modules = [module("ape.act", writes), module("fox.act", writes), module("zoo.act", writes), Walkers()]

    def fed(*chains: tuple[str, ...]) -> list[str]:
        systems = Worlds(modules, 1, ordered=chains).schedule.systems
        return [system.label for system in systems if system.phase is Phase.FEED]

    assert fed(("zoo.act", "ape.act", "fox.act")) == ["zoo.act", "ape.act", "fox.act"]
    assert fed(("fox", "ape"), ("ape", "zoo")) == ["fox.act", "ape.act", "zoo.act"]
    for chain, words in (
        (("zoo.act", "ape.act"), r"fox\.act .* ambiguous"),
        (("zoo", "ape", "fox", "zoo"), "run in a circle"),
        (("zoo.atc", "ape.act"), r"orders 'zoo\.atc', which no module registers; did you mean zoo\.act[^?]*\?$"),
        (("xx.yy", "ape.act"), r"the scenario orders 'xx\.yy', which no module registers\.$"),
        (("walkers.show", "fox.act"), r"'walkers\.show' and 'fox\.act', which are in SHOW and in FEED"),
    ):
        with pytest.raises(ScheduleError, match=words):
            fed(chain)
    rest = Worlds([Walkers(), modules[0]], 1, ordered=[("zoo.act", "ape.act")])
    assert "ape.act" in str(rest.schedule)  # what is left out is ordered with nothing

"""Order that no other mechanic shifts: rows of archetypes, systems by components, and a scenario's own chains."""

import inspect
import re
from typing import Any

import numpy as np
import pytest

import outlast.components
from outlast import ecs
from outlast.components import Body, Spawned
from outlast.ecs import (
    Archetype,
    Component,
    DeclarationError,
    Entity,
    Module,
    Read,
    ScheduleError,
    Worlds,
    Write,
    column,
)
from outlast.ecs.compilation.schedule import order
from outlast.envs.scenarios.variants import variant
from outlast.systems import DropLast, Maze, Pillars, Preparation, Rooms, Walls
from tests.engine.test_schedule import Nowhere, adds, labels, module, named, reads, reads_pieces, writes, writes_pieces
from tests.helpers.toy_game import RESET, Energy, Food, Phase, Place, Toy, Walkers, Weather, run


def kinds(*archetypes: Archetype) -> Module:
    """A mechanic with these archetypes."""
    return type("Kinds", (Toy,), {"archetypes": lambda self: archetypes})()


# ---- rows


def test_rows_follow_the_orders_then_the_names() -> None:
    names = {"e": 3, "d": -1, "c": None, "b": None, "a": 3}
    given = [Archetype(name, (Energy(),), 2, order=number) for name, number in names.items()]
    for archetypes in (given, given[::-1]):
        layout = Worlds([kinds(*archetypes)], 1).layout
        assert list(layout.spans) == ["d", "a", "e", "b", "c"]
        assert layout.spans["a"] == range(2, 4)


def test_a_module_that_extends_an_archetype_need_not_know_its_order() -> None:
    one, two = (
        kinds(Archetype("x", (Energy(),), 2, order=5)),
        kinds(Archetype("x", (Nowhere(),)), Archetype("w", (), 1)),
    )
    assert list(Worlds([two, one], 1).layout.spans) == ["x", "w"]
    with pytest.raises(DeclarationError, match=r"modules give 'x' the orders (5 and 4|4 and 5)"):
        Worlds([one, kinds(Archetype("x", (), order=4))], 1)


class Extra(Module):
    """Bodies that spawn beside the game's own, of kinds ahead of and behind all its names."""

    def archetypes(self) -> Any:
        return [Archetype(name, (Body(), Spawned()), 3) for name in ("acid", "zed")]


@pytest.mark.parametrize("name", ["ffa_3", "teams_4"])
def test_kinds_of_other_mechanics_move_neither_rows_nor_spawn_places_nor_draws(name: str) -> None:
    scenario = variant(name)
    before, after = (Worlds(modules, 3) for modules in (scenario.modules, scenario.with_(Extra()).modules))
    assert list(before.layout.spans) == ["agent", "box", "box_item", "heal", "wall"]
    rows = before.dims["rows"]
    for worlds in (before, after):
        worlds.seed([7] * 3, np.arange(3))
        run(worlds, RESET)
    for component in before.components:
        if not issubclass(component, ecs.Singleton):
            for one, two in zip(before[component], after[component], strict=True):
                assert (two[:, :rows] == one).all(), component
    assert (after[Spawned].cell[:, rows:] >= 0).all()
    assert after[Entity].alive[:, rows:].all()


# ---- systems by components


def test_a_component_stands_for_the_other_systems_that_write_or_read_it() -> None:
    bee, fox = module("bee.act", reads), module("fox.act", writes, after=Nowhere)  # nothing touches Nowhere
    for other in (reads, writes, adds):
        assert labels(module("ape.act", other, after=Place), fox) == ["fox.act", "ape.act"]
        assert labels(module("ape.act", other), module("zoo.act", writes, before=Place)) == ["zoo.act", "ape.act"]
    assert labels(module("ape.act", reads, after=Place), module("zoo.act", adds)) == ["zoo.act", "ape.act"]
    with pytest.raises(ScheduleError, match=r"ape\.act and bee\.act .* ambiguous"):  # bee only reads it
        labels(module("ape.act", writes, after=Place), bee)


def test_of_several_components_each_counts() -> None:
    ape = module("ape.act", reads_pieces, after=(Place, Energy))
    zoo, yak = module("zoo.act", writes_pieces), module("yak.act", writes)
    assert labels(ape, zoo, yak) == ["yak.act", "zoo.act", "ape.act"]


def test_labels_win_over_components() -> None:
    """Also where the labels lead there through other systems."""
    ape = module("ape.act", writes, after=Place)
    assert labels(ape, module("zoo.act", writes, after="ape.act")) == ["ape.act", "zoo.act"]
    chain = [module("fox.act", reads_pieces, after="ape.act"), module("zoo.act", writes, after="fox.act")]
    assert labels(ape, *chain) == ["ape.act", "fox.act", "zoo.act"]


def test_two_systems_that_are_both_after_a_component_have_no_order() -> None:
    both = [module(f"{name}.act", writes, after=Place) for name in ("ape", "zoo")]
    with pytest.raises(
        ScheduleError, match=r"ape\.act and zoo\.act .*Say after=\"ape\.act\" on zoo\.act \(or the other"
    ):
        labels(*both)
    systems = [system for each in both for system in each.systems()]
    assert order(systems, [Place], [("zoo.act", "ape.act")]).systems == (*systems[::-1],)


def test_components_in_a_circle_are_refused() -> None:
    one = module("ape.act", writes_pieces, after=Place)
    two = module("zoo.act", named(_swaps, "act"), after=Energy)
    three = module("fox.act", writes, after="zoo.act")
    with pytest.raises(ScheduleError, match=r"run in a circle: ape\.act, fox\.act, zoo\.act"):
        labels(one, two, three)


def _swaps(place: Read[Place], energy: Read[Energy]) -> None: ...


@pytest.mark.parametrize("given", [3, Place(), int, ("food.eat", None)])
def test_what_is_neither_label_nor_component_is_refused(given: Any) -> None:
    for keyword in ("after", "before"):
        with pytest.raises(DeclarationError, match=rf"ape\.act has {keyword}=.*after=|ape\.act has before=.*Health"):
            module("ape.act", reads, **{keyword: given})


# ---- an error says what to write, and where


def test_an_ambiguous_order_is_addressed_to_the_users_mechanic() -> None:
    """By the component, too, in the word that orders it after what the other does."""

    def wade(body: Write[Body]) -> None: ...

    swamp = type("Acid", (Module,), {})
    swamp.system(outlast.components.Phase.DRIVE)(wade)
    with pytest.raises(ScheduleError) as error:
        Worlds(variant("ffa_1").with_(swamp()).modules, 1)
    assert str(error.value) == (
        "the order of acid.wade and motors.drive in phase DRIVE is ambiguous: both touch Body and one of them writes "
        'it. Say after="motors.drive" on acid.wade (or after=Body, or the other way round), put one into another '
        "phase, or declare Add where both only add; where neither is yours, say "
        'scenario.ordered("motors.drive", "acid.wade")'
    )
    with pytest.raises(ScheduleError, match=r"on zoo\.act \(or before=Place,"):
        labels(module("ape.act", reads), module("zoo.act", writes))
    with pytest.raises(ScheduleError, match=r"on zoo\.act \(or the other way round\)"):  # nothing it says already
        labels(module("ape.act", reads), module("zoo.act", writes, after=Place))


def in_phase(scenario: Any, phase: Any, parameters: dict[str, Any], **options: Any) -> list[str]:
    """The labels of a phase in order, with a user's system `yours.act` that has these parameters."""

    def act(*tables: Any) -> None: ...

    act.__annotations__ = {**parameters, "return": None}
    act.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in parameters]
    )
    yours = type("Yours", (Module,), {})
    yours.system(phase, compiled=False, **options)(act)
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
        assert f", and both say after={component.__name__}, which cancels out. {system.label} is to run last: " in line
        proposed = line.partition(" is to run last: ")[2].partition(" on yours.act")[0]
        found = in_phase(game, system.phase, parameters, after=tuple(re.findall(r'"(.*?)"', proposed)))
        assert found.index("yours.act") < found.index(system.label)


def test_all_ambiguities_are_named_at_once() -> None:
    """In all phases, and what can be done in general only once."""
    with pytest.raises(ScheduleError) as caught:
        labels(*(module(f"{name}.act", writes) for name in ("ape", "fox", "zoo")))
    lines = str(caught.value).splitlines()
    assert [line.partition(" in phase")[0] for line in lines] == [
        f"the order of {one}.act and {two}.act" for one, two in (("ape", "fox"), ("ape", "zoo"), ("fox", "zoo"))
    ]
    assert [("put one into another phase" in line) for line in lines] == [True, False, False]


@pytest.mark.parametrize("walls", [Maze, Pillars, Rooms, Walls])
@pytest.mark.parametrize("name", ["walls", "maze", "inner_walls", "walls.keep_out", "pillars.keep_out"])
def test_a_name_or_a_label_stands_for_whatever_is_in_its_slot(walls: type[Module], name: str) -> None:
    """So a door needs one name for all kinds of walls inside the room."""
    parameters = {"body": Write[Body]}
    phase = outlast.components.Phase.MOVE
    found = in_phase(variant("ffa_1").with_(walls()), phase, parameters, after=("room", name, Body))
    assert found[-2:] == [f"{walls.name}.keep_out", "yours.act"]
    assert in_phase(variant("ffa_1"), phase, parameters, after=("room", name, Body))[-1] == "yours.act"


@pytest.mark.parametrize(
    ("old", "phase", "new"),
    [
        ("zone.burn", outlast.components.Phase.ZONE, "safe_zone.apply_damage"),
        ("zone.move", outlast.components.Phase.ZONE, "safe_zone.move"),
        ("spawn.place", outlast.components.Phase.SPAWN, "spawn_grid.place"),
        ("heals.cure", outlast.components.Phase.EFFECT, "heals.heal"),
        ("room.hold", outlast.components.Phase.MOVE, "room.keep_inside"),
        ("give.hand_over", outlast.components.Phase.GIVE, "give_last.hand_over"),
    ],
)
def test_a_label_of_before_is_answered_with_those_of_today(old: str, phase: Any, new: str) -> None:
    mechanic = type("Acid", (Module,), {})
    mechanic.system(phase, after=old)(named(_touches_nothing, "act"))
    with pytest.raises(ScheduleError, match=rf"'{old}', which no module registers.* In phase {phase.name} .*{new}"):
        Worlds(variant("ffa_1").with_(mechanic()).modules, 1)


def _touches_nothing(entities: Read[Entity]) -> None: ...


def test_what_is_missing_is_named_with_the_mechanics_that_have_it() -> None:
    with pytest.raises(ScheduleError, match=r"food\.eat needs Place .* brings it; add .*Food .*or Walkers, or"):
        order(Food.all_systems(), [Entity])
    with pytest.raises(DeclarationError, match=r"the dimension 'memory'.* Wind\.felt needs it: add .*Food.*Walkers"):
        Worlds([Weather()], 1)
    with pytest.raises(DeclarationError, match=r"extend the archetype 'walker'.* add .*Walkers"):
        Worlds([kinds(Archetype("walker", (Nowhere(),)))], 1)


# ---- chains


def test_a_chain_of_the_scenario_orders_what_says_nothing_itself() -> None:
    modules = [module("ape.act", writes), module("fox.act", writes), module("zoo.act", writes), Walkers()]

    def fed(*chains: tuple[str, ...]) -> list[str]:
        systems = Worlds(modules, 1, ordered=chains).schedule.systems
        return [system.label for system in systems if system.phase is Phase.FEED]

    assert fed(("zoo.act", "ape.act", "fox.act")) == ["zoo.act", "ape.act", "fox.act"]
    assert fed(("fox", "ape"), ("ape", "zoo")) == ["fox.act", "ape.act", "zoo.act"]
    for chains, words in (
        ([("zoo.act", "ape.act")], r"fox\.act .* ambiguous"),
        ([("zoo", "ape", "fox", "zoo")], "run in a circle"),
        (
            [("zoo.atc", "ape.act")],
            r"the scenario orders 'zoo\.atc', which no module registers; did you mean zoo\.act[^?]*\?$",
        ),
        ([("xx.yy", "ape.act")], r"the scenario orders 'xx\.yy', which no module registers\.$"),
        ([("walkers.show", "fox.act")], r"'walkers\.show' and 'fox\.act', which are in SHOW and in FEED"),
    ):
        with pytest.raises(ScheduleError, match=words):
            fed(*chains)
    rest = Worlds([Walkers(), modules[0]], 1, ordered=[("zoo.act", "ape.act")])
    assert "ape.act" in str(rest.schedule)  # what is left out is ordered with nothing


def test_own_mechanics_name_no_system_of_each_other() -> None:
    """So that a mechanic goes with its file: see tests/mechanics/test_deletion.py."""
    for system in Worlds(variant("teams_4").with_(DropLast()).modules, 1).schedule.systems:
        foreign = [each for each in (*system.after, *system.before) if isinstance(each, str)]
        assert all(each.partition(".")[0] == system.module for each in foreign), system.label


# ---- mistakes in declarations


def test_the_base_of_phases_says_where_the_phases_are() -> None:
    with pytest.raises(
        AttributeError, match=r"base class of phases.*outlast\.components\.phase\.Phase has DRIVE; .*When"
    ):
        _ = ecs.PhaseBase.DRIVE
    with pytest.raises(AttributeError, match=r"has none itself\. For a game of your own, list its phases: .* LUNCH ="):
        _ = ecs.PhaseBase.LUNCH
    with pytest.raises(AttributeError, match=r"Phase has no phase DRIV; it has: DRAW, SPAWN, .*RECORD$"):
        _ = outlast.components.Phase.DRIV
    assert not hasattr(ecs.PhaseBase, "__wrapped__")


class Mark(Component):
    mark: Any = column("u1")


@pytest.mark.parametrize(
    ("method", "given", "words"),
    [
        ("singletons", Mark(), "returned Mark: a list of instances of Singleton is needed, as in return [Singleton("),
        ("singletons", Weather().singletons()[0], "returned Wind: a list .* as in return [Wind(...)]"),  # type: ignore[index]
        ("singletons", None, "returned NoneType: a list of instances of Singleton"),
        ("singletons", [type(Weather().singletons()[0])], "returned a list with the class Wind: "),  # type: ignore[index]
        ("archetypes", Archetype("x", (), 1), "returned Archetype: a list .* as in return [Archetype(...)]"),
        ("archetypes", [Mark()], "returned a list with Mark: a list of instances of Archetype"),
    ],
)
def test_what_is_no_list_of_its_kind_is_refused(method: str, given: Any, words: str) -> None:
    odd = type("Odd", (Toy,), {method: lambda self: given})
    pattern = rf"odd\.{method}\(\) " + words.replace("[", r"\[").replace("(", r"\(").replace(")", r"\)").replace(
        "...", r"\.\.\."
    )
    with pytest.raises(DeclarationError, match=pattern):
        Worlds([Walkers(), odd()], 1)


def test_a_layout_shows_a_line_for_each_archetype() -> None:
    lines = repr(Worlds([Walkers(), Food(), Weather()], 1).layout).splitlines()
    assert lines == [
        "Layout(5 rows, 9 components, 256 bytes a world)",
        "  food: rows 0 to 1, not alive at first: Place",
        "  walker: rows 2 to 4: Place, Energy",
    ]

"""Components, archetypes, numbers and access declarations: what a scenario's tables look like, and what is refused."""

import re
from dataclasses import InitVar, dataclass, field
from itertools import product
from typing import Any, ClassVar

import numpy as np
import pytest

from outlast.components import DamageType
from outlast.ecs import (
    Action,
    Add,
    Archetype,
    Clock,
    Component,
    DeclarationError,
    Entity,
    Module,
    NumberError,
    Observation,
    Read,
    Rows,
    Scratch,
    Singleton,
    Statistic,
    Worlds,
    Write,
    column,
    number,
)
from tests.helpers import toy_game
from tests.helpers.toy_game import Energy, Food, Meals, Pace, Phase, Place, Toy, Walkers, Weather, Wind, make, run


class Mark(Component):
    mark: Any = column("u1", fill=7)


class Lost(Singleton):
    lost: Any = column("i4", "planets")


def parts(name: str, *components: Component, count: int = 0) -> Module:
    """A module that only extends or declares an archetype."""

    class Parts(Toy):
        def archetypes(self) -> list[Archetype]:
            return [Archetype(name, components, count)]

        def dims(self) -> dict[str, int | str]:
            return {f"{name}s": count} if count else {}

    return Parts()


# ---- tables


def test_tables_have_the_declared_shapes_types_and_fills() -> None:
    """Three walkers of memory 2 + 1 and two pieces of food; rows in alphabetical order of archetypes."""
    worlds = Worlds(toy_game.GAME, 6)
    columns = [(c.__name__, name, array) for c in worlds.components for name, array in worlds[c]._asdict().items()]
    found = {(component, name): (array.shape, array.dtype.str[1:]) for component, name, array in columns}
    assert found == {
        ("Clock", "seed"): ((6, 1), "u8"), ("Clock", "world"): ((6, 1), "u8"),
        ("Clock", "episode"): ((6, 1), "u8"), ("Clock", "tick"): ((6, 1), "u8"),
        ("Entity", "alive"): ((6, 5), "u1"), ("Entity", "identity"): ((6, 5), "i8"),
        ("Place", "x"): ((6, 5), "f4"), ("Place", "trail"): ((6, 5, 3), "i2"), ("Energy", "left"): ((6, 5), "i4"),
        ("Wind", "push"): ((6, 1), "f8"), ("Wind", "damage_type"): ((6, 1), "i4"), ("Wind", "felt"): ((6, 3, 2), "i4"),
        ("Pace", "pace"): ((6, 3), "i1"), ("Line", "line"): ((6, 3), "f4"), ("Pay", "pay"): ((6, 3), "f4"),
        ("Meals", "meals"): ((6, 1), "i4"),
    }  # fmt: skip
    assert (worlds.span("food"), worlds.span("walker"), worlds.span("ghost")) == (slice(0, 2), slice(2, 5), slice(0, 0))
    assert worlds.dims == {"rows": 5, "blocks": 1, "damage_types": 2, "walkers": 3, "memory": 3}
    assert worlds[Entity].alive.tolist() == [[0, 0, 1, 1, 1]] * 6
    assert worlds[Place].x.tolist() == [[-1, -1, 0, 0, 0]] * 6
    assert (worlds[Place].trail == -1).all()
    assert worlds[Energy].left.tolist() == [[0, 0, 20, 20, 20]] * 6  # rows of others are zero, not filled
    assert (worlds[Wind].push == 0.5).all()


def test_columns_are_aligned_and_do_not_overlap() -> None:
    worlds = Worlds(toy_game.GAME, 2)
    worlds.block[:] = 0
    for component in worlds.components:
        for array in worlds[component]:
            assert array.ctypes.data % array.dtype.itemsize == 0
            assert not array.view(array.dtype).any()
            array.view(array.dtype)[:] = 1
    for component in worlds.components:
        for array in worlds[component]:
            assert (array == 1).all()
    assert worlds.block.shape[1] % 64 == 0


def test_columns_are_the_same_objects_for_life() -> None:
    """No allocation after build: adapters and learners may keep them."""

    def columns() -> list[tuple[int, int]]:
        return [(id(a), a.ctypes.data) for c in worlds.components for a in worlds[c]]

    worlds = make(count=3)
    before = columns()
    run(worlds, toy_game.STEP, toy_game.STEP, [toy_game.RESET, toy_game.SKIP, toy_game.STEP], toy_game.RESET)
    worlds.seed(5, np.arange(3))
    worlds.close()
    assert columns() == before


def test_identities_of_entities_do_not_depend_on_other_archetypes() -> None:
    """They index random draws, so they must not depend on rows, which other archetypes move."""
    alone, among = Worlds([Walkers()], 1), Worlds(toy_game.GAME, 1)
    mine = alone[Entity].identity[0, alone.span("walker")]
    assert mine.tolist() == among[Entity].identity[0, among.span("walker")].tolist()
    assert len(set(among[Entity].identity[0].tolist())) == 5
    assert (among[Entity].identity > 0).all()


def test_an_absent_component_is_named_with_those_present() -> None:
    worlds = Worlds([Walkers()], 1)
    with pytest.raises(DeclarationError, match="no component Meals; it has: Clock, Energy, Entity, Line, Pace"):
        worlds[Meals]
    assert Meals not in worlds
    assert Pace in worlds


# ---- archetypes


def test_archetypes_of_several_modules_join() -> None:
    """Counts add up and components join, in any order of modules."""
    for modules in ([Walkers(), parts("walker", Mark(), count=2)], [parts("walker", Mark(), count=2), Walkers()]):
        worlds = Worlds(modules, 1)
        assert worlds.span("walker") == slice(0, 5)
        assert worlds[Mark].mark.tolist() == [[7] * 5]
        assert worlds[Energy].left.tolist() == [[20] * 5]


def test_a_fill_may_be_a_row_of_values() -> None:
    worlds = Worlds([parts("stone", Mark(mark=[3, 1, 2]), count=3)], 2)
    assert worlds[Mark].mark.tolist() == [[3, 1, 2]] * 2


@pytest.mark.parametrize(
    ("modules", "words"),
    [
        ([Walkers(), parts("walker", Place())], "two archetypes called 'walker' have Place, .* leave it out of one"),
        ([parts("ghost", Mark())], "extend the archetype 'ghost', but none declares how many"),
        ([Walkers(), parts("wolker", Mark())], "'wolker', .*; did you mean walker"),
        ([parts("ghost", Wind(), count=1)], "Wind is per world and cannot be part of 'ghost'"),
        ([parts("ghost", Place(), count=1)], "no module defines the dimension 'memory'; known: blocks, damage_types"),
    ],
    ids=["component twice", "only extended", "misspelt", "singleton inside", "unknown dimension"],
)
def test_archetypes_that_cannot_be_are_refused(modules: list[Module], words: str) -> None:
    with pytest.raises(DeclarationError, match=words):
        Worlds(modules, 1)


@pytest.mark.parametrize("given", [Mark(), [Mark()], (Mark,)], ids=["no comma", "a list", "a class"])
def test_components_that_are_no_tuple_are_refused(given: Any) -> None:
    with pytest.raises(DeclarationError, match=r"Archetype\('walker', .*: a tuple of instances of components"):
        Archetype("walker", given)


def test_unknown_columns_are_refused() -> None:
    with pytest.raises(DeclarationError, match="Energy has no column 'letf'; it has: left"):
        Energy(letf=3)


def test_an_unknown_dimension_of_a_singleton_is_refused() -> None:
    class Astronomy(Toy):
        def singletons(self) -> list[Singleton]:
            return [Lost()]

    with pytest.raises(DeclarationError, match="no module defines the dimension 'planets'; known: blocks, "):
        Worlds([Walkers(), Astronomy()], 1)


# ---- numbers


@pytest.mark.parametrize(
    ("make_module", "words"),
    [
        (lambda: Walkers(count=0), "walkers.count = 0: must be >= 1"),
        (lambda: Walkers(count=1.5), "walkers.count = 1.5: an integer"),
        (lambda: Walkers(count=True), "walkers.count = True: an integer"),
        (lambda: Walkers(count=2**31), "walkers.count = 2147483648: an integer below"),
        (lambda: Walkers(stride=0), "walkers.stride = 0: must be > 0 and <= 10"),
        (lambda: Walkers(stride=10.5), "walkers.stride = 10.5: must be > 0 and <= 10"),
        (lambda: Walkers(stride=float("nan")), "walkers.stride = nan: a finite number"),
        (lambda: Walkers(stride=10**400), "walkers.stride = 1000*: a finite number"),
        (lambda: Walkers(stride="far"), "walkers.stride = 'far': a finite number"),
        (lambda: Walkers(stride=None), "walkers.stride = None: a finite number"),
        (lambda: Weather(gusts=(0.5, 2.0)), r"weather.gusts\[1\] = 2.0: must be >= -1 and <= 1"),
        (lambda: Weather(gusts=0.5), "weather.gusts = 0.5: a tuple of numbers"),
        (lambda: Weather(wild=1), "weather.wild = 1: True or False"),
        (lambda: Weather(sky="green"), "weather.sky = 'green': allowed are 'blue', 'grey', 'black'"),
        (lambda: Walkers().replace(pace=3), "walkers has no number 'pace'; it has: count, stride"),
        (lambda: Walkers().replace(count=-1), "walkers.count = -1: must be >= 1"),
    ],
)
def test_impossible_numbers_are_refused(make_module: Any, words: str) -> None:
    with pytest.raises(NumberError, match=words):
        make_module()


def test_a_number_may_not_hide_what_modules_have() -> None:
    @dataclass(frozen=True)
    class Hides(Toy):
        value: int = number(3)

    with pytest.raises(DeclarationError, match=r"a number .value., which hides Module\."):
        Hides()


@pytest.mark.parametrize("name", ["range", "max"])
def test_a_number_does_not_hide_a_function_of_python(name: str) -> None:
    gun = type("Gun", (Toy,), {"__annotations__": {name: float}, name: number(3.0)})
    with pytest.raises(DeclarationError, match=rf"gun has a number '{name}', which would hide .* own {name} in"):
        dataclass(frozen=True)(gun)()


@pytest.mark.parametrize(
    ("kind", "default", "words"),
    [
        (InitVar[int], 3, r"Gun\.extra is an InitVar, which replace\(\) would lose: declare extra: float = number\("),
        (
            int,
            field(default=3, init=False),
            r"gun\.extra needs a default, and init: declare extra: int = number\(",
        ),
        (int, field(default_factory=int), r"gun\.extra needs a default"),
    ],
)
def test_a_number_that_copies_would_lose_is_refused(kind: Any, default: Any, words: str) -> None:
    gun = type("Gun", (Toy,), {"__annotations__": {"extra": kind}, "extra": default})
    with pytest.raises(DeclarationError, match=words):
        dataclass(frozen=True)(gun)()


def test_another_default_of_an_unknown_number_is_refused() -> None:
    @dataclass(frozen=True)
    class Base(Toy):
        speed: float = number(1.0)

    with pytest.raises(DeclarationError, match=r"Fast\.sped = 3\.0 is no other default .*; did you mean speed\? A new"):

        class Fast(Base):
            sped = 3.0

    class Mixin:
        pass

    @dataclass(frozen=True)
    class Slow(Mixin, Base):
        limit: ClassVar[int] = 3
        speed = 0.5

    assert Slow().speed == 0.5


def test_numbers_take_the_type_of_their_annotation() -> None:
    """On which the compiled tick depends: 2 and 2.0 for a stride must not compile two ticks."""

    @dataclass(frozen=True)
    class Whole(Toy):
        stride: float = number(2)

    assert type(Whole().stride) is float
    walkers = Walkers(count=np.int64(2), stride=2)
    assert (type(walkers.count), type(walkers.stride)) == (int, float)
    assert Weather(gusts=[1, np.float32(0.5)]).gusts == (1.0, 0.5)
    assert walkers.replace(stride=3) == Walkers(count=2, stride=3.0)
    assert (Weather(sky="black").value("sky"), Weather(wild=False).value("wild")) == (2, False)


# ---- impossible declarations are refused


@pytest.mark.parametrize(
    ("annotation", "default", "words"),
    [
        ("int", 1.5, "odd.speed is annotated int, but its default is 1.5"),
        ("float", True, "odd.speed is annotated float, but its default is True"),
        ("bool", 1, "odd.speed is annotated bool, but its default is 1"),
        ("tuple[float, ...]", 1.0, "annotated tuple"),
        ("str", "slow", "str with choices"),
        ("list", (1.0,), "odd.speed is annotated list: a number is int, float"),
    ],
)
def test_a_default_of_another_type_than_annotated_is_refused(annotation: str, default: Any, words: str) -> None:
    fields = {"speed": number(default), "__annotations__": {"speed": annotation}}
    odd = dataclass(frozen=True)(type("Odd", (Toy,), fields))
    with pytest.raises(DeclarationError, match=re.escape(words)):
        odd()


def test_a_parameter_of_another_type_than_its_number_is_refused() -> None:
    """It would get the number all the same, and round it or not unexpectedly."""

    @dataclass(frozen=True)
    class Odd(Toy):
        speed: float = number(1.5)

    @Odd.system(Phase.MOVE)
    def rush(energy: Read[Energy], speed: int) -> None: ...

    with pytest.raises(DeclarationError, match=r"odd\.rush: parameter 'speed' is annotated int, but .* as float"):
        Worlds([Walkers(), Odd()], 1)


def test_a_default_of_a_parameter_is_refused() -> None:
    """The number's own value would count all the same."""

    @dataclass(frozen=True)
    class Odd(Toy):
        speed: float = number(1.5)

    def rush(energy: Read[Energy], speed: float = 9.0) -> None: ...

    with pytest.raises(DeclarationError, match=r"rush: parameter 'speed' has the default 9\.0, but every call"):
        Odd.system(Phase.MOVE)(rush)

    def sink(energy: Read[Energy] = None) -> None: ...  # type: ignore[assignment]

    with pytest.raises(DeclarationError, match=r"sink: parameter 'energy' .* gives it; leave it out$"):
        Odd.system(Phase.MOVE)(sink)


def test_numbers_of_what_is_no_dataclass_are_refused() -> None:
    class Forgot(Toy):
        speed: float = 1.0

    with pytest.raises(DeclarationError, match=r"Forgot declares numbers \(speed\).*@dataclass\(frozen=True\)"):
        Forgot()


@pytest.mark.parametrize("given", [len, "move", 3])
def test_a_system_without_a_phase_is_refused(given: Any) -> None:
    """As where the parentheses were forgotten: @Lost.system."""

    class Lost(Toy):
        pass

    with pytest.raises(DeclarationError, match=r"a phase comes first, as in @Lost\.system\(Phase\.NAME\)"):
        Lost.system(given)


@pytest.mark.parametrize(
    ("base", "made", "words"),
    [
        (Observation, column("i4", "walkers"), "Odd.seen is int32: observations are float32"),
        (Observation, column("f4", "walkers", fill=1), "Odd.seen: columns with buffers of their own begin as 0"),
        (Action, column("f4", "walkers", low=0, high=1), "Odd.seen is float32 from 0 to 1"),
        (Action, column("i1", "walkers"), "finite low below a finite high"),
    ],
)
def test_impossible_columns_are_refused(base: Any, made: Any, words: str) -> None:
    with pytest.raises(DeclarationError, match=re.escape(words)):
        type("Odd", (base,), {"seen": made})


def test_a_prefab_value_of_a_component_with_buffers_is_refused() -> None:
    with pytest.raises(DeclarationError, match=r"Line\(line=\.\.\.\): it has buffers of its own, which begin as 0"):
        toy_game.Line(line=1)


@pytest.mark.parametrize("base", [Action, Observation, Statistic])
def test_two_columns_of_one_key_are_refused(base: Any) -> None:
    """Only one of them would be seen."""
    kind, key = {Action: ("i1", "pace"), Observation: ("f4", "line"), Statistic: ("i4", "meals")}[base]
    bounds = {"low": 0, "high": 1} if base is Action else {}
    other = type("Other", (base,), {"mine": column(kind, "walkers", key=key, **bounds)})

    class Brings(Toy):
        def singletons(self) -> Any:
            return [other()]

    with pytest.raises(DeclarationError, match=rf"are both the \w+ '{key}'; rename one") as raised:
        Worlds([*toy_game.GAME, Brings()], 1)
    assert re.search(r"tests\.helpers\.toy_game\.\w+\.\w+", str(raised.value))
    assert "Other.mine" in str(raised.value)


# ---- names of mechanics, and subclasses


def test_the_name_of_a_mechanic_is_its_class_in_snake_case_or_the_attribute_name() -> None:
    class HTTPServerOf2(Toy):
        pass

    class Named(Toy):
        name = "other"

    class Subclass(Named):
        pass

    assert [kind.name for kind in (Walkers, HTTPServerOf2, Named, Subclass)] == [
        "walkers", "http_server_of2", "other", "subclass",
    ]  # fmt: skip
    for attribute, value in product(("name", "stream"), ("Big Swamp", "", 3)):
        with pytest.raises(DeclarationError, match=f"has the {attribute} {value!r}: it must be lower-case"):
            type("Swamp", (Toy,), {attribute: value})


@dataclass(frozen=True)
class Marchers(Walkers):
    """Walkers with longer legs, which are not shown."""

    stride = 2.0


@Marchers.system(Phase.SHOW)
def show(line: Write[toy_game.Line], pay: Write[toy_game.Pay], place: Read[Place], walkers: Rows[Energy]) -> None:
    line.line[:] = -1
    pay.pay[:] = 0


def test_a_subclass_has_the_systems_of_its_base_and_replaces_those_that_it_names() -> None:
    assert Marchers() == Marchers(count=3, stride=2.0)
    with pytest.raises(NumberError, match=r"marchers.stride = 11: must be"):
        Marchers(stride=11)
    worlds = make(Marchers())
    labels = [system.label for system in worlds.schedule.systems]
    assert labels == ["marchers.scatter", "marchers.walk", "marchers.show"]
    before = worlds[Place].x.copy()
    worlds[Pace].pace[:] = 1
    run(worlds, toy_game.STEP)
    assert worlds[Place].x == pytest.approx(before + 2)
    assert (worlds[toy_game.Line].line == -1).all()


def test_a_label_stands_for_systems_that_inherit_it() -> None:
    """weather.blow is after="walkers.walk": also where marchers walk in the place of walkers."""
    labels = [system.label for system in Worlds([Marchers(), Food(), Weather()], 1).schedule.systems]
    assert labels.index("marchers.walk") < labels.index("weather.blow")


# ---- access


def test_other_annotations_are_refused() -> None:
    class Wrong(Toy):
        pass

    def untyped(place) -> None: ...  # type: ignore[no-untyped-def]
    def bare(place: Place) -> None: ...
    def text(place: str) -> None: ...

    for function, shown in ((untyped, "None"), (bare, "Place"), (text, "str")):
        words = rf"{function.__name__}: parameter 'place' .*{shown}.*allowed are Read\[C\]"
        with pytest.raises(DeclarationError, match=words):
            Wrong.system(Phase.MOVE)(function)
    assert Wrong.registered == []


def test_a_component_without_columns_marks_entities() -> None:
    """A marker has rows, and no table."""

    class Late(Component):
        pass

    class Marks(Toy):
        def archetypes(self) -> list[Archetype]:
            return [Archetype("walker", (Late(),))]

    @Marks.system(Phase.MOVE)
    def hurry(energy: Write[Energy], late: Rows[Late]) -> None:
        for e in late:
            energy.left[e] += 100

    worlds = Worlds([Walkers(), Marks()], 1)
    run(worlds, toy_game.STEP)
    assert worlds.layout.rows(Late).tolist() == worlds.layout.rows(Energy).tolist() != []
    assert (worlds[Energy].left[0, worlds.layout.rows(Late)] > 100).all()
    assert len(worlds[Late]) == 0
    assert "\n  Late\n" in repr(worlds.entity(int(worlds.layout.rows(Late)[0]))) + "\n"
    for hint in (Read[Late], Write[Late]):
        with pytest.raises(DeclarationError, match=r"Late\], which has no columns; Rows\[Late\] are the entities"):
            Marks.system(Phase.MOVE)(_asking(hint))


def _asking(hint: Any) -> Any:
    def system(late: Any) -> None: ...

    system.__annotations__["late"] = hint
    return system


@pytest.mark.parametrize("given", [Energy, [Energy], (3,)])
def test_what_a_component_requires_is_a_tuple(given: Any) -> None:
    with pytest.raises(DeclarationError, match=r"Bound\.requires = .*: a tuple is needed, as in \(Health,\)"):
        type("Bound", (Component,), {"requires": given})


@pytest.mark.parametrize(("kind", "default"), [("int", 3), ("bool", True)])
def test_only_real_numbers_scale(kind: str, default: Any) -> None:
    space = {"__annotations__": {"size": kind}, "size": number(default, scales_with="walkers_count")}
    with pytest.raises(DeclarationError, match=f"size is {kind} and scales with another number: only a float"):
        dataclass(frozen=True)(type("Follows", (Toy,), space))()


def test_the_clock_can_only_be_read() -> None:
    """A system that set it would make later ticks draw the random numbers of others."""
    for hint in (Write[Clock], Add[Clock]):
        with pytest.raises(DeclarationError, match=r"is (Write|Add)\[Clock\], but the engine alone .* Read\[Clock\]"):
            Walkers.system(Phase.MOVE)(_asking(hint))


def test_a_singleton_without_columns_is_refused() -> None:
    class Empty(Singleton):
        pass

    with pytest.raises(DeclarationError, match="Empty has no columns: declare one"):
        Empty()


def test_columns_of_actions_that_differ_are_named() -> None:
    class Jump(Action):
        jump: Any = column("i2", "walkers", low=0, high=1)

    class Jumps(Toy):
        def singletons(self) -> list[Singleton]:
            return [Jump()]

    with pytest.raises(DeclarationError, match=r"there are: Pace\.pace int8 \(3,\), Jump\.jump int16 \(3,\)"):
        Worlds([*toy_game.GAME, Jumps()], 1)


def test_a_system_may_not_ask_for_what_its_module_lacks() -> None:
    class Asks(Toy):
        pass

    @Asks.system(Phase.MOVE)
    def select(energy: Read[Energy], choice: int) -> None: ...

    with pytest.raises(DeclarationError, match=r"no number 'choice', which asks\.select asks for; it has: none"):
        Worlds([Walkers(), Asks()], 1)

    class Forgets(Toy):
        pass

    @Forgets.system(Phase.MOVE)
    def remember(memory: Scratch) -> None: ...

    with pytest.raises(DeclarationError, match=r"forgets has the Scratch parameter 'memory' but no scratch\(\)"):
        run(Worlds([Walkers(), Forgets()], 1), toy_game.STEP)


def test_a_damage_type_that_the_module_does_not_name_is_refused() -> None:
    class Burns(Toy):
        pass

    @Burns.system(Phase.MOVE)
    def burn(energy: Write[Energy], kind: DamageType) -> None: ...

    words = r"burns\.burn takes the damage_type of burns, .* damage_type = \"burns\""
    with pytest.raises(DeclarationError, match=words):
        Worlds([*toy_game.GAME, Burns()], 1)


def test_kernels_get_what_they_declare() -> None:
    """Rows by components, numbers in their types, damage types in alphabetical order, choices as indices."""
    worlds = make()
    assert worlds.layout.rows(Energy).tolist() == [2, 3, 4]
    assert worlds.layout.rows(Place).tolist() == [0, 1, 2, 3, 4]
    assert worlds.layout.rows(Place, Mark).tolist() == []
    assert worlds.layout.labels["damage_type"] == ["cold", "hunger"]
    run(worlds, toy_game.STEP)
    assert (worlds[Wind].damage_type == 0).all()
    assert (worlds[Wind].felt[:, 0, 1] == 1).all()

"""Components, archetypes, numbers and access declarations: what a scenario's tables look like, and what is refused."""

from collections.abc import Callable
from dataclasses import InitVar, dataclass, field
from itertools import product
from typing import Any, ClassVar, Final

import numpy as np
import pytest

import outlast
from outlast.components import DamageType, Side
from outlast.components import Phase as DuelPhase
from outlast.ecs import (
    Action,
    Add,
    Archetype,
    Array,
    Clock,
    Component,
    DeclarationError,
    EngineError,
    Entity,
    Event,
    Field,
    MemoryLayout,
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
    index_unit,
    number,
)
from outlast.envs.core.spaces import bounds
from outlast.envs.rollout.table_file import event_table
from outlast.systems import Motors
from tests.conftest import COMPILED
from tests.helpers import toy_game
from tests.helpers.mechanics import DUEL, kind, mechanic, taking
from tests.helpers.toy_game import Energy, Food, Meals, Pace, Phase, Place, Toy, Walkers, Weather, Wind, make, run


class Mark(Component):
    mark: Any = column("u1", fill=7)


class Total(Singleton):
    value: Array = column("i4")


class Counted(Statistic):
    counts: Array = column("f4", "wide")


class Fuel(Observation):
    fuel: Array = column("f4", "agents", 1)


@dataclass(frozen=True)
class Landing(Module):
    count: int = number(3, low=0)

    def archetypes(self) -> Any:
        return [Archetype("place", (Mark(),), self.count)]


def parts(name: str, *components: Component, count: int = 0) -> Module:
    """A module that only extends or declares an archetype."""
    dims: dict[str, int | str] = {f"{name}s": count} if count else {}
    return mechanic("Parts", Toy, archetypes=[Archetype(name, components, count)], dims=dims)


def worlds(*modules: Module) -> Worlds:
    return Worlds(modules, 1)


def layout(*modules: Module) -> MemoryLayout:
    """That of a duel with more mechanics, whose image of a world is made, too."""
    made = MemoryLayout([*DUEL.modules, *modules])
    assert made.initial_image.size
    return made


def component(base: Any, /, **columns: Any) -> Any:
    return type("Odd", (base,), columns)


def event(**columns: Any) -> Any:
    capacity = columns.pop("capacity", 3)
    return type("Odd", (Event,), columns, capacity=capacity)


def numbered(hint: Any, default: Any, name: str = "speed") -> Module:
    made: Any = dataclass(frozen=True)(type("Odd", (Toy,), {"__annotations__": {name: hint}, name: default}))
    return made()


def system(base: type[Module] = Toy, /, **hints: Any) -> Module:
    made = kind("Odd", base)
    made.system(Phase.MOVE)(taking(**hints))
    return made()


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
    assert (worlds.span("food"), worlds.span("walker")) == (slice(0, 2), slice(2, 5))
    assert worlds.dims == {"rows": 5, "blocks": 1, "damage_types": 2, "walkers": 3, "memory": 3}
    assert worlds[Entity].alive.tolist() == [[0, 0, 1, 1, 1]] * 6
    assert worlds[Place].x.tolist() == [[-1, -1, 0, 0, 0]] * 6
    assert (worlds[Place].trail == -1).all()
    assert worlds[Energy].left.tolist() == [[0, 0, 20, 20, 20]] * 6  # rows of others are zero, not filled
    assert (worlds[Wind].push == 0.5).all()
    assert [worlds.layout.rows(*kinds).tolist() for kinds in ((Energy,), (Place, Mark))] == [[2, 3, 4], []]
    assert repr(worlds.layout).splitlines() == [
        "Layout(5 rows, 9 components, 256 bytes a world)",
        "  food: rows 0 to 1, not alive at first: Place",
        "  walker: rows 2 to 4: Place, Energy",
    ]
    run(worlds, toy_game.RESET, toy_game.STEP)
    assert (worlds[Wind].damage_type == worlds.layout.labels["damage_type"].index("cold")).all()
    assert (worlds[Wind].felt[:, 0, 1] == 1).all()  # a choice is its index


def test_columns_are_aligned_and_do_not_overlap() -> None:
    """They stay the same objects for life, which adapters and learners may keep."""
    worlds = make(count=2)
    arrays = [array for component in worlds.components for array in worlds[component]]
    run(worlds, toy_game.STEP, [toy_game.RESET, toy_game.SKIP], toy_game.RESET)
    worlds.seed(5, np.arange(2))
    worlds.close()
    assert all(one is two for one, two in zip(arrays, (a for c in worlds.components for a in worlds[c]), strict=True))
    for array in arrays:
        array[:] = 0
    for array in arrays:
        assert array.ctypes.data % array.dtype.itemsize == 0
        assert not array.any()
        array[:] = 1
    assert all((array == 1).all() for array in arrays)
    assert worlds.block.shape[1] % 64 == 0


def test_an_absent_component_is_named_with_those_present() -> None:
    worlds = Worlds([Walkers()], 1)
    with pytest.raises(DeclarationError, match="no component Meals; it has: Clock, Energy, Entity, Line, Pace"):
        worlds[Meals]
    assert DUEL.worlds(1).span("box") == slice(0, 0)  # another mechanic's
    assert Meals not in worlds
    assert Pace in worlds


# ---- archetypes and dimensions


def test_archetypes_of_several_modules_join() -> None:
    """Counts add up and components join, in any order of modules; a fill may be a row of values."""
    for modules in ([Walkers(), parts("walker", Mark(), count=2)], [parts("walker", Mark(), count=2), Walkers()]):
        made = worlds(*modules)
        assert made.span("walker") == slice(0, 5)
        assert made[Mark].mark.tolist() == [[7] * 5]
        assert made[Energy].left.tolist() == [[20] * 5]
    assert worlds(parts("stone", Mark(mark=[3, 1, 2]), count=3))[Mark].mark.tolist() == [[3, 1, 2]]


@pytest.mark.parametrize("names", [("Aa", "Zz"), ("Zz", "Aa")])
def test_dimensions_name_each_other_in_any_order(names: tuple[str, str]) -> None:
    one = mechanic(names[0], dims={"wide": "middle"}, singletons=[Counted()])
    other = mechanic(names[1], dims={"middle": "agents + heals - 3 + boxes"})  # a dimension that is not here is 0
    assert layout(one, other).dims["wide"] == 2 + 15 - 3


@pytest.mark.parametrize(
    ("dim", "owner"),
    [
        ("cells", "spawn_grid"),
        ("others", "agents"),
        ("rows", "the engine"),
        ("own fields", "the engine"),
        ("capacity of hit", "the engine"),
    ],
)
def test_a_dimension_of_outlasts_is_not_added_to(dim: str, owner: str, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = mechanic("Mine")
    monkeypatch.setattr(type(mine), "dims", lambda self: {dim: 5})  # until the end: errors name who has a dimension
    with pytest.raises(DeclarationError, match=rf"mine.dims\(\) has '{dim}', a dimension of {owner}, .* 'mine {dim}'"):
        DUEL.with_(mine).worlds(1)


def test_the_room_of_events_is_added_to() -> None:
    before, after = (game.worlds(1).dims for game in (DUEL, DUEL.with_(mechanic("Mine", dims={"hits": 5}))))
    assert after == before | {"hits": before["hits"] + 5, "capacity of hit": before["capacity of hit"] + 5}


# ---- numbers


@pytest.mark.parametrize(
    ("make_module", "words"),
    [
        (lambda: Walkers(count=0), "walkers.count = 0: must be >= 1"),
        (lambda: Walkers(count=1.5), "walkers.count = 1.5: an integer"),
        (lambda: Walkers(count=2**31), "walkers.count = 2147483648: an integer below"),
        (lambda: Walkers(stride=0), "walkers.stride = 0: must be > 0 and <= 10"),
        (lambda: Walkers(stride=10.5), "walkers.stride = 10.5: must be > 0 and <= 10"),
        (lambda: Walkers(stride=float("nan")), "walkers.stride = nan: a finite number"),
        (lambda: Walkers(stride=10**400), "walkers.stride = 1000*: a finite number"),
        (lambda: Weather(gusts=(0.5, 2.0)), r"weather.gusts\[1\] = 2.0: must be >= -1 and <= 1"),
        (lambda: Weather(gusts=0.5), "weather.gusts = 0.5: a tuple of numbers"),
        (lambda: Weather(wild=1), "weather.wild = 1: True or False"),
        (lambda: Weather(sky="green"), "weather.sky = 'green': allowed are 'blue', 'grey', 'black'"),
        (lambda: Walkers().replace(pace=3), "walkers has no number 'pace'; it has: count, stride"),
        (lambda: Archetype("stone", (Mark(),), -2), "an integer >= 0 is needed"),
        (lambda: Worlds([Walkers()], 0), "at least 1 is needed"),
        (lambda: Worlds([Walkers()], 1, threads=0), "at least 1 is needed"),
        (lambda: worlds(Walkers()).number("walkers_fields"), "no number 'walkers_fields'"),
        (lambda: layout(mechanic("Mine", dims={"wide": "agents - 3"}, singletons=[Counted()])), "'wide' would be -1"),
    ],
)
def test_impossible_numbers_are_refused(make_module: Any, words: str) -> None:
    with pytest.raises(NumberError, match=words):
        make_module()


def test_another_default_of_an_unknown_number_is_refused() -> None:
    @dataclass(frozen=True)
    class Base(Toy):
        speed: float = number(1.0)

    with pytest.raises(DeclarationError, match=r"sped = 3\.0 is not a new default .*; did you mean speed\? A new"):

        class Fast(Base):
            sped = 3.0

    @dataclass(frozen=True)
    class Slow(type("Mixin", (), {}), Base):
        limit: ClassVar[int] = 3
        speed = 0.5

    assert Slow().speed == 0.5


@pytest.mark.parametrize("form", ["kw_only", "slots"])
def test_a_mechanic_is_a_dataclass_of_any_form(form: str) -> None:
    body: dict[str, Any] = {"__annotations__": {"speed": float}, "speed": number(1.0)}
    made: Any = dataclass(frozen=True, **{form: True})(type("Odd", (Toy,), body))
    assert (made().speed, made(speed=2).replace(speed=3).speed) == (1, 3)


def test_numbers_take_the_type_of_their_annotation() -> None:
    assert type(numbered("float", number(2)).speed) is float
    walkers = Walkers(count=np.int64(2), stride=2)
    assert (type(walkers.count), type(walkers.stride)) == (int, float)
    assert Weather(gusts=[1, np.float32(0.5)]).gusts == (1.0, 0.5)
    assert walkers.replace(stride=3) == Walkers(count=2, stride=3.0)
    assert (Weather(sky="black").value("sky"), Weather(wild=False).value("wild")) == (2, False)


# ---- what is refused, where it is declared


class Usable(Component):
    """What is annotated otherwise is no column that was forgotten."""

    LIMIT: Final = 3
    order: int = 4
    left: Array = column("i4")


def annotated(base: type, hint: Any) -> Any:
    return type("Odd", (base,), {"__annotations__": {"amount": hint}, "found": column("i4")})


@pytest.mark.parametrize(
    ("declare", "words"),
    [
        # components and their columns
        (lambda: component(Component, n=column("i4", fill=0.5)), "Odd.n is int32, which cannot hold 0.5"),
        (lambda: component(Component, n=column("O")), "columns hold integers, floats or truths"),
        (lambda: component(Component, n=column("i4", -2)), "Odd.n has the dimension -2: a size of at least 1 or the"),
        (lambda: component(Component, n=column("f4", low=0, high=1)), "float32 with low or high, which are of int"),
        (lambda: component(Component, n=column("i4", low=5, high=1)), "from 5 to 1: the low end must not be above"),
        (lambda: component(Component, n=column("i4", below=5)), "below 5: the name of a dimension is needed"),
        (lambda: component(Component, n=column("f4", unit="entity")), 'float32, and an index of rows: take "i4"'),
        (lambda: component(Component, order=column("i4")), "Odd.order: no column can be called so"),
        (lambda: component(Component, columns=column("i4")), r"Odd\.columns: no column can be called so"),
        (lambda: component(Singleton, n=column("i4", key="gold")), "Odd.n has a key, which only columns of an Action"),
        (lambda: component(Statistic, n=column("i4", "agents", 2)), "a statistic is one number, or has one for"),
        (lambda: component(Observation, seen=column("i4", "walkers")), "Odd.seen is int32: observations are float32"),
        (lambda: component(Observation, seen=column("f4", "walkers", fill=1)), "columns with buffers of their own"),
        (lambda: component(Action, go=column("f4", "walkers", low=0, high=1)), "Odd.go is float32 from 0 to 1"),
        (lambda: component(Action, go=column("i1", "walkers")), "finite low below a finite high"),
        (lambda: component(Action, go=column("i1", "walkers", low=0, high=300)), "0 to 300, and int8 from -128 to 127"),
        (lambda: component(Action, go=column("i1", "walkers", low=1, high=3)), "0 must be in it, which does nothing"),
        (lambda: annotated(Component, np.ndarray), "Odd.amount is not a column"),
        (lambda: annotated(Component, Array), "Odd.amount is not a column: declare it as in amount: Array = column"),
        (lambda: type("Odd", (Component,), {}, packed=False), "Odd: packed is for outlast's own components"),
        (lambda: type("Odd", (Component,), {"requires": Energy}), r"Odd.requires = .*: a tuple .* as in \(Health,\)"),
        (lambda: type("Derived", (Mark,), {"n": column("i4")}), "Derived extends Mark, which has columns"),
        (lambda: component(Singleton)(), "Odd has no columns: declare one"),
        (lambda: Energy(letf=3), "Energy has no column 'letf'; it has: left"),
        (lambda: toy_game.Line(line=1), r"Line\(line=\.\.\.\): it has buffers of its own, which begin as 0"),
        (lambda: event(agent=column("i4"), capacity=0), r"\(Event\) with the capacity 0: an integer"),
        (lambda: event(agent=column("i4"), capacity=1.5), r"\(Event\) with the capacity 1.5: an integer"),
        (lambda: Field("gold", size=2.0), "'gold' has size 2.0 and order 0: integers are needed, or as the size the"),
        (lambda: Field(5), "a field is called 5: lower-case letters"),
        # archetypes
        (lambda: Archetype("walker", Mark()), r"Archetype\('walker', .*: a tuple of instances of components"),
        (lambda: Archetype("walker", (Mark,)), r"Archetype\('walker', .*: a tuple of instances of components"),
        (lambda: Archetype("gold", (Mark(),), 2, order="x"), "with the order 'x': an integer is needed"),
        # numbers
        (lambda: numbered("int", number(1.5)), "odd.speed is annotated int, but its default is 1.5"),
        (lambda: numbered("float", number(True)), "odd.speed is annotated float, but its default is True"),
        (lambda: numbered("bool", number(1)), "odd.speed is annotated bool, but its default is 1"),
        (lambda: numbered("tuple[float, ...]", number(1.0)), "annotated tuple"),
        (lambda: numbered("str", number("slow")), "str with choices"),
        (lambda: numbered("list", number((1.0,))), "odd.speed is annotated list: a number is int, float"),
        (lambda: numbered("int", number(3, scales_with="walkers_count")), "is int and scales with another number"),
        (lambda: numbered("int", number(3), name="value"), r"a number .value., which hides Module\."),
        (lambda: numbered("float", number(3.0), name="max"), "has a number 'max', which would hide .* own max in"),
        (lambda: numbered(InitVar[int], 3), r"an InitVar, which replace\(\) would lose: declare speed: float = number"),
        (lambda: numbered(int, field(default=3, init=False)), "needs a default, and init: declare speed: int = number"),
        (lambda: numbered(int, field(default_factory=int)), "odd.speed needs a default"),
        (lambda: type("Odd", (Toy,), {"__annotations__": {"n": float}, "n": 1.0})(), r"declares numbers \(n\).*@datac"),
        # methods and systems
        (lambda: mechanic("Odd", archetype=[]), r"Odd.archetype\(\) is never called; did you mean archetypes\?"),
        (lambda: Toy.system(len), r"a phase comes first, as in @Toy\.system\("),
        (lambda: Toy.system("move"), "a phase comes first"),
        (lambda: system(place=None), r"parameter 'place' .*None.*allowed are Read\[C\]"),
        (lambda: system(place=Place), r"parameter 'place' .*Place.*allowed are Read\[C\]"),
        (lambda: system(total=Rows[Total]), r"Rows\[Total\], which is per world and has no rows"),
        (lambda: system(total=Read[int]), r"is Read\[<class 'int'>\]; a component is needed"),
        (lambda: system(clock=Write[Clock]), r"Write\[Clock\], but the engine alone .* Read\[Clock\]"),
        (lambda: system(clock=Add[Clock]), r"Add\[Clock\], but the engine alone .* Read\[Clock\]"),
    ],
)  # fmt: skip
def test_declarations_that_mean_nothing(declare: Callable[[], Any], words: str) -> None:
    with pytest.raises(DeclarationError, match=words):
        declare()


# ---- what is refused in a game


def singletons(*given: Singleton) -> Any:
    return mechanic("Brings", Toy, singletons=[*given])


def sized(size: Any) -> Module:
    return mechanic("Sized", dims={"wide": size}, singletons=[Counted()])


def agent(*components: Component, **more: Any) -> Module:
    return mechanic("Own", archetypes=[Archetype("agent", components, **more)])


def deep() -> Module:
    cube = component(Component, v=column("f4", 2, 2, 2, 2))
    extends = kind("Deeper", Toy, archetypes=[Archetype("walker", (cube(),))])
    extends.system(Phase.MOVE)(taking(cube=Read[cube]))
    return extends()


@pytest.mark.parametrize(
    ("make_worlds", "words"),
    [
        # archetypes
        (lambda: worlds(Walkers(), parts("walker", Place())), "two archetypes called 'walker' have Place, .* leave it"),
        (lambda: worlds(parts("ghost", Mark())), "extend the archetype 'ghost', but none declares how many"),
        (lambda: worlds(Walkers(), parts("wolker", Mark())), "'wolker', .*; did you mean walker"),
        (lambda: worlds(parts("ghost", Wind(), count=1)), "Wind is per world and cannot be part of 'ghost'"),
        (lambda: worlds(parts("ghost", Place(), count=1)), "no module defines the dimension 'memory'; known: blo"),
        (lambda: layout(agent(Mark(mark=7.5))), "agent: Mark.mark is uint8, which cannot hold 7.5"),
        (lambda: layout(agent(Mark(mark=np.nan))), "cannot hold nan"),
        (lambda: layout(agent(Mark(mark=(1, 2, 3)))), r"Mark.mark: the value has shape \(3,\), but shape \(2,\) is"),
        (lambda: layout(agent(Mark(mark=1), Mark(mark=2))), r"Archetype\('agent', ...\) has Mark twice"),
        (lambda: layout(agent(Mark(), alive=False)), "one module has 'agent' in the world right after reset, but a"),
        (lambda: layout(mechanic("Others", archetypes=[Archetype("rival", (Mark(),), 1, roles=True)])),
         "agent and rival both set roles: only one kind can be the agents with roles"),
        (lambda: index_unit("side", "teams"), "of unit 'side' are indices of 'sides', not of 'teams': rename one"),
        (lambda: layout(Landing(count=0)), "landing declares 0 of the kind 'place': leave landing out, or"),
        (lambda: layout(agent(component(Component, door=column("i4", below="heals"))(door=99))),
         r"agent: Odd.door begins as 99: must be from 0 to \d+"),
        (lambda: layout(agent(component(Component, door=column("i4", below="heals + healz"))())),
         r"Odd.door is below 'heals \+ healz': unknown dimension 'healz'; did you mean heals"),
        (lambda: DUEL.worlds(1).span("agents"), r"unknown kind of entities 'agents'; did you mean agent\? known"),
        (lambda: worlds(Walkers(), deep()), "Odd.v has 5 axes in a world: at most 4 are possible"),
        # dimensions and singletons
        (lambda: layout(sized("agnets")), "'wide' has the size of 'agnets', which no module has; did you mean"),
        (lambda: layout(sized("2*agents")), r"has the size of '2\*agents'"),
        (lambda: layout(sized("wide")), "in a circle: wide -> wide"),
        (lambda: layout(sized(-1)), "'wide': -1}: an integer >= 0, or names of dimensions"),
        (lambda: layout(sized(2.0)), "'wide': 2.0}: an integer"),
        (lambda: layout(singletons(component(Singleton, n=column("i4", "planets"))())), "the dimension 'planets'"),
        (lambda: layout(mechanic("One", singletons=[Total(value=1)]), mechanic("Other", singletons=[Total(value=2)])),
         "one gives Total.value the value 1, other 2: let one of them bring it"),
        (lambda: layout(singletons(event(agent=column("i4"), capacity="agentz")())),
         "Odd has the capacity 'agentz', a dimension that no .*; did you mean agents"),
        # keys
        (lambda: worlds(*toy_game.GAME, singletons(component(Action, jump=column("i2", "walkers", low=0, high=1))())),
         r"there are: Odd\.jump int16 \(3,\), Pace\.pace int8"),
        (lambda: worlds(*toy_game.GAME, singletons(component(
            Action, mine=column("i1", "walkers", key="pace", low=0, high=1))())),
         r"toy_game\.Pace\.pace and .*Odd.mine|Odd.mine and .*Pace\.pace are both the action 'pace'; rename one"),
        (lambda: worlds(*toy_game.GAME, singletons(component(Statistic, mine=column("i4", "walkers", key="meals"))())),
         "are both the statistic 'meals'; rename one"),
        (lambda: outlast.make_vec(DUEL.vary(melee_damage=outlast.distributions.integers(1, 4)).observe_numbers().with_(
            singletons(component(Observation, numbers=column("f4", "agents", 2))())), 1),
         r"NumbersView.numbers and .*Odd.numbers are both the observation"),
        # bounds
        (lambda: bounds(Worlds([*DUEL.modules, mechanic("Heats", bounds=lambda self, layout: {"owm": (0, 1)})], 1)),
         r"heats.bounds\(\) has the key 'owm', .* did you mean own"),
        (lambda: bounds(Worlds([*DUEL.modules, mechanic(
            "Fuels", singletons=[Fuel()], bounds=lambda self, layout: {"fuel": (5, 20)})], 1)),
         "the bounds of '0' in 'fuel' are 5 to 20: 0 must be in them"),
        (lambda: bounds(Worlds([*DUEL.modules, mechanic(
            "Leaks", singletons=[Fuel()], bounds=lambda self, layout: {"fuel": (0, np.nan)})], 1)), "of 'fuel' are"),
        # systems
        (lambda: worlds(Walkers(), system(energy=Read[Energy], choice=int)), "no number 'choice', .*; it has: none"),
        (lambda: worlds(system(Walkers, energy=Read[Energy], stride=int)),
         "parameter 'stride' is annotated int, but .* as float"),
        (lambda: run(worlds(Walkers(), system(memory=Scratch)), toy_game.STEP), r"'memory' but no scratch\(\)"),
        (lambda: worlds(*toy_game.GAME, system(energy=Write[Energy], kind=DamageType)), 'damage_type = "odd"'),
        # methods that return no list of their kind
        *((lambda method=method, given=given: worlds(Walkers(), mechanic("Odd", Toy, **{method: lambda self: given})),
           rf"odd\.{method}\(\) returned {words}")
          for method, given, words in (
            ("singletons", Mark(), r"Mark: a list of instances of Singleton is needed, as in return \[Singleton\("),
            ("singletons", Wind(), r"Wind: a list .* as in return \[Wind\(...\)\]"),
            ("singletons", None, "NoneType: a list of instances of Singleton"),
            ("singletons", [Wind], "a list with the class Wind: "),
            ("archetypes", Archetype("x", (), 1), r"Archetype: a list .* as in return \[Archetype\(...\)\]"),
            ("archetypes", [Mark()], "a list with Mark: a list of instances of Archetype"),
        )),
    ],
)  # fmt: skip
def test_declarations_that_do_not_fit_the_game(make_worlds: Callable[[], Any], words: str) -> None:
    with pytest.raises(DeclarationError, match=words):
        make_worlds()


@pytest.mark.skipif(not COMPILED, reason="in Python, systems have any object as scratch memory")
@pytest.mark.parametrize(
    ("memory", "words"), [(np.zeros((2, 3)).T, "ndarray: an array in order"), ([0, 0], "list: an")]
)
def test_scratch_memory_that_no_kernel_takes_is_refused(memory: Any, words: str) -> None:
    odd = kind("Odd", Toy, scratch=lambda self, name, dims: memory)
    odd.system(Phase.FEED)(taking(memory=Scratch, place=Read[Place]))
    with pytest.raises(EngineError, match=rf"odd.scratch\('memory'\) returned {words}"):
        make(Walkers(), odd())


def test_events_name_entities_that_there_are() -> None:
    made = layout(singletons(event(agent=column("i4", unit="entity"), capacity="agents")()))
    rows = np.zeros(1, [(name, np.int64) for name in ("world", "episode", "tick", "agent")])
    rows["agent"] = 999
    with pytest.raises(DeclarationError, match="the event Odd has agent = 999, and its unit is 'entity': -1 to"):
        event_table(made, {"odd": rows})


# ---- registering systems


def rush(energy: Read[Energy], stride: float = 9.0) -> None: ...
def sink(energy: Read[Energy] = None) -> None: ...
async def awaits(energy: Write[Energy], rows: Rows[Energy]) -> None: ...
def waits(energy: Write[Energy], rows: Rows[Energy]) -> object:
    yield energy.left[0]


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (rush, "rush: parameter 'stride' has the default 9.0, but every call"),
        (sink, "sink: parameter 'energy' .* leave it out$"),
        (awaits, "is a generator or a coroutine: .* write a function without"),
        (waits, "is a generator or a coroutine"),
    ],
)
def test_functions_that_cannot_be_systems_are_refused(function: Any, words: str) -> None:
    """With a default, the number's own value would count all the same; and a call runs no generator."""
    with pytest.raises(DeclarationError, match=words):
        Walkers.system(Phase.MOVE)(function)


def test_a_system_is_of_one_phase_and_of_a_mechanic_of_its_author() -> None:
    """On one of outlast's, it would be part of every game of the process, by the same name."""
    with pytest.raises(DeclarationError, match=r"motors.hurry: Motors belongs to outlast, .* class MyMotors\(Motors\)"):
        Motors.system(DuelPhase.DRIVE)(taking("hurry", agents=Rows[Side]))
    hurried, slow = kind("Hurried", Motors), taking("slow", agents=Rows[Side])
    hurried.system(DuelPhase.DRIVE, compiled=False)(slow)
    assert "hurried.slow" in [system.label for system in DUEL.with_(hurried()).worlds(1).schedule.systems]
    with pytest.raises(DeclarationError, match=r"hurried\.slow is registered for two phases"):
        hurried.system(DuelPhase.MOVE)(slow)


def test_two_systems_of_one_name_in_a_file() -> None:
    """Run again, as a cell of a notebook, a definition takes the place of the one before."""
    text, twice = "@Twice.system(Phase.MOVE)\ndef rule(marks: Rows[Mark]) -> None:\n    pass\n", kind("Twice")

    def again(source: str) -> None:
        exec(compile(source, "twice.py", "exec"), globals() | {"Twice": twice, "__name__": "twice"})

    again(text)
    again(text)
    assert [system.label for system in twice.registered] == ["twice.rule"]
    with pytest.raises(DeclarationError, match=r"twice.rule occurs twice, in lines 1 and 4 of twice.py"):
        again(text + text)


# ---- names of mechanics, and subclasses


def test_the_name_of_a_mechanic_is_its_class_in_snake_case_or_the_attribute_name() -> None:
    named = type("Named", (Toy,), {"name": "other"})
    kinds = Walkers, kind("HTTPServerOf2", Toy), named, kind("Sub", named)
    assert [each.name for each in kinds] == ["walkers", "http_server_of2", "other", "sub"]
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


Sprinters = kind("Sprinters", Marchers)
Sprinters.system(Phase.MOVE)(taking("walk", place=Write[Place], walkers=Rows[Energy]))


def test_a_label_stands_for_systems_that_inherit_or_replace_it() -> None:
    """weather.blow is after="walkers.walk": also where marchers walk in the place of walkers."""
    for each in (Marchers(), Sprinters()):
        labels = [system.label for system in Worlds([each, Food(), Weather()], 1).schedule.systems]
        assert labels.index(f"{each.name}.walk") < labels.index("weather.blow")


# ---- access


def test_a_component_without_columns_marks_entities() -> None:
    Late = type("Late", (Component,), {})  # noqa: N806
    marks = kind("Marks", Toy, archetypes=[Archetype("walker", (Late(),))])

    @marks.system(Phase.MOVE)
    def hurry(energy: Write[Energy], late: Rows[Late]) -> None:
        for e in late:
            energy.left[e] += 100

    worlds = Worlds([Walkers(), marks()], 1)
    run(worlds, toy_game.STEP)
    assert worlds.layout.rows(Late).tolist() == worlds.layout.rows(Energy).tolist() != []
    assert (worlds[Energy].left[0, worlds.layout.rows(Late)] > 100).all()
    assert len(worlds[Late]) == 0
    assert "\n  Late\n" in repr(worlds.entity(int(worlds.layout.rows(Late)[0]))) + "\n"
    for hint in (Read[Late], Write[Late]):
        with pytest.raises(DeclarationError, match=r"Late\], which has no columns; Rows\[Late\] are the entities"):
            marks.system(Phase.MOVE)(taking(late=hint))

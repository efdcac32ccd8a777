"""Slips in mechanics of one's own that once gave wrong numbers: errors that name them, or right numbers."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pytest

import outlast
from outlast.components import Body, Death, End, Guard, Health, Phase, Reward, Shape, Side, Spawned
from outlast.ecs import (
    Action,
    Archetype,
    Array,
    Component,
    DeclarationError,
    Event,
    Field,
    MemoryLayout,
    Module,
    NumberError,
    Observation,
    Read,
    Rows,
    ScheduleError,
    Singleton,
    Statistic,
    Worlds,
    Write,
    column,
    kernel,
    number,
    of,
)
from outlast.envs.core.spaces import bounds
from outlast.envs.errors import ScenarioError
from outlast.envs.inspect.event_table import event_table
from tests.conftest import COMPILED

DUEL = outlast.variant("ffa_1")


class Mark(Component):
    whole: Array = column("i4")
    small: Array = column("u1")
    real: Array = column("f4", fill=2.7)


class Total(Singleton):
    value: Array = column("i4")


class Counted(Statistic):
    counts: Array = column("f4", "wide")


def mechanic(name: str, **methods: Any) -> Module:
    """A mechanic with methods that return what is given, or call it."""
    made = {key: value if callable(value) else (lambda self, value=value: value) for key, value in methods.items()}
    module: Module = type(name, (Module,), made)()
    return module


def layout(*modules: Module) -> MemoryLayout:
    return MemoryLayout([*DUEL.modules, *modules])


# ---- dimensions


@pytest.mark.parametrize("names", [("Aa", "Zz"), ("Zz", "Aa")])
def test_dimensions_name_each_other_in_any_order(names: tuple[str, str]) -> None:
    one = mechanic(names[0], dims={"wide": "middle"}, singletons=[Counted()])
    other = mechanic(names[1], dims={"middle": "agents + heals - 3"})
    assert layout(one, other).dims["wide"] == 2 + 15 - 3


@pytest.mark.parametrize(
    ("size", "words"),
    [
        ("agnets", "'wide' is to be of the size of 'agnets', which no module has; did you mean agents?"),
        ("2*agents", "of the size of '2*agents'"),
        ("wide", "in a circle: wide -> wide"),
        (-1, "'wide': -1}: a whole number, 0 or more, or names of dimensions"),
        (2.0, "'wide': 2.0}: a whole number"),
    ],
)
def test_sizes_that_are_none(size: Any, words: str) -> None:
    with pytest.raises(DeclarationError) as error:
        layout(mechanic("Sized", dims={"wide": size}, singletons=[Counted()]))
    assert words in str(error.value)


def test_a_size_below_0_is_refused() -> None:
    with pytest.raises(NumberError, match=r"^the dimension 'wide' would be -1: at least 0 and at most 65536"):
        layout(mechanic("Sized", dims={"wide": "agents - 3"}, singletons=[Counted()]))


@pytest.mark.parametrize(
    ("dim", "owner"),
    [
        ("cells", "spawn_grid"),
        ("slots", "inventory"),
        ("sides", "free_for_all"),
        ("others", "agents"),
        ("rows", "the engine"),
        ("blocks", "the engine"),
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
    """As more can happen in a tick."""
    before, after = (game.worlds(1).dims for game in (DUEL, DUEL.with_(mechanic("Mine", dims={"hits": 5}))))
    assert after == before | {"hits": before["hits"] + 5, "capacity of hit": before["capacity of hit"] + 5}


def test_a_dimension_of_a_mechanic_that_is_left_out_is_0() -> None:
    assert layout(mechanic("Lacks", dims={"wide": "boxes"}, singletons=[Counted()])).dims["wide"] == 0


# ---- prefab values


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ((Mark(whole=7.5),), "agent: Mark.whole is int32, which cannot hold 7.5"),
        ((Mark(small=300),), "agent: Mark.small is uint8, which cannot hold 300"),
        ((Mark(whole=np.nan),), "cannot hold nan"),
        ((Mark(small=(1, 2, 3)),), r"agent: Mark.small: a value of the shape (3,) is no prefab of (2,)"),
        ((Mark(whole=1), Mark(whole=2)), "Archetype('agent', ...) has Mark twice"),
    ],
)
def test_prefab_values_that_are_none(parts: tuple[Component, ...], words: str) -> None:
    with pytest.raises(DeclarationError) as error:
        _ = layout(mechanic("Prefab", archetypes=[Archetype("agent", parts)])).initial_image
    assert words in str(error.value)


def test_a_singleton_has_one_value() -> None:
    one, other = (mechanic(name, singletons=[Total(value=value)]) for name, value in (("One", 1), ("Other", 2)))
    with pytest.raises(DeclarationError, match=r"one gives Total.value the value 1, other 2: let one of them bring it"):
        layout(one, other)
    assert layout(one, mechanic("Same", singletons=[Total(value=1)])).singletons[Total].fills == {"value": 1}


@pytest.mark.parametrize("count", [-2, 2.0, "2"])
def test_counts_that_are_none(count: Any) -> None:
    with pytest.raises(NumberError, match="a whole number, 0 or more, is needed"):
        Archetype("stone", (Mark(),), count)


def test_what_has_health_can_be_hurt() -> None:
    """Health requires Guard, whose 0 in rows without it would make all of them immune."""
    barrel = Archetype("barrel", (Body(), Shape(radius=1.0), Spawned(), Health(points=50)), 12)
    made = layout(mechanic("Barrels", archetypes=[barrel]))
    assert made.prefab_values(Guard, "immune_to")["barrel"] == -1
    env = outlast.make_vec(outlast.variant("ffa_4").with_(mechanic("Barrels", archetypes=[barrel])), 16, seed=0)
    env.reset()
    generator, hurt = np.random.default_rng(0), 0
    for _ in range(60):
        env.step(generator.integers(0, env.action_sizes, (16, env.num_agents, len(env.action_sizes))))
        hurt += int((env.events()["hit"]["target"] >= env.worlds.span("barrel").start).sum())
    assert hurt


# ---- declarations of components


def fraction() -> None:
    class Fraction(Component):
        n: Array = column("i4", fill=0.5)


def objects() -> None:
    class Objects(Component):
        n: Array = column("O")


def derived() -> None:
    class Derived(Mark):
        n: Array = column("i4")


def reserved() -> None:
    class Reserved(Component):
        order: Array = column("i4")


def wide_action() -> None:
    class Wide(Action):
        big: Array = column("i1", "agents", low=0, high=300)


def table_of_statistics() -> None:
    class Of(Statistic):
        gold: Array = column("i4", "agents", 2)


def bounded_float() -> None:
    class Gold(Component):
        share: Array = column("f4", low=0, high=1)


def swapped_ends() -> None:
    class Gold(Component):
        amount: Array = column("i4", low=5, high=1)


def below_a_number() -> None:
    class Gold(Component):
        amount: Array = column("i4", below=5)  # type: ignore[arg-type]


def float_index() -> None:
    class Gold(Component):
        owner: Array = column("f4", unit="entity")


def no_capacity() -> None:
    class Found(Event, capacity=0):
        gold: Array = column("i4")


def part_of_a_capacity() -> None:
    class Found(Event, capacity=1.5):  # type: ignore[arg-type]
        gold: Array = column("i4")


def part_of_a_field() -> None:
    Field("gold", size=2.0)


def field_without_a_name() -> None:
    Field(5)  # type: ignore[arg-type]


def array() -> None:
    class Gold(Component):
        amount: np.ndarray[Any, Any]


def bare() -> None:
    class Gold(Component):
        amount: Array
        found: Array = column("i4")


def plain_value() -> None:
    class Gold(Statistic):
        amount: Array = 5


def published() -> None:
    class Gold(Singleton):
        amount: Array = column("i4", key="gold")


def negative() -> None:
    class Gold(Component):
        amount: Array = column("i4", -2)


def buffered() -> None:
    class Gold(Component, packed=False):
        amount: Array = column("i4")


def ordered() -> None:
    Archetype("gold", (Body(),), 2, order="x")  # type: ignore[arg-type]


def rows_of_worlds() -> None:
    class Never(Module):
        pass

    @Never.system(Phase.DRIVE)
    def count(rows: Rows[Total]) -> None:
        pass


def hook() -> None:
    class Hooked(Module):
        def archetype(self) -> list[Archetype]:
            return []


@pytest.mark.parametrize(
    ("declare", "words"),
    [
        (fraction, "Fraction.n is int32, which cannot hold 0.5"),
        (objects, "columns hold integers, floats or truths"),
        (derived, "Derived extends Mark, which has columns"),
        (reserved, "Reserved.order: no column can be called so"),
        (wide_action, "Wide.big goes from 0 to 300, and int8 from -128 to 127"),
        (table_of_statistics, r"Of.gold has the dimensions \('agents', 2\): a statistic is one number, or has one for"),
        (
            bounded_float,
            "Gold.share is float32 with low or high, which are of integers and of what environments publish",
        ),
        (swapped_ends, "Gold.amount goes from 5 to 1: the low end must not be above the high one"),
        (below_a_number, "Gold.amount is below 5: the name of a dimension is needed; for a number take high"),
        (float_index, 'Gold.owner is float32, and an index of rows: take "i4"'),
        (
            no_capacity,
            r"class Found\(Event\) with the capacity 0: a whole number of at least 1, the name of a dimension",
        ),
        (part_of_a_capacity, r"class Found\(Event\) with the capacity 1.5: a whole number of at least 1"),
        (part_of_a_field, "the field 'gold' has size 2.0 and order 0: integers are needed, or as the size the name"),
        (field_without_a_name, "a field is called 5: lower-case letters"),
        (array, r"Gold.amount is no column"),
        (bare, r"Gold.amount is no column: declare it as in amount: Array = column"),
        (plain_value, r"Gold.amount is no column"),
        (published, "Gold.amount has a key, which only columns of an Action"),
        (negative, "Gold.amount has the dimension -2: a size of at least 1 or the name"),
        (buffered, "Gold: packed is for outlast's own components"),
        (ordered, r"Archetype\('gold', ...\) with the order 'x': an integer is needed"),
        (rows_of_worlds, r"Rows\[Total\], which is per world and has no rows"),
        (hook, r"Hooked.archetype\(\) is called by nothing; did you mean archetypes\?"),
    ],
)
def test_declarations_that_mean_nothing(declare: Callable[[], None], words: str) -> None:
    with pytest.raises(DeclarationError, match=words):
        declare()


class Owned(Component):
    door: Array = column("i4", below="heals")


class Slipped(Component):
    door: Array = column("i4", below="heals + healz")


class Fuel(Observation):
    fuel: Array = column("f4", "agents", 1)


@pytest.mark.parametrize(
    ("module", "words"),
    [
        (
            mechanic("Own", archetypes=[Archetype("agent", (Owned(door=99),))]),
            r"agent: Owned.door begins as 99: 0 to \d+ is its range",
        ),
        (
            mechanic("Slips", archetypes=[Archetype("agent", (Slipped(),))]),
            "Slipped.door is below 'heals \\+ healz': no dimension is called 'healz'; did you mean heals",
        ),
        (
            mechanic("Heats", bounds=lambda self, layout: {"owm": {"fuel": (0, 1)}}),
            r"heats.bounds\(\) has the key 'owm', .* did you mean own",
        ),
        (
            mechanic("Fuels", singletons=[Fuel()], bounds=lambda self, layout: {"fuel": (5, 20)}),
            "the bounds of '0' in 'fuel' are 5 to 20: 0 must be in them",
        ),
        (
            mechanic("Leaks", singletons=[Fuel()], bounds=lambda self, layout: {"fuel": (0, np.nan)}),
            r"leaks.bounds\(\) of 'fuel' are",
        ),
    ],
)
def test_declarations_that_do_not_fit_the_game(module: Module, words: str) -> None:
    with pytest.raises(DeclarationError, match=words):
        bounds(Worlds([*DUEL.modules, module], 1))


@dataclass(frozen=True)
class Landing(Module):
    count: int = number(3, low=0)

    def archetypes(self) -> list[Archetype]:
        return [Archetype("place", (Mark(),), self.count)]


def test_a_kind_of_none_is_left_out() -> None:
    with pytest.raises(DeclarationError, match="landing declares 0 of the kind 'place': at least 1 is needed"):
        layout(Landing(count=0))


def test_two_systems_of_one_name_in_a_file() -> None:
    """Run again, as a cell of a notebook, a definition takes the place of the one before."""
    text = "@Twice.system(Phase.DRIVE)\ndef rule(marks: Rows[Mark]) -> None:\n    pass\n"

    class Twice(Module):
        pass

    def run(source: str) -> None:
        names = {"Twice": Twice, "Phase": Phase, "Rows": Rows, "Mark": Mark, "__name__": "twice"}
        exec(compile(source, "twice.py", "exec"), names)

    run(text)
    run(text)
    assert [system.label for system in Twice.registered] == ["twice.rule"]
    with pytest.raises(DeclarationError, match=r"twice.rule is there twice, in lines 1 and 4 of twice.py"):
        run(text + text)


# ---- systems


@dataclass(frozen=True)
class Rules(Module):
    harm: float = number(15.0, per_agent=True)

    def archetypes(self) -> list[Archetype]:
        return [Archetype("agent", (Mark(),))]


CUTS = {
    "absolute": "marks.whole[e] = abs(marks.real[e])",
    "most": "marks.whole[e] = max(marks.real[e], 1)",
    "choice": "marks.whole[e] = marks.real[e] if e > 0 else 0",
    "floor": "marks.whole[e] = np.floor(marks.real[e])",
    "sum": "marks.whole[e] = marks.real.sum()",
    "more": "marks.whole[e] += abs(marks.real[e])",
    "part": "part = marks.whole[1:]; part[0] = abs(marks.real[e])",
    "array": "marks.small[:] = np.abs(marks.real)",
    "kernel": "store(marks, e, abs(marks.real[e]))",
    "whole": "marks.whole[e] = np.int32(abs(marks.real[e])); marks.small[:] = 3; marks.small[e] = True",
    "float": "marks.real[e] = abs(marks.real[e]); marks.real[:] = 2; marks.real[e] = e",
}


@kernel
def store(marks: Any, e: int, value: float) -> None:
    marks.whole[e] = value


@pytest.mark.skipif(not COMPILED, reason="the compiler knows the types")
@pytest.mark.parametrize("name", CUTS)
def test_no_float_is_cut_off(name: str) -> None:
    """In a branch that no trial takes."""

    class Cuts(Module):
        def archetypes(self) -> list[Archetype]:
            return [Archetype("agent", (Mark(),))]

    names: dict[str, Any] = {**globals(), "__name__": __name__}
    text = f"def {name}(marks: Write[Mark], agents: Rows[Mark]) -> None:\n    for e in agents:\n"
    text += f"        if marks.whole[e] > 100:\n            {CUTS[name]}\n"
    exec(text, names)
    Cuts.system(Phase.DRIVE)(names[name])
    if name in ("whole", "float"):
        outlast.make_vec(DUEL.with_(Cuts()), 1, seed=0).reset()
        return
    with pytest.raises(
        DeclarationError, match=rf"cuts\.{name} \(.*\):? writes a float to .*, which cuts it off; say so"
    ):
        outlast.make_vec(DUEL.with_(Cuts()), 1, seed=0).reset()


class Far(Rules):
    def systems(self) -> Any:
        return [system for system in super().systems() if system.name == "outside"]


@Far.system(Phase.DRIVE)
def outside(marks: Write[Mark], agents: Rows[Mark], harm: float) -> None:
    marks.real[agents[0]] = of(harm, 1000)


@pytest.mark.usefixtures("untried")
@pytest.mark.parametrize("interpret", [(), ("far.outside",)])
def test_the_row_of_a_number_is_checked(interpret: tuple[str, ...]) -> None:
    env = outlast.make_vec(
        DUEL.with_(Far()).roles(a=outlast.role(1, far_harm=100.0), b=outlast.role()), 1, interpret=interpret
    )
    env.reset()
    with pytest.raises(IndexError, match="the row is out of bounds"):
        env.step(np.tile(env.noop, (1, 2, 1)))


def test_an_unknown_number_is_asked_for() -> None:
    class Asks(Rules):
        def systems(self) -> Any:
            return [system for system in super().systems() if system.name == "asking"]

    @Asks.system(Phase.DRIVE)
    def asking(marks: Rows[Mark], hram: float) -> None:
        pass

    with pytest.raises(DeclarationError, match=r"no number 'hram', which asks.asking asks for; did you mean harm\?"):
        outlast.make_vec(DUEL.with_(Asks()), 1)


class Early(Module):
    pass


@Early.system(Phase.DRIVE)
def mourn(deaths: Read[Death]) -> None:
    pass


def test_an_event_is_read_when_it_can_be_there() -> None:
    with pytest.raises(ScheduleError, match=r"early.mourn in phase DRIVE .* Death, .* mortality.die in phase DIE"):
        outlast.make_vec(DUEL.with_(Early()), 1)


class Wrong(Event, capacity="agents"):
    agent: Array = column("i4", unit="entity")


class Agentz(Event, capacity="agentz"):
    agent: Array = column("i4", unit="entity")


class Usable(Component):
    """What is annotated otherwise is no column that was forgotten."""

    LIMIT: Final = 3
    order: int = 4
    left: Array = column("i4")


class Lent(Event, capacity="boxes"):
    """Of a dimension that a mechanic has which is not here."""

    agent: Array = column("i4", unit="entity")


def test_the_capacity_of_an_event_is_a_dimension() -> None:
    with pytest.raises(
        DeclarationError, match=r"Agentz has the capacity 'agentz', a dimension that no .*; did you mean agents"
    ):
        layout(mechanic("Errs", singletons=[Agentz()]))
    made = layout(mechanic("Lends", singletons=[Lent()]))
    assert made.dims[Lent.capacity_dim()] == 0


def test_events_name_entities_that_there_are() -> None:
    made = layout(mechanic("Errs", singletons=[Wrong()]))
    rows = np.zeros(1, [(name, np.int64) for name in ("world", "episode", "tick", "agent")])
    rows["agent"] = 999
    with pytest.raises(DeclarationError, match=r"the event Wrong has agent = 999, and its unit is 'entity': -1 to"):
        event_table(made, {"wrong": rows})


class Mine(Observation):
    numbers: Array = column("f4", "agents", 2)


def test_an_observation_is_not_called_as_that_of_varied_numbers() -> None:
    varied = DUEL.vary(melee_damage=outlast.integers(1, 4)).observe_numbers()
    with pytest.raises(DeclarationError, match=r"NumbersView.numbers and .*Mine.numbers are both the observation"):
        outlast.make_vec(varied.with_(mechanic("Numbered", singletons=[Mine()])), 1)


# ---- the tick of a reset


class Generous(Module):
    pass


@Generous.system(Phase.REWARD, after=Reward)
def pay(reward: Write[Reward], agents: Rows[Side]) -> None:
    for i in range(agents.size):
        reward.reward[i] += 1


@Generous.system(Phase.END, after=End)
def end(end: Write[End]) -> None:
    end.terminated[0] = True


@pytest.mark.parametrize("autoreset", ["NextStep", "SameStep", "Disabled"])
def test_a_reset_neither_pays_nor_ends(autoreset: str) -> None:
    env = outlast.make_vec(DUEL.with_(Generous()), 3, seed=0, autoreset_mode=autoreset)
    env.reset()
    assert not env.worlds[Reward].reward.any()
    for k in range(4):
        _, rewards, ends, _, info = env.step(np.tile(env.noop, (3, 2, 1)))
        begins = autoreset == "NextStep" and k % 2
        assert rewards.tolist() == [[0.0 if begins else 2.0] * 2] * 3
        assert ends.tolist() == [not begins] * 3
        if ends.any():
            assert info["statistics"]["length"].tolist() == [1] * 3
        if autoreset == "Disabled":
            env.reset(options={"reset_mask": ends})


# ---- scenarios


@dataclass(frozen=True)
class Scales(Module):
    good: float = number(5.0, scales_with="room_size")


@dataclass(frozen=True)
class Misspelt(Module):
    good: float = number(5.0, scales_with="rom_size")


def good(scenario: outlast.Scenario) -> Any:
    numbers: Mapping[str, Any] = scenario.numbers()
    return numbers["scales_good"]


def test_numbers_of_added_mechanics_scale() -> None:
    added = DUEL.with_(Scales())
    assert good(added.replace(room_size=50.0)) == 10
    assert good(added.replace(room_size=50.0).replace(room_size=100.0)) == 20
    assert good(added.replace(scales_good=7).replace(room_size=50.0)) == 7
    assert good(DUEL.replace(room_size=50.0).with_(Scales()).replace(room_size=100.0)) == 10


def test_a_number_scales_with_one_that_there_is() -> None:
    with pytest.raises(ScenarioError, match=r"misspelt_good scales with 'rom_size', .*; did you mean room_size\?"):
        DUEL.with_(Misspelt())

"""What a game on outlast.ecs alone may declare, and once got wrong numbers or a crash for."""

from collections import namedtuple
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from outlast import ecs
from outlast.ecs import (
    RESET,
    STEP,
    Action,
    Archetype,
    Array,
    Component,
    DeclarationError,
    EngineError,
    Event,
    Module,
    NumberError,
    Read,
    Rows,
    Scratch,
    When,
    Worlds,
    Write,
    choice,
    column,
    emit,
    kernel,
    number,
)
from outlast.ecs.checks.code_hash import _describe_value
from outlast.ecs.compilation.cache_key import CacheKey
from tests.conftest import COMPILED

COUNT = 2
compiled = pytest.mark.skipif(not COMPILED, reason="in Python, systems have any object as scratch memory")


class Phase(ecs.PhaseBase):
    BEGIN = When.RESET, "begun"
    MOVE = When.STEP, "moved"
    SHOW = When.ALWAYS, "shown"


class Place(Component):
    x: Array = column("f8")
    n: Array = column("i4")


@dataclass(frozen=True)
class Things(Module):
    def archetypes(self) -> list[Archetype]:
        return [Archetype("thing", (Place(),), 2)]

    def dims(self) -> dict[str, int | str]:
        return {"agents": 2}


def play(*modules: Module, **options: Any) -> Worlds:
    worlds = Worlds([Things(), *modules], COUNT, **options)
    worlds.seed(np.zeros(COUNT), np.arange(COUNT))
    for mode in (RESET, STEP):
        worlds.run(np.full(COUNT, mode, np.int8))
    return worlds


def first(worlds: Worlds, name: str) -> list[Any]:
    values: list[Any] = getattr(worlds[Place], name)[0].tolist()
    return values


# ---- names in generated code


@dataclass(frozen=True)
class Cases(Module):
    k: float = number(1.0)
    K: float = number(100.0)


@Cases.system(Phase.MOVE)
def write_both(place: Write[Place], k: float, K: float) -> None:  # noqa: N803
    place.x[0] = k
    place.x[1] = K


@pytest.mark.parametrize("interpret", [(), ("cases.write_both",)])
def test_numbers_may_differ_in_case_only(interpret: tuple[str, ...]) -> None:
    assert first(play(Cases(), interpret=interpret), "x") == [1, 100]


class HP(Component):
    v: Array = column("f8", fill=1)


class Hp(Component):
    v: Array = column("f8", fill=2)


class Hp0(Component):
    v: Array = column("f8", fill=3)


class Hp_Hp0(Component):  # noqa: N801
    v: Array = column("f8", fill=4)


class Alike(Module):
    def archetypes(self) -> list[Archetype]:
        return [Archetype("thing", (HP(), Hp(), Hp0())), Archetype("unlike", (Hp_Hp0(),), 3)]


@Alike.system(Phase.MOVE)
def read_all(
    one: Read[HP],
    two: Read[Hp],
    three: Read[Hp0],
    a: Rows[Hp, Hp0],
    b: Rows[Hp_Hp0],
    c: Rows[Hp, Hp0],
    place: Write[Place],
) -> None:
    place.x[0] = 100 * one.v[0] + 10 * two.v[0] + three.v[0]
    place.n[0], place.n[1] = 10 * a.size + c.size, b.size


def test_components_may_have_names_alike() -> None:
    worlds = play(Alike())
    assert (first(worlds, "x")[0], first(worlds, "n")[:2]) == (123, [22, 3])


# ---- what decides on machine code


def texts(value: Any) -> list[str]:
    """How a value that a kernel refers to is described in the cache's key, and in a game's identity."""

    @kernel
    def reads(x: float) -> Any:
        return value

    key = CacheKey({"reads": reads})
    return [str(key._texts), *_describe_value("value", value, [])]


def test_what_decides_on_machine_code_is_in_its_key() -> None:
    low, high = (namedtuple("Range", names)(1.0, 2.0) for names in ("low high", "high low"))  # type: ignore[misc]
    assert [one != two for one, two in zip(texts(low), texts(high), strict=True)][:2] == [True, True]
    assert texts(np.hamming)[0] != texts(np.hanning)[0]

    def forwards(a: float, b: float) -> float:
        return a - b

    def backwards(b: float, a: float) -> float:
        return b - a

    backwards.__qualname__ = forwards.__qualname__
    backwards.__code__ = backwards.__code__.replace(co_qualname=forwards.__code__.co_qualname, co_name="forwards")
    assert texts(kernel(forwards))[0] != texts(kernel(backwards))[0]
    assert [*_describe_value("table", {0: 1.0}, [])] != [*_describe_value("table", {0: 2.0}, [])]


# ---- what cannot be


class Mark(Component):
    m: Array = column("i4")


@dataclass(frozen=True)
class Marker(Module):
    which: int = number(0, low=0, high=1)

    def archetypes(self) -> list[Archetype]:
        marks = [(Place(), *([Mark()] if self.which == k else [])) for k in range(2)]
        return [Archetype("ab"[k], parts, 2) for k, parts in enumerate(marks)]


@Marker.system(Phase.MOVE)
def mark(place: Write[Place], rows: Rows[Mark], which: int) -> None:
    for e in rows:
        place.n[e] = 1 + which


def test_who_has_a_component_stays() -> None:
    worlds = play(Marker())
    with pytest.raises(NumberError, match=r"\.archetypes\(\) reads it when worlds are made"):
        worlds.set_numbers(marker_which=1)
    with pytest.raises(NumberError, match=r"\.archetypes\(\) reads it when worlds are made"):
        play(Marker(), varied={"marker_which": choice(0, 1)})


class Turned(Module):
    def scratch(self, name: str, dims: dict[str, int]) -> Any:
        return {"turned": np.zeros((2, 3)).T, "listed": [0, 0], "deep": np.zeros((1, 1, 1, 1, 1))}[name]


@Turned.system(Phase.MOVE)
def use_turned(turned: Scratch, place: Read[Place]) -> None: ...


class Listed(Turned):
    pass


@Listed.system(Phase.MOVE)
def use_turned(listed: Scratch, place: Read[Place]) -> None: ...  # noqa: F811


class Deep(Component):
    v: Array = column("f4", 2, 2, 2, 2)


class Deeper(Module):
    def archetypes(self) -> list[Archetype]:
        return [Archetype("thing", (Deep(),))]


@Deeper.system(Phase.MOVE)
def read_deep(deep: Read[Deep]) -> None: ...


class Ring(Event, capacity=2):
    who: Array = column("i4")


class Rings(Module):
    def singletons(self) -> list[Ring]:
        return [Ring()]


@Rings.system(Phase.BEGIN)
def ring(rings: Write[Ring]) -> None:
    rings.who[emit(rings)] = 1


@Rings.system(Phase.MOVE)
def hear(rings: Read[Ring]) -> None: ...


@pytest.mark.parametrize(
    ("module", "words"),
    [
        pytest.param(Turned(), r"turned.scratch\('turned'\) returned ndarray: an array in order", marks=compiled),
        pytest.param(Listed(), r"listed.scratch\('listed'\) returned list: an array", marks=compiled),
        (Deeper(), "Deep.v has 5 axes in a world: at most 4 are possible"),
        (Rings(), r"rings.hear in phase MOVE \(step\) reads Ring, .* rings.ring in phase BEGIN \(reset\)"),
    ],
    ids=lambda value: value if isinstance(value, str) else value.name,
)
def test_declarations_that_cannot_work(module: Module, words: str) -> None:
    with pytest.raises(EngineError, match=words):
        play(module)


def test_worlds_are_some_and_their_numbers_are_numbers() -> None:
    for wrong in ({"threads": 0}, {"threads": -1}):
        with pytest.raises(NumberError, match="at least 1 is needed"):
            play(**wrong)
    with pytest.raises(NumberError, match="at least 1 is needed"):
        Worlds([Things()], 0)
    with pytest.raises(NumberError, match="no number 'cases_fields'"):
        play(Cases()).number("cases_fields")


def test_two_numbers_of_one_full_name_do_not_change() -> None:
    one = dataclass(frozen=True)(type("A", (Module,), {"__annotations__": {"b_c": float}, "b_c": number(1.0)}))
    two = dataclass(frozen=True)(
        type("Ab", (Module,), {"name": "a_b", "__annotations__": {"c": float}, "c": number(1.0)})
    )
    with pytest.raises(NumberError, match="two mechanics have the number 'a_b_c'"):
        play(one(), two()).set_numbers(a_b_c=5.0)


# ---- systems that take the place of others


class Walk(Module):
    pass


@Walk.system(Phase.MOVE)
def walk(place: Write[Place]) -> None:
    place.x[0] = 1


class Blow(Module):
    pass


@Blow.system(Phase.MOVE, after="walk.walk")
def blow(place: Write[Place]) -> None:
    place.x[0] *= 10


class Sprint(Walk):
    pass


@Sprint.system(Phase.MOVE)
def walk(place: Write[Place]) -> None:  # noqa: F811
    place.x[0] = 2


class Dash(Sprint):
    pass


@Dash.system(Phase.MOVE)
def walk(place: Write[Place]) -> None:  # noqa: F811
    place.x[0] = 3


@pytest.mark.parametrize(("module", "x"), [(Walk(), 10), (Sprint(), 20), (Dash(), 30)])
def test_what_is_said_of_a_system_holds_for_what_replaces_it(module: Module, x: int) -> None:
    assert first(play(module, Blow()), "x")[0] == x


def test_a_function_is_a_system_of_one_phase() -> None:
    class Twice(Module):
        pass

    def count(place: Write[Place]) -> None:
        place.n[0] += 1

    Twice.system(Phase.BEGIN)(count)
    with pytest.raises(DeclarationError, match=r"twice\.count is registered for two phases"):
        Twice.system(Phase.MOVE)(count)


@pytest.mark.parametrize(("low", "high"), [(1, 3), (-3, -1)])
def test_an_action_can_do_nothing(low: int, high: int) -> None:
    with pytest.raises(DeclarationError, match="0 must be in it, which does nothing"):

        class Gear(Action):
            gear: Array = column("i1", "agents", low=low, high=high)

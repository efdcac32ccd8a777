"""A system reads the numbers of other mechanics by their full names: as they are now, in each world, for each agent."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pytest

import outlast
from outlast import components
from outlast.ecs import (
    Array,
    DeclarationError,
    Module,
    NumberError,
    Rows,
    Singleton,
    Worlds,
    Write,
    column,
    number,
    of,
)
from tests.engine.test_per_agent import MODULES, Pace, made, roles
from tests.helpers.toy_game import RESET, STEP, Phase, Toy, Walkers, Weather, run, system_of


class Seen(Singleton):
    stride: Array = column("f4")
    gust: Array = column("f4")
    sky: Array = column("i4")
    calm: Array = column("i4")


@dataclass(frozen=True)
class Watch(Toy):
    walkers_stride: float = number(7.0)  # its own, which counts

    def singletons(self) -> Iterable[Singleton]:
        return [Seen()]


@Watch.system(Phase.SHOW)
def look(
    seen: Write[Seen], weather_gusts: tuple[float, ...], weather_sky: int, weather_wild: bool, walkers_stride: float
) -> None:
    seen.gust[0] = weather_gusts[weather_gusts.size - 1]
    seen.sky[0] = weather_sky
    seen.calm[0] = not weather_wild
    seen.stride[0] = walkers_stride


class Peek(Toy):
    def singletons(self) -> Iterable[Singleton]:
        return [Seen()]


@Peek.system(Phase.SHOW)
def peek(seen: Write[Seen], walkers_stride: float) -> None:
    seen.stride[0] = walkers_stride


@pytest.mark.parametrize("interpret", [(), ("watch.look",)])
def test_numbers_of_others_are_read_by_their_full_names(interpret: tuple[str, ...]) -> None:
    """Of any kind; a number of the mechanic's own of that name comes first."""
    worlds = Worlds([Walkers(), Weather(gusts=(0.5, 0.75), wild=False, sky="black"), Watch()], 2, interpret=interpret)
    seen = run(worlds, RESET)[Seen]
    assert (seen.gust[1, 0], seen.sky[1, 0], seen.calm[1, 0], seen.stride[1, 0]) == (0.75, 2, 1, 7)


def test_a_number_of_another_that_changes_or_varies_is_read_as_it_is() -> None:
    worlds = run(Worlds([Walkers(), Peek()], 2), RESET)
    worlds.set_numbers(walkers_stride=2.5)
    assert run(worlds, STEP)[Seen].stride[:, 0].tolist() == [2.5, 2.5]
    varied = Worlds([Walkers(), Peek()], 40, varied={"walkers_stride": outlast.uniform(1, 2)})
    varied.seed([3] * 40, range(40))  # type: ignore[arg-type]
    strides = run(varied, RESET)[Seen].stride[:, 0]
    assert len({*strides.tolist()}) > 30
    assert ((strides >= 1) & (strides < 2)).all()


@dataclass(frozen=True)
class Idle(Toy):
    """A mechanic whose number only others read."""

    length: int = number(3)


def test_a_number_that_only_others_read_can_change() -> None:
    class Sees(Peek):
        pass

    @Sees.system(Phase.SHOW, after="sees.peek")
    def sees(seen: Write[Seen], idle_length: int) -> None:
        seen.sky[0] = idle_length

    worlds = run(Worlds([Walkers(), Idle(), Sees()], 1), RESET)
    worlds.set_numbers(idle_length=8)
    assert run(worlds, STEP)[Seen].sky[0, 0] == 8
    with pytest.raises(NumberError, match="no system gets it as a single number"):
        Worlds([Walkers(), Idle()], 1).set_numbers(idle_length=8)


def test_a_number_of_another_that_differs_by_role_is_read_for_each_agent() -> None:
    def take(pace: Write[Pace], agents: Rows[Pace], walk_step: float) -> None:
        for e in agents:
            pace.count[e] = np.int32(4 * of(walk_step, e))

    def forget(pace: Write[Pace], agents: Rows[Pace], walk_step: float) -> None:
        for e in agents:
            pace.count[e] = np.int32(4 * walk_step)

    given = roles(a=outlast.role(2, walk_step=1.25), b=outlast.role())
    for function in (take, forget):
        taker = type("Taker", (Module,), {})
        taker.system(components.Phase.SPAWN, after=Pace)(function)
        if function is take:
            worlds = made(given, modules=[*MODULES, taker()])
            assert worlds[Pace].count[:, :5].tolist() == [[5, 5, 2, 2, 2]] * 3
        else:
            with pytest.raises(DeclarationError, match=r"computes with walk_step, in which roles differ: write of\("):
                made(given, modules=[*MODULES, taker()])


def test_a_number_that_nothing_has_is_refused_with_those_that_there_are() -> None:
    def misspelt(seen: Write[Seen], walkers_strid: float) -> None: ...
    def absent(seen: Write[Seen], weather_wild: bool) -> None: ...
    def unknown(seen: Write[Seen], q: int) -> None: ...
    def other_type(seen: Write[Seen], walkers_stride: int) -> None: ...

    for function, words in (
        (misspelt, r"local has no number 'walkers_strid', which local\.misspelt asks for; did you mean walkers_stride"),
        (absent, r"local has no number 'weather_wild', .*; add Weather, which has it"),
        (unknown, r"local has no number 'q', .*; it has: none; those of others are named in full, as in physics_rate"),
        (other_type, r"local\.other_type: parameter 'walkers_stride' is annotated int, but kernels get .* as float"),
    ):
        with pytest.raises(DeclarationError, match=words):
            Worlds([Walkers(), Peek(), system_of(function, after=Seen)], 1)

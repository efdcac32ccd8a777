"""What systems get: services, and numbers of other mechanics."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest

import outlast
from outlast import components
from outlast.components import Seconds
from outlast.ecs import (
    RESET,
    SKIP,
    STEP,
    Array,
    DeclarationError,
    Module,
    NumberError,
    Read,
    Real,
    Rows,
    ScheduleError,
    Service,
    Singleton,
    Worlds,
    Write,
    column,
    kernel,
    number,
    of,
)
from tests.engine.test_per_agent import MODULES, Pace, made, roles
from tests.helpers.mechanics import kind, taking
from tests.helpers.toy_game import GAME, Food, Phase, Place, Toy, Walkers, Weather, make, run, system_of, walked

TICKS, FAR = 12, 1e6


class Absent(Singleton):  # which no game brings
    there: Array = column("f4")


class Sum(NamedTuple):
    total: Array
    places: Array


def make_sum(dims: Mapping[str, int]) -> Sum:
    return Sum(np.zeros(1), np.zeros(dims["rows"], np.float32))


def add_up(memory: Any, place: Read[Place], rows: Rows[Place]) -> None:
    memory.total[0] = 0
    for e in rows:
        memory.total[0] += place.x[e]


Total = Annotated[Any, Service(add_up, make_sum)]


class Shown(Singleton):
    seen: Array = column("f8", 4)  # what four systems get
    there: Array = column("f8", 4)  # what they should get


# Four systems that take the service: two of them behind each other, two behind one that moves all.
Looks = kind("Looks", Toy, singletons=[Shown()])


def _look(k: int) -> Any:
    def look(shown: Write[Shown], total: Total, place: Read[Place], rows: Rows[Place]) -> None:
        shown.seen[k], shown.there[k] = total.total[0], 0
        for e in rows:
            total.places[e] = place.x[e]
        for e in rows:
            shown.there[k] += total.places[e]

    look.__name__ = look.__qualname__ = f"look_{k}"
    return look


Looks.system(Phase.MOVE, after=("walkers.walk", "weather.blow"))(_look(0))
Looks.system(Phase.MOVE, after="looks.look_0")(_look(1))
Looks.system(Phase.FEED, after="food.eat")(_look(2))
Looks.system(Phase.SHOW, after="walkers.show")(_look(3))


@Looks.system(Phase.FEED, after="looks.look_2")
def shift(place: Write[Place], rows: Rows[Place]) -> None:
    for e in rows:
        place.x[e] += 1


@pytest.mark.parametrize(
    "options", [{}, {"threads": 2}, {"interpret": ("looks.look_1", "looks.look_3")}, {"specialize": True}]
)
def test_every_system_gets_what_is_true_when_it_runs(options: Any) -> None:
    worlds, rng = Worlds([*GAME, Looks()], 70, **options), np.random.default_rng(0)
    for tick in range(TICKS):
        modes = rng.choice([SKIP, STEP, RESET], 70, p=[0.2, 0.6, 0.2]) if tick else np.full(70, RESET)
        worlds[Place].x[rng.integers(70)] += 100
        before = worlds[Shown].seen.copy()
        run(worlds, modes)
        shown = worlds[Shown]
        np.testing.assert_allclose(shown.seen[modes == STEP], shown.there[modes == STEP])
        np.testing.assert_allclose(shown.seen[modes == RESET, 3], shown.there[modes == RESET, 3])
        np.testing.assert_array_equal(shown.seen[modes == SKIP], before[modes == SKIP])
    assert worlds[Shown].seen.any(0).all()


class Lazy(NamedTuple):
    total: Array
    full: Array
    place: Any
    rows: Any
    food: Any


def clear(memory: Any, place: Read[Place], rows: Rows[Place], food: Read[Absent] | None) -> None:
    memory.full[0] = 0


LazyTotal = Annotated[Any, Service(clear, lambda dims: Lazy(np.zeros(1), np.zeros(1), None, None, None), behind=True)]


@kernel
def lazy_total(memory: Any) -> float:
    if memory.full[0] == 0:
        memory.total[0] = 0
        for e in memory.rows:
            memory.total[0] += memory.place.x[e]
        memory.full[0] = 1
    return memory.total[0]


Asks = kind("Asks", Toy, singletons=[Shown()])


@Asks.system(Phase.SHOW, after="walkers.show")
def ask(shown: Write[Shown], lazy: LazyTotal, place: Read[Place], rows: Rows[Place]) -> None:
    shown.seen[0], shown.there[0] = lazy_total(lazy), 0
    for e in rows:
        shown.there[0] += place.x[e]
    if lazy.food is not None or shown.there[0] > FAR:
        raise ValueError("too far")


@pytest.mark.parametrize("options", [{}, {"threads": 2}, {"interpret": ("asks.ask",)}])
def test_what_a_system_fills_is_cleared_behind_it(options: Any) -> None:
    for count in (1, 70):
        worlds = Worlds([*GAME, Asks()], count, **options)
        for tick in range(3):
            run(worlds, STEP if tick else RESET)
            np.testing.assert_allclose(worlds[Shown].seen, worlds[Shown].there)
        worlds[Place].x[0] = 2 * FAR
        with pytest.raises(ValueError, match="too far"):
            run(worlds, STEP)
        worlds[Place].x[0] = 1
        run(worlds, STEP)
        np.testing.assert_allclose(worlds[Shown].seen, worlds[Shown].there)


def test_a_value_follows_numbers_of_others_that_change_or_vary() -> None:
    def pace(walkers_stride: float, food_count: int) -> Real:
        return np.float32(walkers_stride * food_count)

    def note(shown: Write[Shown], pace: Annotated[Real, Service(pace)]) -> None:
        shown.seen[0] = pace

    Bare = kind("Bare", Toy, singletons=[Shown()])  # noqa: N806
    Bare.system(Phase.SHOW)(note)
    worlds = run(Worlds([Walkers(stride=1.5), Food(count=4), Bare()], 2), RESET)
    assert worlds[Shown].seen[:, 0].tolist() == [6, 6]
    worlds.set_numbers(walkers_stride=2.5)
    assert run(worlds, STEP)[Shown].seen[:, 0].tolist() == [10, 10]
    drawn = {"walkers_stride": outlast.distributions.uniform(1, 2)}
    varied = Worlds([Walkers(), Food(count=4), Bare()], 9, varied=drawn)
    varied.seed(np.zeros(9, int), np.arange(9))
    strides = run(varied, RESET).numbers()["walkers_stride"]
    np.testing.assert_array_equal(varied[Shown].seen[:, 0], strides * np.float32(4))
    assert len({*strides.tolist()}) == 9


def test_a_service_is_no_part_of_the_state() -> None:
    plain, looked = (walked(make(*modules, count=3), 5) for modules in (GAME, (*GAME, Observer())))
    np.testing.assert_array_equal(plain.block, looked.block)


Observer = kind("Observer", Toy)
Observer.system(Phase.SHOW)(taking("observe", total=Total, rows=Rows[Place]))


def test_a_tick_in_seconds() -> None:
    timed = kind("Timed", singletons=[Shown()])

    def note(shown: Write[Shown], seconds: Seconds) -> None:
        shown.seen[0] = seconds

    timed.system(outlast.components.Phase.DRIVE)(note)
    env = outlast.make_vec(outlast.variant("ffa_1").with_(timed()).replace(physics_rate=50.0, physics_substeps=4), 1)
    env.reset()
    env.step(np.zeros((1, 2, 6), int))
    assert env.worlds[Shown].seen[0, 0] == np.float32(0.08)


def test_what_services_cannot_be_made_of_is_refused() -> None:
    bad = Annotated[Any, Service(add_up, lambda dims: make_sum(dims)._replace(places=None))]
    for make_it, words in (
        (lambda: Service(), "a Service needs a function, or memory, or both"),
        (lambda: Service(taking(place=Write[Place])), "'place' is write, but a service is made of read, "),
        (lambda: system_of(taking(total=Annotated[Any, 3])), r"'total' .*; allowed are .*, Annotated\[\.\.\.\] with "),
        (lambda: make(*GAME, system_of(taking(total=bad))), r"add_up: the field 'places' of its memory is NoneType"),
    ):
        with pytest.raises(DeclarationError, match=words):
            make_it()


def test_the_schedule_names_what_services_read() -> None:
    late = kind("Late", Toy)
    late.system(Phase.MOVE)(taking("look", total=Total))
    with pytest.raises(ScheduleError, match=r"late\.look and walkers\.walk .*: both touch Place"):
        Worlds([*GAME, late()], 1)
    line = next(line for line in str(Worlds([*GAME, Observer()], 1).schedule).splitlines() if "observer" in line)
    assert line.split() == ["observer.observe", "Place"]


# ---- numbers of others, by their full names: as they are now, in each world, for each agent


class Seen(Singleton):
    stride: Array = column("f4")
    gust: Array = column("f4")
    sky: Array = column("i4")
    calm: Array = column("i4")


@dataclass(frozen=True)
class Watch(Toy):
    walkers_stride: float = number(7.0)  # its own, which counts
    idle: int = number(3)

    def singletons(self) -> Iterable[Singleton]:
        return [Seen()]


@Watch.system(Phase.SHOW)
def look(seen: Write[Seen], weather_gusts: tuple[float, ...], weather_sky: int, weather_wild: bool) -> None:
    seen.gust[0], seen.sky[0], seen.calm[0] = weather_gusts[weather_gusts.size - 1], weather_sky, not weather_wild


@Watch.system(Phase.SHOW, after="watch.look")
def look_again(seen: Write[Seen], walkers_stride: float) -> None:
    seen.stride[0] = walkers_stride


@pytest.mark.parametrize("interpret", [(), ("watch.look",)])
def test_numbers_of_others_are_read_by_their_full_names(interpret: tuple[str, ...]) -> None:
    worlds = Worlds([Walkers(), Weather(gusts=(0.5, 0.75), wild=False, sky="black"), Watch()], 2, interpret=interpret)
    seen = run(worlds, RESET)[Seen]
    assert (seen.gust[1, 0], seen.sky[1, 0], seen.calm[1, 0], seen.stride[1, 0]) == (0.75, 2, 1, 7)
    worlds.set_numbers(weather_sky="blue")
    assert run(worlds, STEP)[Seen].sky[1, 0] == 0
    with pytest.raises(NumberError, match="no system gets it as a single number"):
        worlds.set_numbers(watch_idle=8)


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


@pytest.mark.parametrize(
    ("name", "hint", "words"),
    [
        ("walkers_strid", float, r"local has no number 'walkers_strid', .*; did you mean walkers_stride"),
        ("weather_wild", bool, r"local has no number 'weather_wild', .*; add Weather, which has it"),
        ("q", int, r"local has no number 'q', .*; it has: none; those of others are named in full, as in physics_rate"),
        ("walkers_stride", int, "parameter 'walkers_stride' is annotated int, but kernels get .* as float"),
    ],
)
def test_a_number_that_nothing_has_is_refused_with_those_that_there_are(name: str, hint: Any, words: str) -> None:
    with pytest.raises(DeclarationError, match=words):
        Worlds([Walkers(), system_of(taking(place=Read[Place], **{name: hint}))], 1)

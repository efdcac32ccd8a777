"""Services: what systems get that is made of other parameters."""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, NamedTuple

import numpy as np
import pytest

import outlast
from outlast import systems
from outlast.components import Seconds
from outlast.ecs import (
    RESET,
    SKIP,
    STEP,
    Array,
    DeclarationError,
    Module,
    Read,
    Real,
    Rows,
    ScheduleError,
    Service,
    Singleton,
    Worlds,
    Write,
    column,
)
from tests.helpers.toy_game import GAME, Food, Phase, Place, Toy, Walkers, make, run, system_of, walked

TICKS = 12


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


class Looks(Toy):
    """Four systems that take the service: two of them behind each other, two behind one that moves all."""

    def singletons(self) -> Iterable[Singleton]:
        return [Shown()]


def _look(k: int) -> Any:
    def look(shown: Write[Shown], total: Total, place: Read[Place], rows: Rows[Place]) -> None:
        shown.seen[k], shown.there[k] = total.total[0], 0
        for e in rows:
            total.places[e] = place.x[e]
        for e in rows:
            shown.there[k] += total.places[e]

    look.__name__ = look.__qualname__ = f"look_{k}"
    return look


for _k, (_phase, _after) in enumerate(
    [
        (Phase.MOVE, ("walkers.walk", "weather.blow")),
        (Phase.MOVE, "looks.look_0"),
        (Phase.FEED, "food.eat"),
        (Phase.SHOW, "walkers.show"),
    ]
):
    Looks.system(_phase, after=_after)(_look(_k))


@Looks.system(Phase.FEED, after="looks.look_2")
def shift(place: Write[Place], rows: Rows[Place]) -> None:
    for e in rows:
        place.x[e] += 1


@pytest.mark.parametrize(
    "options",
    [{}, {"threads": 2}, {"split": True}, {"interpret": ("looks.look_1", "looks.look_3")}, {"specialize": True}],
)
def test_every_system_gets_what_is_true_when_it_runs(options: Any) -> None:
    """In more worlds than go through a tick together, some of them in resets, and after tables were written."""
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


def test_a_value_follows_numbers_of_others_that_change_or_vary() -> None:
    def pace(walkers_stride: float, food_count: int) -> Real:
        return np.float32(walkers_stride * food_count)

    def note(shown: Write[Shown], pace: Annotated[Real, Service(pace)]) -> None:
        shown.seen[0] = pace

    class Bare(Toy):
        def singletons(self) -> Iterable[Singleton]:
            return [Shown()]

    Bare.system(Phase.SHOW)(note)
    worlds = run(Worlds([Walkers(stride=1.5), Food(count=4), Bare()], 2), RESET)
    assert worlds[Shown].seen[:, 0].tolist() == [6, 6]
    worlds.set_numbers(walkers_stride=2.5)
    assert run(worlds, STEP)[Shown].seen[:, 0].tolist() == [10, 10]
    varied = Worlds([Walkers(), Food(count=4), Bare()], 9, varied={"walkers_stride": outlast.uniform(1, 2)})
    varied.seed(np.zeros(9, int), np.arange(9))
    drawn = run(varied, RESET).numbers()["walkers_stride"]
    np.testing.assert_array_equal(varied[Shown].seen[:, 0], drawn * np.float32(4))
    assert len({*drawn.tolist()}) == 9


def test_a_service_is_no_part_of_the_state() -> None:
    """It neither changes what systems do nor the size of a world."""
    plain, looked = (walked(make(*modules, count=3), 5) for modules in (GAME, (*GAME, Observer())))
    np.testing.assert_array_equal(plain.block, looked.block)


class Observer(Toy):
    """Takes the service, and does nothing."""


@Observer.system(Phase.SHOW)
def observe(total: Total, rows: Rows[Place]) -> None: ...


def test_a_tick_in_seconds() -> None:
    class Timed(Module):
        def singletons(self) -> Iterable[Singleton]:
            return [Shown()]

    def note(shown: Write[Shown], seconds: Seconds) -> None:
        shown.seen[0] = seconds

    Timed.system(outlast.components.Phase.DRIVE)(note)
    env = outlast.make_vec(outlast.variant("ffa_1").with_(Timed()).replace(physics_rate=50.0, physics_substeps=4), 1)
    env.reset()
    env.step(np.zeros((1, 2, 6), int))
    assert env.worlds[Shown].seen[0, 0] == np.float32(0.08)
    with pytest.raises(
        DeclarationError, match=r"'physics_rate', which timed\.note asks for; add Physics, which has it"
    ):
        Worlds([Timed(), systems.Room()], 1)


def test_what_services_cannot_be_made_of_is_refused() -> None:
    def writes(place: Write[Place]) -> Real: ...

    with pytest.raises(DeclarationError, match=r"writes: parameter 'place' is write, but a service is made of read, "):
        Service(writes)

    def takes(one: Annotated[Real, Service(lambda: np.float32(1))], total: Annotated[Any, 3]) -> None: ...

    with pytest.raises(
        DeclarationError, match=r"parameter 'total' is annotated .*; allowed are .*, tuple, Annotated\[\.\.\.\] with "
    ):
        system_of(takes)


def test_the_schedule_names_what_services_read() -> None:
    """And so the order of a system that takes one must be clear."""

    class Late(Toy):
        pass

    @Late.system(Phase.MOVE)
    def look(total: Total) -> None: ...

    with pytest.raises(ScheduleError, match=r"late\.look and walkers\.walk .*: both touch Place"):
        Worlds([*GAME, Late()], 1)
    line = next(line for line in str(Worlds([*GAME, Observer()], 1).schedule).splitlines() if "observer" in line)
    assert line.split() == ["observer.observe", "Place"]

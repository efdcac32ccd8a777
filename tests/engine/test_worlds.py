"""Running worlds: each gets what it would have alone, and errors and Ctrl-C leave no thread at work."""

import copy
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.ecs import (
    Archetype,
    Component,
    DeclarationError,
    Entity,
    Module,
    Random,
    ScheduleError,
    Worlds,
    Write,
    column,
)
from outlast.ecs.kernels.random import uniform
from outlast.ecs.memory.column_places import ALIGN
from tests.conftest import COMPILED, digest, draw_actions, scaled
from tests.helpers.mechanics import mechanic
from tests.helpers.toy_game import (
    RESET,
    SKIP,
    STEP,
    Clock,
    Energy,
    Food,
    Line,
    Pay,
    Phase,
    Place,
    Toy,
    Walkers,
    Weather,
    Wind,
    make,
    run,
    walked,
)

threaded = pytest.mark.skipif(not COMPILED, reason="uncompiled ticks run in the caller's thread")
MANY = scaled(200, least=40)  # more than a thread takes at a time


def walkers(worlds: Worlds) -> Any:
    return worlds[Place].x[:, worlds.span("walker")]


def test_an_entity_can_be_looked_at() -> None:
    worlds = make(count=2)
    entity = worlds.entity(4, world=1)
    worlds[Place].x[1, 4], worlds[Place].trail[1, 4, 0] = 1.5, 7
    lines = [" ".join(line.split()) for line in repr(entity).splitlines()]
    assert lines[0] == "entity 4 of world 1 (walker 2), alive"
    assert lines[3:] == ["Place x 1.5", "trail [ 7, -1, -1]", "Energy left 20"]
    assert (entity.archetype, entity.index, entity.Energy.left, entity[Place].x) == ("walker", 2, 20, 1.5)
    assert repr(copy.deepcopy(entity)) == repr(copy.copy(entity)) == repr(entity)
    worlds[Entity].alive[1, 4] = 0
    assert repr(entity).splitlines()[0] == "entity 4 of world 1 (walker 2), not in the world"
    assert {"Place", "Energy"} <= set(dir(entity))


@pytest.mark.parametrize("row", [-1, 5, 2.0, True, "walker", None])
def test_an_unknown_row_is_refused(row: Any) -> None:
    worlds = make(count=2)
    with pytest.raises(DeclarationError, match=f"row {row!r} does not exist: there are 5, from 0 to 4"):
        worlds.entity(row)
    with pytest.raises(DeclarationError, match="world 2 does not exist: there are 2, from 0 to 1"):
        worlds.entity(0, 2)


def test_what_an_entity_lacks_is_named() -> None:
    kinds = [type("Twin", (Component,), {name: column("f4")}) for name in ("one", "two")]
    twins = mechanic("Twins", archetypes=[Archetype("twin", tuple(kind() for kind in kinds), 1)])
    food, twin = make().entity(0), Worlds([twins], 1).entity(0)
    assert [twin[kind]._fields for kind in kinds] == [("one",), ("two",)]
    for look, error, words in (
        (lambda: food.Energy, AttributeError, r"\(food 0\) has no Energy; it has: Entity, Place"),
        (lambda: food.Plaec, AttributeError, "did you mean Place"),
        (lambda: food[Energy], DeclarationError, r"\(food 0\) has no Energy; it has: Entity, Place"),
        (lambda: twin.Twin, AttributeError, r"has 2 components called Twin: take entity\[its class\]"),
    ):
        with pytest.raises(error, match=words):
            look()


def test_modes_are_per_world() -> None:
    """SKIP touches no byte, STEP runs the step phases, RESET starts an episode."""
    worlds = walked(make(count=3), 2)
    before = [digest(worlds, slice(w, w + 1)) for w in range(3)]
    energy = worlds[Energy].left.copy()
    run(worlds, [SKIP, STEP, RESET])
    assert digest(worlds, slice(0, 1)) == before[0]
    assert worlds[Clock].tick[:, 0].tolist() == [2, 3, 0]
    assert worlds[Clock].episode[:, 0].tolist() == [1, 1, 2]
    assert (worlds[Energy].left[1] != energy[1]).any()
    assert worlds[Energy].left[2].tolist() == [0, 0, 20, 20, 20]
    assert (worlds[Place].trail[2] == -1).all()
    assert np.array_equal(worlds[Line].line, walkers(worlds))  # SHOW runs on both
    assert worlds[Pay].pay[:, 0].tolist() == [2, 3, 0]


# ---- random streams


def test_seed_world_episode_and_tick_each_change_every_draw() -> None:
    base = make(count=2)
    first = walkers(base).copy()
    assert not np.isin(first[0], first[1]).any()
    assert not np.isin(walkers(make(count=2, seed=1)), first).any()
    assert not np.isin(walkers(make(count=2, first=2)), first).any()
    run(base, RESET)
    assert not np.isin(walkers(base), first).any()
    drawn = [run(base, STEP)[Wind].push.copy() for _ in range(50)]
    assert len(np.unique(drawn)) == 100
    assert np.array_equal(walkers(make(count=2)), first)


def draw(wind: Write[Wind], key: Random) -> None:
    wind.push[0] = uniform(key, 0)


def drawing(name: str, base: type[Module] = Toy, **attributes: Any) -> Module:
    """A mechanic of that name; with Toy as its base it has a system of its own, which draws."""
    attributes |= {"name": name, "singletons": lambda self: [Wind()]}
    made = type(name.title(), (base,), attributes)
    if base is Toy:
        made.system(Phase.BEGIN)(draw)
    return made()


def test_each_system_and_each_entity_has_draws_of_its_own() -> None:
    first, second = (make(Walkers(), drawing(name), count=50)[Wind].push for name in ("first", "second"))
    assert not np.isin(first, second).any()
    x = make(count=50)[Place].x
    assert len(np.unique(x)) > 248  # of 250 draws of 24 bits
    assert abs(np.corrcoef(x.T) - np.eye(5)).max() < 0.6


def test_a_subclass_draws_what_its_base_draws() -> None:
    drop, renamed = drawing("drop"), drawing("death_drop", stream="drop")
    replaced = drawing("late_drop", type(drop))
    type(replaced).system(Phase.BEGIN)(draw)
    expected, own = make(Walkers(), drop)[Wind].push, make(Walkers(), drawing("own"))[Wind].push
    mixed = type("Mixed", (type("Mixin", (), {}), type(drop)), {})()
    for other in (drawing("later", type(replaced)), replaced, mixed, renamed, drawing("below", type(renamed))):
        worlds = make(Walkers(), other)
        assert worlds.schedule.systems[0].module == other.name
        assert np.array_equal(worlds[Wind].push, expected)
    assert np.array_equal(make(Walkers(), drawing("apart", type(renamed), stream="own"))[Wind].push, own)


def test_two_systems_that_would_draw_the_same_are_refused() -> None:
    words = r"death_drop\.draw and drop\.draw have one random stream, drop\.draw, .*give drop a stream of its own"
    with pytest.raises(ScheduleError, match=words):
        Worlds([Walkers(), drawing("drop"), drawing("death_drop", stream="drop")], 1)


def test_other_modules_and_more_entities_move_no_draw() -> None:
    full, rest, most = make(count=6), make(Walkers(), count=6), make(Walkers(), Weather(wild=False), count=6)
    many = make(Walkers(5), Food(9), count=6)
    assert np.array_equal(walkers(full), walkers(rest))
    assert np.array_equal(walkers(full), walkers(many)[:, :3])
    assert np.array_equal(full[Place].x[:, full.span("food")], many[Place].x[:, many.span("food")][:, :2])
    run(full, STEP)
    run(most, STEP)
    assert full.span("walker") != most.span("walker")
    assert np.array_equal(full[Wind].push, most[Wind].push)


# ---- threads


@pytest.mark.parametrize("options", [{"threads": 2}, {"threads": 5}, {"specialize": True}])
def test_threads_and_machine_code_of_its_own_give_the_same_bits(options: Any) -> None:
    worlds = make(count=MANY, **options)
    assert digest(walked(worlds, 20)) == digest(walked(make(count=MANY), 20))
    worlds.close()
    worlds.close()
    assert digest(run(worlds, STEP)) != ""  # after close the threads come back when needed
    worlds.close()


@threaded
def test_scratch_memory_belongs_to_one_thread() -> None:
    """The toy's Weather counts in it the ticks of its thread: together, each world's once."""
    made: list[Any] = []

    def remember(self: Any, name: str, dims: dict[str, int]) -> Any:
        made.append(Weather.scratch(self, name, dims))
        return made[-1]

    gale = type("Gale", (Weather,), {"name": "weather", "scratch": remember})
    worlds = Worlds([Walkers(), Food(), gale()], MANY, 3)
    made.clear()  # one was made for its type only
    run(worlds, RESET, STEP, STEP)
    worlds.close()
    assert 1 <= len(made) <= 3
    assert sum(memory[0, 0] for memory in made) == 2 * MANY
    assert len({memory.ctypes.data for memory in made}) == len(made)


@pytest.mark.parametrize("name", ["ffa_1", "teams_4"])
def test_lines_that_steps_write_are_fetched_ahead(name: str) -> None:
    env = outlast.make_vec(name, 16, seed=0)
    env.reset()
    worlds, written, rng = env.worlds, set[int](), np.random.default_rng(0)
    for _ in range(scaled(600, least=5)):
        before = worlds.block.copy()
        env.step(draw_actions(env, rng))
        changed = (before != worlds.block)[worlds.mode == STEP].any(axis=0)
        written.update(np.flatnonzero(changed) // ALIGN)
    lines = worlds.layout.touched_lines(worlds.schedule.touched) // ALIGN
    assert written <= {*lines.tolist()}
    assert len(lines) < worlds.layout.world_bytes // ALIGN
    env.close()

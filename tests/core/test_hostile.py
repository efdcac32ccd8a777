"""Hostile saved states, and files as such: what could do harm is refused, what games lead to is not."""

import io
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Bag, Side, Sight
from outlast.ecs import Action, Clock, Component, MemoryLayout, Observation, Signal, Statistic
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import StateError
from outlast.envs.snapshots.state import State
from outlast.envs.storage import inputs
from tests.conftest import digest, draw_actions, scaled
from tests.fuzz.mutations import BOMB, bomb, memory_limit, npy, with_entry_headers, zipped


@pytest.fixture(scope="module")
def env() -> SurvivalVectorEnv:
    scenario = outlast.variant("teams_3").roles(one=outlast.role(1), others=outlast.role())
    env, rng = outlast.make_vec(scenario, 3, seed=0), np.random.default_rng(0)
    env.reset()
    for _ in range(scaled(100, 3)):
        env.step(draw_actions(env, rng))
    return env


def refusal(env: SurvivalVectorEnv, spoil: Callable[[State], None]) -> str:
    """Why a spoiled state is refused, with nothing written."""
    state, before = env.get_state(), digest(env.worlds)
    spoil(state)
    with pytest.raises(StateError) as caught:
        env.set_state(state)
    assert digest(env.worlds) == before
    env.set_state(env.get_state())
    return str(caught.value)


def table(env: SurvivalVectorEnv, state: State, component: type[Component]) -> Any:
    return env.worlds.layout.columns(state.arrays["world"], component)


RANGES: dict[str, tuple[int, int | str]] = {  # the lowest and the highest number; a name: of the last one of these
    "AgentRoles.role": (0, "roles"),
    "Bag.count": (0, "slots and none"),
    "Bag.items": (-2, "rows"),
    "BoxItem.index": (0, "boxes"),
    "Clock.tick": (0, 2**62),
    "Died.damage_type": (-1, "damage_types"),
    "Died.source": (-1, "sides"),
    "Entity.alive": (0, 1),
    "Entity.identity": (-1, 2**63 - 1),
    "Gift.taker": (-1, "rows"),
    "Health.damage_type": (-1, "damage_types"),
    "Health.source": (-1, "sides"),
    "Item.holder": (-1, "rows"),
    "Item.user": (-1, "rows"),
    "Side.side": (-1, "sides"),
    "Sight.mode": (0, 2),
    "Solid.dynamic": (0, 1),
    "Solid.may_collide": (0, 1),
    "Weapon.target": (-1, "rows"),
}


@pytest.mark.parametrize("name", RANGES)
def test_an_index_out_of_range_is_refused(env: SurvivalVectorEnv, name: str) -> None:
    kind, key = name.split(".")
    (component,) = (component for component in env.worlds.components if component.__name__ == kind)
    whole, (low, high) = np.iinfo(component.columns[key].dtype), RANGES[name]
    if isinstance(high, str):
        high = (env.worlds.dims | {"slots and none": env.worlds.dims["slots"] + 1})[high] - 1
    rows = env.worlds.layout.rows(component)
    row = int(rows[-1]) if len(rows) and env.worlds[component][0].shape[1] == env.worlds.dims["rows"] else 0
    for number in (low - 1, high + 1):
        if whole.min <= number <= whole.max:  # or the column cannot hold it

            def spoil(state: State, number: int = number) -> None:
                getattr(table(env, state, component), key)[1, row] = number

            assert f"{name} is {number} in world 1, row {row}: " in refusal(env, spoil)


HARMLESS = {  # integers that are compared, counted, or computed with, or that are random keys
    "Clock.seed", "Clock.world", "Clock.episode", "Sides.teams", "Spawned.cell",
    "Fault.physics", "Box.broken", "Box.placed", "Box.fresh", "Heal.amount", "Health.points", "Health.has_health",
    "Health.fatal_tick", "Guard.immune_to", "Guard.vulnerable_only_to", "Died.now", "Weapon.cooldown", "Score.alive",
    "Score.deaths", "Score.kills", "Cells.cells",
    "Sight.visible",  # sets, which are checked as such
}  # fmt: skip


def test_every_integer_of_a_world_is_checked_or_known_to_do_no_harm() -> None:
    """A new column declares its range, and goes into RANGES, or it goes into HARMLESS."""
    checked, free = set(), set()
    for name in outlast.VARIANTS:
        layout = MemoryLayout(outlast.variant(name).modules)
        for kind in layout.components:
            if kind.packed and not issubclass(kind, (Action, Observation, Signal, Statistic)):
                for key, each in kind.columns.items():
                    if each.dtype.kind in "iu":
                        (checked if each.range(layout.dims) else free).add(f"{kind.__name__}.{key}")
    assert free == HARMLESS
    assert checked == RANGES.keys() - {"AgentRoles.role"}  # of scenarios with roles


def put(component: type[Component], column: str, where: Any, value: Any) -> Callable[[Any], None]:
    return lambda table: getattr(table(component), column).__setitem__(where, value)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (
            lambda t: (put(Bag, "items", ..., -1)(t), put(Bag, "count", ..., 1)(t)),
            "Bag.items is -1 in world 0, row 0: ",
        ),
        (put(Sight, "visible", (2, 1, 2), 1 << 9), "Sight.visible is 512 in world 2, row 1"),
        (put(Sight, "visible", (2, 1, 2), -1), "Sight.visible is -1 in world 2, row 1: a set of"),
        (put(Side, "side", (0, 3), -1), "Side.side is -1 in world 0, row 3: 0 to 1 is needed"),
        (put(Clock, "tick", (1, 0), 2**63), "Clock.tick is 9223372036854775808 in world 1"),
    ],
)
def test_states_that_cannot_be_are_refused(env: SurvivalVectorEnv, spoil: Any, reason: str) -> None:
    assert reason in refusal(env, lambda state: spoil(lambda component: table(env, state, component)))


def test_arrays_of_other_lengths_and_truths_that_are_none_are_refused(env: SurvivalVectorEnv) -> None:
    for name in ("over", "outlast.components.score.End.truncated"):
        message = refusal(env, lambda state, name=name: state.arrays[name].view(np.uint8).fill(85))
        assert message == f"the state's array '{name}' holds bytes that are neither 0 nor 1"
    message = refusal(env, lambda state: state.arrays.update({"over": np.zeros(2, bool)}))
    assert "array 'over' is of 2 worlds, and the state of 3" in message
    assert "bool () a world" in refusal(env, lambda state: state.arrays.update({"over": np.zeros((), bool)}))


FILES = {"a.npy": npy(np.arange(6, dtype=np.int32).reshape(2, 3)), "b.npy": npy(np.zeros(1000, np.uint8))}


BOMBED = zipped({"a.npy": bomb()[0]})


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "it is empty"),
        (zipped(FILES, zipfile.ZIP_DEFLATED), "is compressed"),
        (with_entry_headers(BOMBED, 0, method=zipfile.ZIP_DEFLATED, crc=bomb()[1], unpacked=BOMB), "is compressed"),
        (with_entry_headers(zipped(FILES), 0, flags=1), "encrypted"),
        (with_entry_headers(zipped(FILES), 1, packed=2**31, unpacked=2**31), "larger than the file"),
        (with_entry_headers(zipped(FILES), 0, unpacked=1500), "larger than the file"),
        (with_entry_headers(zipped(FILES), 0, crc=1), "CRC"),
        (zipped([("a.npy", b"1"), ("a.npy", b"2")]), "the same name"),
        (zipped({"x": b"1"}), "it has no a.npy"),
    ],
)
def test_archives_that_are_not_plain_are_refused(content: bytes, reason: str) -> None:
    with memory_limit(2 * len(content) + 2**18), pytest.raises(inputs.BROKEN_ZIP, match=reason):
        inputs.zip_entries(io.BytesIO(content), ("a.npy",))
    assert inputs.zip_entries(io.BytesIO(zipped(FILES))) == FILES

"""Files and names of earlier versions: states go on and recordings replay as they did, and old names still work."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.envs.errors import RecordingError, StateError
from outlast.envs.recording.reader import Recording
from outlast.envs.recording.replay import Replay
from outlast.envs.scenarios.naming import resolve
from outlast.envs.scenarios.renamed import CLASSES, MECHANICS, NUMBERS
from outlast.envs.snapshots.state import State
from tests.conftest import COMPILED

BEFORE = Path(__file__).parents[1] / "data" / "before"
EXPECTED: dict[str, dict[str, list[float]]] = json.loads((BEFORE / "expected.json").read_text())
NAMES = list(EXPECTED)
KEYS = {"own": "self"}  # of observations: now, and then
RECORDED, TICKS = 40, 20  # ticks up to the state, and after it
TYPED = {"motors_speed": 4.0, "motors_spin": 1.0, "physics_bridge": "portable", "zone_radii": (8.0, 3.0)}


@pytest.mark.parametrize("name", NAMES)
def test_a_state_goes_on_as_it_did(name: str) -> None:
    env, rng = outlast.make_vec(name, 2, seed=5), np.random.default_rng(0)
    env.reset(seed=5)
    env.set_state(State.load(BEFORE / f"{name}.npz"))
    for tick in range(RECORDED + TICKS):
        actions = rng.integers(0, env.action_sizes, (2, env.num_agents, 6))
        if tick >= RECORDED:
            observations = env.step(actions)[0]
    found = {key: value.astype(np.float64) for key, value in observations.items()}
    sums = {KEYS.get(key, key): [value.sum(), np.abs(value).sum()] for key, value in found.items()}
    if not COMPILED:  # sines of another library: the last bit of a place
        sums = {key: pytest.approx(value, rel=1e-6) for key, value in sums.items()}
    assert sums == EXPECTED[name]
    env.close()


@pytest.mark.skipif(not COMPILED, reason="what was recorded was compiled")
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("given", [False, True])
def test_a_recording_is_replayed_to_the_bit(name: str, given: bool) -> None:
    """Of the scenario that the file names, and of one that is given; each tick is compared with its digest."""
    recording = Recording.open(BEFORE / f"{name}.rec", **({"scenario": outlast.variant(name)} if given else {}))
    assert recording.scenario.numbers() == outlast.variant(name).numbers()
    replay, path = Replay(recording), BEFORE / f"{name}.rec"
    assert len(list(replay.ticks())) == RECORDED + 1
    assert repr(recording) == f"<Recording {path}: {name}, 2 worlds, 41 ticks>"
    assert repr(replay) == f"<Replay of {path}: {name}, 2 worlds, 41 ticks>"


@pytest.mark.parametrize("name", NAMES)
def test_another_scenario_is_refused_all_the_same(name: str) -> None:
    other = outlast.variant(name).replace(safe_zone_damage=2)
    with pytest.raises(RecordingError, match="safe_zone_damage is 1 there and 2 here"):
        Recording.open(BEFORE / f"{name}.rec", scenario=other)
    env = outlast.make_vec(other, 2, seed=5)
    env.reset()
    with pytest.raises(StateError, match="safe_zone_damage is 1 there and 2 here"):
        env.set_state(State.load(BEFORE / f"{name}.npz"))
    env.close()


def steered() -> outlast.Scenario:
    return outlast.variant("teams_3+steering")


@pytest.mark.parametrize("old", NUMBERS)
def test_an_earlier_name_of_a_number_changes_it_with_a_warning(old: str) -> None:
    scenario, new = steered(), NUMBERS[old]
    value: Any = TYPED.get(old, scenario.numbers()[new])
    with pytest.warns(DeprecationWarning, match=f"{old} is now {new}") as caught:
        changed = scenario.replace(**{old: value})
    assert caught[0].filename == __file__
    assert changed == scenario.replace(**{new: value})


def test_earlier_names_of_counts_and_in_factories_work_too() -> None:
    with pytest.warns(DeprecationWarning, match="n_sides is now teams_count"):
        assert steered().replace(n_sides=4).numbers()["teams_count"] == 4
    with pytest.warns(DeprecationWarning, match="zone_damage") as caught:
        assert resolve("ffa_1", {"zone_harm": 2}) == outlast.variant("ffa_1").replace(safe_zone_damage=2)
    assert caught[0].filename == __file__
    drawn = outlast.uniform(1, 2)
    with pytest.warns(DeprecationWarning, match="motors_speed is now steering_speed"):
        assert steered().vary(motors_speed=drawn) == steered().vary(steering_speed=drawn)
    with pytest.warns(DeprecationWarning, match="motors_speed is now steering_speed"):
        fast = steered().roles(a=outlast.role(motors_speed=2.0))
    assert fast == steered().roles(a=outlast.role(steering_speed=2.0))


@pytest.mark.parametrize("new", MECHANICS)
def test_an_earlier_name_of_a_mechanic_finds_it_with_a_warning(new: str) -> None:
    scenario = outlast.variant("ffa_1") if new == "free_for_all" else steered()
    with pytest.warns(DeprecationWarning, match=f"{MECHANICS[new]} is now {new}"):
        assert scenario[MECHANICS[new]] is scenario[new]
    with pytest.warns(DeprecationWarning, match=f"{MECHANICS[new]} is now {new}"):
        assert scenario.without(MECHANICS[new]) == scenario.without(new)


def test_earlier_names_of_classes_are_imported_with_a_warning() -> None:
    for old, new in (("Contacts", "Physics"), ("AutoPickup", "Pickup")):
        with pytest.warns(DeprecationWarning, match=f"outlast.systems.{new}"):
            assert getattr(outlast.systems, old) is getattr(outlast.systems, new)
    with pytest.raises(AttributeError, match="Lasers"):
        _ = outlast.systems.Lasers


def test_what_is_renamed_exists() -> None:
    kinds = [getattr(outlast.systems, name) for name in outlast.systems.__all__]
    assert set(CLASSES.values()) <= {f"{kind.__module__}.{kind.__qualname__}" for kind in kinds}
    assert set(MECHANICS) <= {kind.name for kind in kinds}
    assert not set(NUMBERS) & set(steered().numbers())

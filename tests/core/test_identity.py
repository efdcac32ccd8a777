"""Two games are one only if their mechanics do the same: files of another game are refused, by the mechanic's name."""

import json
import os
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import pytest

import outlast
from outlast import Scenario, variant
from outlast.ecs import Module, Singleton, column
from outlast.ecs.checks.code_hash import code_digest
from outlast.envs.errors import RecordingError, StateError
from outlast.envs.recording import Recording
from outlast.envs.scenarios.fingerprint import classes, difference, fingerprint, rebuilt
from outlast.systems import Agents, Ending, FreeForAll, Motors, Rewards

MINE = '''
from dataclasses import dataclass
from enum import Enum

import numpy as np

from outlast.components import Body, Phase, Side
from outlast.components.body import inverse
from outlast.ecs import Archetype, Array, Component, Entity, Event, Module, Random, Read, Rows, Scratch, Write, column, kernel, number
from outlast.ecs.kernels.random import uniform
from outlast.ecs.kernels.simd import load


class Mud(Component):
    depth: Array = column("f4", fill=1)


class Splash(Event, capacity=4):
    agent: Array = column("i4", unit="entity")


class Kind(Enum):
    WET = 3


LIMITS = (0.5, np.float32(2))


@kernel
def slowed(speed, drag):
    """What is left of the speed."""
    return speed * (1 - drag)  # a comment


@dataclass(frozen=True)
class Swamp(Module):
    radius: float = number(4.0, above=0)

    def archetypes(self):
        return [Archetype("agent", (Mud(depth=2),))]

    def singletons(self):
        return [Splash()]

    def scratch(self, name, dims):
        return np.full(3, 0.25, np.float32)


@Swamp.system(Phase.DRIVE, after="motors")
def wade(body: Write[Body], mud: Read[Mud], entities: Read[Entity], agents: Rows[Side], memory: Scratch, radius: float, key: Random) -> None:
    for e in agents:
        if entities.alive[e] and abs(body.x[e]) < radius * LIMITS[1] and inverse(mud.depth[e]) > 0:
            body.vx[e] = slowed(body.vx[e], memory[0]) + 0 * uniform(key, Kind.WET.value)
'''  # noqa: E501
CHANGES = {  # each of them makes another game of it
    "a number in the code": ("0 * uniform", "1 * uniform"),
    "a kernel of outlast": (
        "from outlast.components.body import inverse",
        "from outlast.components.body import ONE as inverse",
    ),
    "a constant": ("np.float32(2))", "np.float32(3))"),
    "the type of a constant": ("np.float32(2)", "np.float64(2)"),
    "a member of an Enum": ("WET = 3", "WET = 4"),
    "a prefab value": ("Mud(depth=2)", "Mud(depth=3)"),
    "a default of a column": ("fill=1", "fill=2"),
    "the type of a column": ('"f4", fill', '"f8", fill'),
    "scratch memory": ("np.full(3, 0.25", "np.full(3, 0.5"),
    "room for events": ("capacity=4", "capacity=5"),
    "the phase": ("Phase.DRIVE", "Phase.USE"),
    "the order": ('after="motors"', "after=Body"),
    "the access": ("Write[Body]", "Read[Body]"),
    "the rows": ("Rows[Side]", "Rows[Side, Mud]"),
    "the order of rows": ('"agent", (Mud(depth=2),)', '"agent", (Mud(depth=2),), order=10'),
    "the stream": ("    radius: float", '    stream = "bog"\n    radius: float'),
}
SAME = {
    "a comment": ("# a comment", "# another comment"),
    "a docstring": ('"""What is left of the speed."""', '"""The rest."""'),
    "an annotation": ("def slowed(speed, drag)", "def slowed(speed: float, drag: float) -> float"),
    "what is not used": ("LIMITS =", "UNUSED = 3\nLIMITS ="),
}  # fmt: skip


def made(folder: Path, change: tuple[str, str] = ("", "")) -> type[Module]:
    """The class Swamp of a file mine.py, in which one text is replaced."""
    old, new = change
    assert old in MINE
    path = folder / "mine.py"
    path.write_text(MINE.replace(old, new) if old else MINE)
    spec = spec_from_file_location("mine", path)
    assert spec
    assert spec.loader
    module = module_from_spec(spec)
    sys.modules["mine"] = module  # where annotations are looked up
    exec(compile(path.read_text(), path, "exec"), module.__dict__)
    kind: type[Module] = module.Swamp
    return kind


@pytest.fixture(autouse=True)
def _forget_mine() -> Any:
    yield
    sys.modules.pop("mine", None)


@pytest.mark.parametrize("what", CHANGES)
def test_another_code_is_another_game(what: str, tmp_path: Path) -> None:
    one, two = (variant("ffa_1").with_(made(tmp_path, change)()) for change in (("", ""), CHANGES[what]))
    words = r"\('ffa_1'\): the code of the mechanic swamp (mine.Swamp) is another one there than here"
    assert difference(fingerprint(two), fingerprint(one)) == words.replace("\\", "")


@pytest.mark.parametrize("what", SAME)
def test_what_changes_nothing_does_not_count(what: str, tmp_path: Path) -> None:
    assert code_digest(made(tmp_path)()) == code_digest(made(tmp_path, SAME[what])())


def test_the_hash_is_the_same_in_another_process_compiled_or_not(tmp_path: Path) -> None:
    code = "import mine; from outlast.ecs.checks.code_hash import code_digest; print(code_digest(mine.Swamp()))"
    expected = code_digest(made(tmp_path)())
    for flag in ("0", "1"):
        environment = os.environ | {"NUMBA_DISABLE_JIT": flag, "PYTHONHASHSEED": flag}
        environment["PYTHONPATH"] = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
        assert (done.stdout.strip(), done.stderr) == (expected, "")


def test_fingerprints_of_outlasts_own_mechanics_are_those_of_before(tmp_path: Path) -> None:
    for name in outlast.VARIANTS:
        assert fingerprint(variant(name)).keys() == {"name", "numbers"}
    whole = fingerprint(variant("ffa_1").with_(made(tmp_path)()))
    assert json.loads(json.dumps(whole)) == whole
    without = {key: value for key, value in whole.items() if key != "code"}
    words = "('ffa_1'): here the mechanic swamp is mine.Swamp; there, nothing is known of its code"
    assert difference(without, whole) == words
    words = "('ffa_1'): there the mechanic swamp is mine.Swamp; here, nothing is known of its code"
    assert difference(whole, without) == words
    for change, words in (
        (["yours.Swamp", *whole["code"]["swamp"][1:]], "the mechanic swamp is yours.Swamp there and mine.Swamp here"),
        (["mine.Swamp", "2.7", "0"], r"the code of swamp (mine.Swamp) was Python 2.7's there"),
    ):
        assert words in difference(whole | {"code": {"swamp": change}}, whole)


@pytest.mark.parametrize("damage", [{"order": [["a"]]}, {"order": [[1, 2]]}, {"order": [1]}, {"varied": {"a": []}}])
def test_no_scenario_is_made_of_entries_that_cannot_be(damage: dict[str, Any]) -> None:
    one = variant("ffa_1")
    with pytest.raises(outlast.errors.ScenarioError):
        rebuilt(fingerprint(one) | damage, classes(one))


def test_the_order_that_a_scenario_gives_is_part_of_it() -> None:
    scenario = variant("ffa_1").ordered("melee.strike", "melee.aim")
    assert scenario != variant("ffa_1")
    assert scenario.without("heals").replace(n_agents=3).order == (("melee.strike", "melee.aim"),)
    assert "mechanics, melee.strike before melee.aim)" in repr(scenario)
    words = "('ffa_1'): the order of systems is [] there and [['melee.strike', 'melee.aim']] here"
    assert difference(fingerprint(variant("ffa_1")), fingerprint(scenario)) == words
    assert rebuilt(fingerprint(scenario), classes(scenario)).order == scenario.order
    with pytest.raises(outlast.errors.ScenarioError, match=r"\('melee',\) is not an order: at least two"):
        scenario.ordered("melee")
    with pytest.raises(outlast.errors.ScheduleError, match="run in a circle"):
        outlast.make_vec(scenario, 1)


class Mark(Singleton):
    reach: Any = column("f4")


def small(reach: float) -> Scenario:
    """With a user's mechanic whose code differs in a prefab value, which needs no other machine code."""
    kind = type("Marked", (Module,), {"singletons": lambda self: [Mark(reach=reach)]})
    return Scenario("small", (Agents(), FreeForAll(), Motors(), Rewards(), Ending(limit=20), kind()))


def test_states_and_recordings_of_another_game_are_refused(tmp_path: Path) -> None:
    envs = [outlast.make_vec(small(reach), 2, seed=0) for reach in (1.0, 1.0, 2.0)]
    for env in envs:
        env.reset()
    envs[1].set_state(envs[0].get_state())
    before = envs[2].worlds.block.copy()
    with pytest.raises(StateError, match=r"another scenario \('small'\): the code of the mechanic marked .*Marked\)"):
        envs[2].set_state(envs[0].get_state())
    assert (envs[2].worlds.block == before).all()
    envs[0].get_state().save(tmp_path / "state.npz")
    with pytest.raises(StateError, match="the code of the mechanic marked"):
        envs[2].set_state(outlast.State.load(tmp_path / "state.npz"))
    recorder = outlast.record(envs[0], tmp_path / "game.rec")
    envs[0].reset()
    recorder.close()
    assert Recording.open(tmp_path / "game.rec", scenario=small(1.0)).scenario.name == "small"
    with pytest.raises(RecordingError, match="the code of the mechanic marked"):
        Recording.open(tmp_path / "game.rec", scenario=small(2.0))
    with pytest.raises(RecordingError, match="the code of the mechanic marked"):
        Recording.open(tmp_path / "game.rec")

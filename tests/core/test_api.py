"""The public API: what `outlast` exports, documents and types is one and the same, and importing it changes nothing."""

import inspect
import os
import re
import subprocess
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

import outlast

ROOT = Path(__file__).parents[2]
SCRIPT = """
from typing import Any, assert_type

import outlast
from outlast import make_vec

env = make_vec("ffa_3", 8, seed=0, threads=2, autoreset_mode="SameStep", copy=False, melee_damage=20)
assert_type(env, outlast.SurvivalVectorEnv)
observations, info = env.reset(seed=1, options={})
env.step(env.action_space.sample())
state: outlast.State = env.get_state()
scenario: outlast.Scenario = outlast.variant("ffa_3").without("boxes").replace(n_agents=4, safe_zone_radii=(8.0, 4.0))
outlast.rollout(env, outlast.policies.random_policy(env, seed=0), steps=3).rows()
outlast.draw(env.worlds, 0, size=64)
with outlast.record(env, "duel.rec"):
    env.reset()
outlast.Replay(outlast.Recording.open("duel.rec"))
outlast.adapters.make_agents(scenario, 8, seed=0)
name: str = outlast.ABLATIONS["steering"].about
error: type[ValueError] = outlast.errors.ActionError

outlast.make_vecs("ffa_3", 8)  # E: attr-defined
env.observe_all()  # E: attr-defined
make_vec("ffa_3")  # E: call-arg
outlast.variant("ffa_3", 1)  # E: call-arg
make_vec("ffa_3", 8, seed="0")  # E: arg-type
make_vec("ffa_3", 8, melee_damage=None)  # E: arg-type
make_vec("ffa_3", 8, thread=2)  # E: call-arg
make_vec("ffa_3", 8, mele_damage=2)  # E: call-arg
outlast.rollout("ffa_3", world=2)  # E: call-arg
outlast.film("ffa_3", "a.gif", step=2)  # E: call-arg
outlast.train("ffa_2", opponent="past")  # E: call-arg
outlast.adapters.make_agents("ffa_3", 8, thread=2)  # E: call-arg
outlast.adapters.make_agents("ffa_3", 8, threads="2")  # E: arg-type
outlast.draw(env.worlds, "0")  # E: arg-type
outlast.variant("ffa_3").without(1)  # E: arg-type
wrong: int = outlast.adapters.make_agents("ffa_3", 8)  # E: assignment
"""


@pytest.mark.slow
@pytest.mark.parametrize("checker", ["mypy", "basedpyright"])
def test_right_use_passes_a_type_checker_and_each_mistake_is_found(tmp_path: Path, checker: str) -> None:
    if find_spec(checker) is None:
        pytest.skip(f"{checker} is not installed")
    (tmp_path / "user.py").write_text(SCRIPT)
    lines = enumerate(SCRIPT.splitlines(), 1)
    wrong = {number: line.rpartition("  # E: ")[2] for number, line in lines if "  # E: " in line}
    options = {
        "mypy": ["--config-file", "pyproject.toml"],
        "basedpyright": ["--level", "error", "--pythonpath", sys.executable],
    }[checker]
    command = [sys.executable, "-m", checker, *options, tmp_path / "user.py"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    found = dict(re.findall(r"user\.py:(\d+)[:\d]* (?:- )?error: .*?(?:\[([a-z-]+)\])?$", done.stdout, re.MULTILINE))
    assert {int(number) for number in found} == wrong.keys(), done.stdout + done.stderr
    if checker == "mypy":
        assert {int(number): code for number, code in found.items()} == wrong


MODULES = ("adapters", "distributions", "levels", "policies", "queries")  # of the front door; others are listed whole


def test_what_modules_list_is_there_and_on_a_page() -> None:
    """`import *`, `dir`, `__all__`, `hasattr`, what type checkers see and the pages on the API have the same names."""
    exec("from outlast import *", namespace := dict[str, object]())
    assert {*namespace} - {"__builtins__"} == {*outlast.__all__}
    assert {*outlast.__all__, "__version__"} == {*dir(outlast)}
    assert len(outlast.__all__) <= 32
    page = (ROOT / "docs/api.md").read_text()
    for name in ("outlast", *(f"outlast.{name}" for name in MODULES)):
        module = import_module(name)
        assert len({*module.__all__}) == len(module.__all__)
        for each in module.__all__:
            assert hasattr(module, each)
            assert re.search(rf"{name}\.{each}\b", page), f"{name}.{each} is not on the page"


MISSING = """
import inspect, sys
libraries = "pettingzoo", "pufferlib", "ray", "stable_baselines3", "tensorboard", "torch", "torchrl"
sys.modules |= dict.fromkeys(libraries)  # as if they were not installed
import outlast
from outlast import *
assert [name for name in outlast.__all__ if not hasattr(outlast, name)] == []
inspect.getmembers(outlast)
kinds = {name: getattr(outlast, name) for name in outlast.__all__}
kinds |= {name: getattr(outlast.adapters, name) for name in outlast.adapters.__all__}
for name in sorted(name for name, kind in kinds.items() if type(kind).__name__ == "Missing"):
    try:
        if name == "SurvivalMultiAgentEnv":
            class Mine(kinds[name]): pass
        kinds[name]("ffa_1", 1)
    except ModuleNotFoundError as error:
        assert repr(kinds[name]) == f"<{error}>" and error.name in libraries, (name, error)
        print(name, str(error).partition(" (")[0], sep=": ")
"""


def test_names_whose_libraries_are_missing_are_there_and_raise_when_they_are_called() -> None:
    """`hasattr`, `import *` and tools that list members stop at any error but AttributeError."""
    done = subprocess.run([sys.executable, "-c", MISSING], cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    pettingzoo = "parallel_env and aec_env need PettingZoo: pip install 'outlast[pettingzoo]'"
    assert dict(line.split(": ", 1) for line in done.stdout.splitlines()) == {
        "SurvivalMultiAgentEnv": pettingzoo,  # the first library that it does not find
        "aec_env": pettingzoo,
        "evaluate": "outlast.evaluate needs torch: pip install 'outlast[train]'",
        "load_policy": "saved policies need PyTorch: pip install 'outlast[train]'",
        "make_puffer": "make_puffer needs PufferLib 3: pip install 'outlast[puffer]'",
        "make_sb3": "make_sb3 needs Stable-Baselines3: pip install 'outlast[sb3]'",
        "make_torchrl": "make_torchrl needs TorchRL: pip install 'outlast[torchrl]'",
        "parallel_env": pettingzoo,
    }


def test_every_public_name_has_a_docstring() -> None:
    for name in outlast.__all__:
        assert getattr(outlast, name).__doc__


QUIET = """
import logging, os, random, sys, warnings
import gymnasium, numpy
before = [dict(os.environ), warnings.filters[:], logging.root.handlers[:], logging.root.level, random.getstate()]
state = numpy.random.get_state()[1].tolist()
import outlast
env = outlast.make_vec("ffa_3", 2, seed=0)
env.reset()
env.step(env.action_space.sample())
assert before == [dict(os.environ), warnings.filters, logging.root.handlers, logging.root.level, random.getstate()]
assert state == numpy.random.get_state()[1].tolist()
assert logging.getLogger("outlast").handlers == []
assert not {"cv2", "matplotlib", "torch", "stable_baselines3"} & sys.modules.keys(), "loaded without need"
"""


def test_a_misspelt_argument_is_not_taken_for_a_number() -> None:
    """Every public function that takes a game with its numbers, as far as the extras are installed."""
    members = [
        getattr(place, name, None) for place in (outlast, outlast.adapters) for name in place.__all__ if name != "role"
    ]
    functions = [
        each for each in members if inspect.isfunction(each) and "numbers" in inspect.signature(each).parameters
    ]
    assert {outlast.make_vec, outlast.rollout, outlast.film} <= {*functions}
    for function in functions:
        arguments = inspect.signature(function).parameters
        needed = [key for key, each in arguments.items() if each.default is each.empty and key != "numbers"]
        for key in arguments.keys() - {"numbers"}:
            given, misspelt = dict.fromkeys({*needed} - {key}, "ffa_1"), f"{key[:1]}{key[2:]}"
            message = rf"argument '{misspelt}'.*did you mean .*\b{key}\b.*\?$"
            with pytest.raises(outlast.errors.KeywordError, match=message):
                function(**given, **{misspelt: 1})


def test_words_of_other_libraries_and_names_in_other_modules_are_understood() -> None:
    with pytest.raises(outlast.errors.KeywordError, match=r"argument 'n_envs': did you mean num_worlds\?$"):
        outlast.make_vec("ffa_1", n_envs=8)  # type: ignore[call-arg]
    with pytest.raises(AttributeError, match=r"'make_sb3'; did you mean outlast\.adapters\.make_sb3\?$"):
        outlast.make_sb3  # type: ignore[attr-defined]  # noqa: B018
    with pytest.raises(AttributeError, match=r"has no attribute 'make_vecs'$") as unknown:
        outlast.make_vecs  # type: ignore[attr-defined]  # noqa: B018
    assert (unknown.value.name, unknown.value.obj) == ("make_vecs", outlast)  # of which Python makes a suggestion


def test_importing_changes_nothing_and_environments_print_nothing(tmp_path: Path) -> None:
    options = os.environ | {"OUTLAST_CACHE_DIR": str(tmp_path), "NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", QUIET], cwd=ROOT, env=options, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")

"""Policies in users' files and modules, by name: FILE.py:NAME."""

import importlib.util
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.envs.errors import ScenarioError, UsageError
from outlast.envs.rollout.lineup import checked_entries, own_policy, parse_lineup
from tests.conftest import run

TEXT = """
import numpy as np

def clever(env, seed):
    return lambda observations: np.full((env.num_worlds, env.num_agents, 6), seed % 2)

def plain(env):
    return lambda observations: np.tile(env.noop, (env.num_worlds, env.num_agents, 1))

def direct(observations):
    return np.ones((*observations["own"].shape[:2], 6), int)

def wrong(env, seed):
    return seed

number = 3
"""


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The path of a file with policies, of a name that no other test imports."""
    monkeypatch.syspath_prepend(tmp_path)  # which importing the file does, too
    path = tmp_path / f"mine_{tmp_path.name.replace('-', '_')}.py"
    path.write_text(TEXT)
    return str(path)


def test_policies_are_made_for_their_worlds_or_taken_as_they_are(mine: str) -> None:
    env = outlast.make_vec("ffa_2", 3, seed=0)
    observations, _ = env.reset()
    for name, seed, expected in (("clever", 1, 1), ("clever", 2, 0), ("plain", 0, env.noop), ("direct", 0, 1)):
        actions = np.asarray(own_policy(f"{mine}:{name}")(env, seed)(observations))
        np.testing.assert_array_equal(actions, np.broadcast_to(expected, (3, 2, 6)))
    env.close()


def test_texts_have_them_with_weights(mine: str) -> None:
    assert parse_lineup(f"{mine}:clever:2,noop,{mine}:plain") == {f"{mine}:clever": 2, "noop": 1, f"{mine}:plain": 1}
    assert parse_lineup("my.games:clever:0.5") == {"my.games:clever": 0.5}


def test_commands_and_calls_play_them(mine: str, capsys: Any) -> None:
    words = ("--worlds", "4", "--quiet", "--set", "ending_limit=5")
    status, out, _ = run(capsys, "rollout", "ffa_2", "--policy", f"{mine}:clever", "--others", f"{mine}:plain", *words)
    assert status == 0
    assert out.splitlines()[-1].split()[:2] == [f"{mine}:plain", "4"]
    same = outlast.rollout("ffa_2", f"{mine}:direct", worlds=4, seed=1, ending_limit=5, keep=True).arrays()
    made = outlast.rollout("ffa_2", f"{mine}:clever", worlds=4, seed=1, ending_limit=5, keep=True).arrays()
    assert all((same[key] == made[key]).all() for key in same)


@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs torch: outlast[train]")
def test_evaluations_play_them(mine: str) -> None:
    options: dict[str, Any] = {"episodes": 4, "worlds": 2, "ending_limit": 5, "quiet": True}
    found = outlast.evaluate("ffa_2", [f"{mine}:plain", f"{mine}:direct", "noop"], **options)
    labels = [each.label for each in found.chosen]
    assert len(set(labels)) == 3
    assert found.estimates(labels[0], "noop")["length"][0] == 5


@pytest.mark.parametrize(
    ("name", "error", "words"),
    [
        ("number", UsageError, "is 3: a policy, or a function \\(env, seed\\) that returns one, is needed"),
        ("absent", ScenarioError, "has no 'absent'"),
        ("wrong", UsageError, "returned 0: a function \\(observations\\) -> actions is needed"),
    ],
)
def test_what_is_no_policy_is_refused(mine: str, name: str, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        outlast.rollout("ffa_2", f"{mine}:{name}", worlds=2)


def test_only_where_whole_worlds_are_played(mine: str) -> None:
    """Learners' opponents get the observations of some agents, whichever these are."""
    with pytest.raises(UsageError, match="self, past or a saved policy"):
        checked_entries([(f"{mine}:clever", 1)], ("self", "past"))

"""Policies in environments whose observations, actions or restarts are of another form than policies take."""

from typing import Any

import gymnasium
import numpy as np
import pytest

import outlast
from outlast.envs.errors import UsageError
from outlast.envs.rollout.policies import STYLES

FORMS = ({"scaled": True}, {"observations": "flat"}, {"actions": "joint"}, {"actions": "continuous"})


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_what_policies_cannot_read_is_refused(form: dict[str, Any]) -> None:
    ((name, value),) = form.items()
    env = outlast.make_vec("ffa_2", 2, seed=0, **form)
    for policy, others in (("scripted", None), ("random", "noop"), ("random", "hunter")):
        with pytest.raises(UsageError, match=f"the environment has {name}={value!r}, and this policy needs {name}="):
            outlast.rollout(env, policy, others=others)
    for style in STYLES:
        with pytest.raises(UsageError, match="make another one for it"):
            getattr(outlast, f"{style}_policy")(env)


@pytest.mark.parametrize("form", FORMS, ids=str)
@pytest.mark.parametrize("policy", ["random", "noop"])
def test_who_looks_at_nothing_plays_everywhere(form: dict[str, Any], policy: str) -> None:
    one, other = (
        outlast.rollout(outlast.make_vec("ffa_2", 4, seed=3, ending_limit=60, **each), policy, episodes=2)
        for each in ({}, form)
    )
    assert one.episodes == 8
    assert one.rows() == other.rows()


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_a_saved_policy_is_refused_and_plays_as_an_opponent(form: dict[str, Any], saved: str) -> None:
    """Opponents are shown what they were trained on, whatever the learner sees."""
    env = outlast.make_vec("ffa_2", 2, seed=0, **form)
    with pytest.raises(UsageError, match="the environment has"):
        outlast.rollout(env, saved)
    with pytest.raises(UsageError, match="the environment has"):
        outlast.rollout(env, "noop", others=saved)
    healths = []
    for each in ({}, form):
        made: Any = gymnasium.make("outlast/FreeForAll2-v1", others=saved, **each)
        made.reset(seed=5)
        idle = {"multi": np.array([1, 1, 1, 0, 0, 0]), "joint": 13 * 8, "continuous": np.array([0, 0, 0, -1, -1, -1.0])}
        for _ in range(30):
            made.step(idle[each.get("actions", "multi")])
        healths.append(made.unwrapped.base_env.worlds[outlast.components.Body].x.tolist())
    assert healths[0] == healths[1]


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The file of a policy that has hardly been trained."""
    pytest.importorskip("torch", reason="needs torch: outlast[train]")
    folder = tmp_path_factory.mktemp("saved") / "run"
    outlast.train("ffa_2", folder, steps=1, worlds=4, rollout=256, quiet=True)
    return str(next(folder.glob("steps_*256.zip"), None) or max(folder.glob("steps_*.zip")))


def test_worlds_that_do_not_restart_in_time_are_refused() -> None:
    disabled, same = (outlast.make_vec("ffa_2", 2, seed=0, autoreset_mode=mode) for mode in ("Disabled", "SameStep"))
    with pytest.raises(UsageError, match="autoreset_mode='Disabled', and worlds must go on by themselves"):
        outlast.rollout(disabled, "random")
    with pytest.raises(UsageError, match="autoreset_mode='SameStep': who won could not be seen"):
        outlast.rollout(same, "hunter", others="random")
    expected = outlast.rollout(outlast.make_vec("ffa_2", 2, seed=0), "hunter")
    assert outlast.rollout(same, "hunter").rows() == expected.rows()


def test_worlds_without_a_seed_go_on() -> None:
    """As gymnasium's seeds may be [1, None]."""
    env, other = (outlast.make_vec("ffa_2", 2) for _ in range(2))
    first, _ = env.reset(seed=[1, 2])
    other.reset(seed=[1, 2])
    second, _ = env.reset(seed=[1, None])
    expected, _ = other.reset()
    assert np.array_equal(second["own"][0], first["own"][0])
    assert np.array_equal(second["own"][1], expected["own"][1])
    assert not np.array_equal(second["own"][1], first["own"][1])


def test_the_time_limit_has_another_name() -> None:
    with pytest.raises(outlast.errors.NumberError, match="the time limit of a scenario is its number ending_limit"):
        outlast.make_vec("ffa_2", 2, max_episode_steps=5)

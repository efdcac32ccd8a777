"""What the learning side once did otherwise than it said."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")
pytest.importorskip("tensorboard", reason="needs tensorboard: outlast[train]")

import outlast  # noqa: E402
from outlast.training.base.annealing import parse_anneal  # noqa: E402
from outlast.training.base.config import TrainingConfig  # noqa: E402
from outlast.training.base.errors import TrainingError  # noqa: E402
from outlast.training.base.metrics import means_of_sides  # noqa: E402
from outlast.training.ppo.rollout import RewardScale  # noqa: E402
from outlast.training.ppo.trainer import Trainer  # noqa: E402
from outlast.training.runs.run import TrainingRun  # noqa: E402

KEPT = str(Path(__file__).resolve().parents[2] / "results/policies/ffa_2/original-0.safetensors")


def test_a_policy_that_takes_the_likeliest_actions_does_so_in_evaluations() -> None:
    """And whoever evaluates it gets it back as it was."""
    policy, options = outlast.load_policy(KEPT, seed=None), {"episodes": 8, "worlds": 8, "quiet": True}
    options |= {"ending_limit": 60, "cameras_mode": "revealed"}
    found = outlast.evaluate("ffa_2", {"p": policy, "r": "random"}, **options)
    assert policy.generator is None
    plain = outlast.evaluate("ffa_2", {"p": lambda observed: policy(observed), "r": "random"}, **options)
    sampled = outlast.evaluate("ffa_2", {"p": outlast.load_policy(KEPT), "r": "random"}, **options)
    told = [str(each.estimates("p", "r")) for each in (found, plain, sampled)]
    assert told[0] == told[1] != told[2]


@pytest.mark.nightly
def test_every_one_of_many_learners_is_trained() -> None:
    crowd = outlast.variant("ffa_2").replace(n_agents=140, spawn_grid_cells=20, n_heals=1)
    trainer = Trainer(TrainingConfig(crowd, worlds=1, rollout=16, policies="agent", steps=1), 1)
    before = [policy.actor.last.weight.clone() for policy in trainer.policies]
    rollout = trainer.collect()
    trainer.update(rollout)
    assert np.unique(rollout.learner).tolist() == [*range(140)]
    assert not any(torch.equal(policy.actor.last.weight, own) for policy, own in zip(trainer.policies, before))


def test_rewards_without_a_spread_stay_as_they_are() -> None:
    scale = RewardScale(2, 0.0)
    assert scale.update(np.ones((8, 2), np.float32), np.zeros((8, 2), bool)) == 1  # then 18 ones and 2 zeros
    assert scale.update(np.eye(2, dtype=np.float32), np.zeros((2, 2), bool)) == pytest.approx(
        0.3
    )  # of 18 ones and 2 zeros


def test_a_run_whose_opponents_see_more_goes_on_from_its_beginning(tmp_path: Path) -> None:
    """Before its first checkpoint: run.json has the observations that all of them can play with."""
    opponents = {"self": 1.0, KEPT: 1.0}
    config = TrainingConfig(outlast.variant("ffa_2"), opponents=opponents, steps=256, worlds=4, rollout=128)
    TrainingRun(config, tmp_path).log.close()
    TrainingRun(config, tmp_path, resume=True).log.close()
    other = TrainingConfig(
        outlast.variant("ffa_2").replace(melee_damage=6), opponents=opponents, steps=256, worlds=4, rollout=128
    )
    with pytest.raises(TrainingError, match="was begun with another scenario"):
        TrainingRun(other, tmp_path, resume=True)


def test_annealed_numbers_are_logged_as_they_were_played() -> None:
    config = TrainingConfig(
        outlast.variant("ffa_2"), steps=3 * 128, worlds=4, rollout=64, anneal=parse_anneal(["melee_damage=1:40"])
    )
    trainer = Trainer(config, 1)
    logged = []
    for _ in range(3):
        trainer.collect()
        assert trainer.env.worlds.number("melee_damage") == trainer.report()["anneal/melee_damage"]
        logged.append(trainer.report()["anneal/melee_damage"])
    assert logged == [1, 14, 27]
    (number,) = replace(config, steps=0, anneal=parse_anneal(["melee_damage=1:40"])).anneal
    assert number.value(0, config.scenario) == 1


def test_a_number_that_varies_is_not_annealed() -> None:
    varied = outlast.variant("ffa_2").vary(melee_damage=outlast.integers(5, 20))
    with pytest.raises(TrainingError, match="melee_damage varies from world to world; annealed, it would be one"):
        TrainingConfig(varied, steps=256, worlds=4, rollout=128, anneal=parse_anneal(["melee_damage=1:40"]))


def test_the_return_of_a_side_is_the_mean_over_its_agents() -> None:
    values = np.array([[1.0, 3.0, 10.0, 7.0], [2.0, 2.0, 5.0, 0.0]])
    sides = np.array([[0, 0, 1, -1], [0, 0, 0, -1]])
    means, there = means_of_sides(values, sides, 3)
    assert means.tolist() == [[2, 10, 0], [3, 0, 0]]
    assert there.tolist() == [[True, True, False], [True, False, False]]


def test_one_opponent_is_always_chosen() -> None:
    with pytest.raises(TrainingError, match="prioritised needs several opponents"):
        TrainingConfig(outlast.variant("ffa_2"), steps=1, opponents={"self": 1.0, "scripted": 1.0}, prioritised=True)

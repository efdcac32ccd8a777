"""Who wins is what the game says: in rollouts, on pictures and pages, in evaluations and training."""

import importlib.util
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.envs.rendering.layers.end import winner
from outlast.envs.rendering.scene import Scene
from outlast.envs.rollout.outcome import Standings
from outlast.envs.web.play.game import Game
from tests.helpers.goal import TICK, won_by_points

needs_torch = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs torch: outlast[train]")


def test_rollouts_count_who_came_farthest() -> None:
    """Nobody dies: with the numbers that the game gives to sides the last one wins, without them all is drawn."""
    found = outlast.rollout(won_by_points(), "noop", worlds=4, episodes=2, others="noop", keep=True).arrays()
    assert found["result"].tolist() == ["won" if own else "lost" for own in found["own_side"]]
    assert (found["outcome"] == [-5, -4]).all()
    lived = outlast.rollout("ffa_2", "noop", worlds=4, others="noop", ending_limit=TICK)
    assert lived.outcomes["noop"].tolist() == [0, 4, 0]


@pytest.mark.parametrize("agents", [2, 3])
def test_pictures_and_pages_name_the_winner(agents: int) -> None:
    for agent in range(agents):
        game = Game(won_by_points().replace(n_agents=agents), agent=agent, others="noop", seed=3)
        game.begin()
        while game.tick():
            pass
        assert winner(Scene(game.env.worlds, 0)) == agents - 1
        assert game.state()["result"]["verdict"] == ("won" if agent == agents - 1 else "lost")
        game.close()


def test_absent_sides_do_not_win() -> None:
    game = won_by_points().replace(n_agents=3).vary(n_agents=outlast.integers(2, 3))
    env = outlast.make_vec(game, 16, seed=0, autoreset_mode="Disabled")
    env.reset()
    for _ in range(TICK):
        env.step(np.tile(env.noop, (16, 3, 1)))
    come = Standings(env.worlds).of(np.arange(16))
    counts = env.numbers()["agents_count"]
    assert set(counts) == {2, 3}
    assert (come.argmax(1) == counts - 1).all()
    env.close()


@needs_torch
def test_evaluations_and_opponents_of_training_know_it() -> None:
    from outlast.training.base.config import TrainingConfig
    from outlast.training.ppo.trainer import Trainer

    found = outlast.evaluate(won_by_points(), {"a": "noop", "b": "scripted"}, episodes=8, worlds=4, quiet=True)
    estimates: dict[str, Any] = found.estimates("a", "b")
    assert (estimates["wins_first"][0], estimates["wins_second"][0], estimates["wins"][0]) == (0, 1, 0.5)
    trainer = Trainer(TrainingConfig(won_by_points(), worlds=4, rollout=4 * TICK, opponents={"noop": 1.0}), 1)
    trainer.collect()
    lane = trainer.lane
    assert sorted(won for *_, won in lane.samples.games) == [0, 0, 1, 1]

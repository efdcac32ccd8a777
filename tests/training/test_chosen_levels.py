"""Levels that a function chooses while agents train: outlast.train(levels=...)."""

from pathlib import Path
from typing import Any

import pytest
import torch

from outlast import variant
from outlast.distributions import free, integers
from outlast.envs.rollout.saved import CHECKPOINT
from outlast.levels import FloorPlan, Level
from outlast.training.base.config import TrainingConfig
from outlast.training.base.errors import TrainingError
from outlast.training.base.policy_file import WEIGHTS
from outlast.training.policies import checkpoint
from outlast.training.ppo.curriculum import TrainingProgress
from outlast.training.ppo.trainer import Trainer
from outlast.training.runs.run import TrainingRun
from tests.helpers.runs import points

WORLDS, STEPS = 8, 24
EACH = WORLDS * STEPS * 2  # agent-steps of a rollout
SHORT = variant("ffa_1").replace(agents_health=10, safe_zone_radii=(4.0,), ending_limit=9)
SHORT = SHORT.vary(agents_health=integers(3, 12), melee_damage=integers(1, 9))
FIXED = [Level({"melee_damage": 1, "agents_health": 12}, (9, 9, 1)), Level({"melee_damage": 9}, (9, 9, 2))]


def config(levels: Any, steps: int = 2 * EACH, **changes: Any) -> TrainingConfig:
    given = {"scenario": SHORT, "preset": "fast", "steps": steps, "worlds": WORLDS, "rollout": WORLDS * STEPS}
    settings = {"batch_size": 64, "anneal_lr": False}
    return TrainingConfig(**(given | {"settings": settings, "seed": 3, "threads": 1} | changes), levels=levels)


def fixed(progress: TrainingProgress) -> list[Level]:
    return FIXED


def drawn(progress: TrainingProgress) -> list[Level]:
    """Every level that was played to its end with somebody alive, and as many new ones."""
    alive = [level for level, length in zip(progress.played, progress.statistics["length"]) if length == 9]
    return [*alive, *(Level(key=(int(k), 0, 1)) for k in progress.rng.integers(2**63, size=len(alive) + 1))]


def anything(progress: TrainingProgress) -> list[Level]:
    return [Level()]


def weights(folder: Path, steps: int) -> bytes:
    return checkpoint.read_checkpoint(folder / CHECKPOINT.format(steps))[WEIGHTS]


def test_episodes_are_drawn_from_what_is_chosen() -> None:
    asked: list[TrainingProgress] = []

    def choose(progress: TrainingProgress) -> list[Level]:
        asked.append(progress)
        return FIXED

    trainer = Trainer(config(choose))
    trainer.collect(), trainer.collect()
    assert [each.steps for each in asked] == [0, EACH, 2 * EACH]
    assert [each.levels for each in asked] == [(Level(),), (*FIXED,), (*FIXED,)]
    assert not asked[0].played
    played = asked[1].played
    assert len(played) == len(asked[1].statistics["length"]) > 2 * WORLDS
    assert (asked[1].statistics["return"].shape, asked[1].scenario) == ((len(played), 2), trainer.env.scenario)
    chosen = [level for level in [*played, *asked[2].played] if level.key in ((9, 9, 1), (9, 9, 2))]
    assert chosen == [*played, *asked[2].played]  # from the first episode on
    assert {(level.key, level.numbers["melee_damage"]) for level in chosen} == {((9, 9, 1), 1), ((9, 9, 2), 9)}
    assert all(0.2 < sum(level.key == key for level in chosen) / len(chosen) < 0.8 for key in ((9, 9, 1), (9, 9, 2)))
    first, second = (each.rng.integers(2**63) for each in asked[1:])
    assert first != second


def test_the_policy_of_the_moment_can_play() -> None:
    found: list[TrainingProgress] = []
    trainer = Trainer(config(lambda progress: found.append(progress) or FIXED))
    trainer.collect()
    policy = found[-1].policy
    policy.check(trainer.env)
    actions = policy({key: values[:3] for key, values in trainer.env.observe().items()})
    assert actions.shape == (3, 2, 6)
    for own, its in zip(trainer.policies[0].parameters(), policy.policies[0].parameters(), strict=True):
        assert torch.equal(own, its)
        assert own.data_ptr() != its.data_ptr()


@pytest.mark.parametrize("more", [{}, {"warm_start": "scripted:600"}])
def test_a_level_without_anything_is_what_worlds_draw(more: dict[str, Any], tmp_path: Path) -> None:
    for name, levels in (("plain", None), ("chosen", anything)):
        TrainingRun(config(levels, **more), tmp_path / name).train()
    assert points(tmp_path / "plain") == points(tmp_path / "chosen")
    assert weights(tmp_path / "plain", 2 * EACH) == weights(tmp_path / "chosen", 2 * EACH)


@pytest.mark.parametrize(
    ("returned", "reason"),
    [
        ([], "the function returned an empty list of levels"),
        (None, "levels = None: a list of outlast.levels.Level is needed"),
        (Level(), r"levels = Level\(.*: a list of outlast.levels.Level is needed"),
        ([3], "level 0 is 3: an outlast.levels.Level is needed"),
        ([Level(), Level({"melee_damage": 99})], r"level 1: melee_damage = 99: it varies as integers\(1, 9\)"),
        ([Level({"melee_reach": 1.0})], "level 0: melee_reach does not vary here"),
    ],
)
def test_what_are_no_levels_is_refused(returned: Any, reason: str) -> None:
    trainer = Trainer(config(lambda progress: returned))
    with pytest.raises(TrainingError, match=reason):
        trainer.collect()


def test_what_cannot_choose_is_refused() -> None:
    with pytest.raises(TrainingError, match=r"levels = 'levels.json': must be a function"):
        config("levels.json")
    with pytest.raises(TrainingError, match="the levels function runs in one process only"):
        config(fixed, processes=2)
    plan = FloorPlan(walls=[(-4, 0, 0.5, 8)])
    game = variant("ffa_1").with_(plan.mechanic(1)).vary(walls_layout=free(plan.layout(1)))
    chosen = [Level()] * 99_999 + [Level({"walls_layout": (0, 0, -1, 1, 0, 0)})]  # which hardly any world gets
    trainer = Trainer(config(lambda progress: chosen, scenario=game))
    with pytest.raises(TrainingError, match=r"must return levels: level 99999: walls\.layout: rectangle 0"):
        trainer.collect()


def test_a_run_goes_on_with_the_same_choice_and_levels_only(tmp_path: Path) -> None:
    TrainingRun(config(fixed), tmp_path).train()
    with pytest.raises(TrainingError, match=r"was begun with levels = .*fixed, not .*drawn"):
        TrainingRun(config(drawn, 4 * EACH), tmp_path, resume=True)
    with pytest.raises(TrainingError, match=r"was begun with levels = .*fixed, not None"):
        TrainingRun(config(None, 4 * EACH), tmp_path, resume=True)
    trainer = Trainer(config(fixed))
    assert trainer.curriculum is not None
    for given in (None, 3, "nonsense", "[]", "[1]", '[{"numbers": {"melee_damage": 99}, "key": null}]'):
        with pytest.raises(TrainingError, match=r"levels in rest.safetensors of the checkpoint"):
            trainer.curriculum.restore(given)

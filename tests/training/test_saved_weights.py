"""Files of weights play wherever checkpoints do, with and without a critic."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs torch: outlast[train]")
pytest.importorskip("safetensors", reason="needs safetensors: outlast[train]")

import torch

import outlast
from outlast import load_policy, make_vec, variant
from outlast.envs.rollout.lineup import parse_lineup
from outlast.training.base import policy_file
from outlast.training.base.config import TrainingConfig, parse_warm_start
from outlast.training.base.errors import TrainingError
from outlast.training.benchmark.described import described
from outlast.training.benchmark.tasks import task_of
from outlast.training.policies import checkpoint
from outlast.training.policies.player import Player
from outlast.training.ppo.trainer import Trainer
from outlast.training.runs import resume
from outlast.training.runs.film import film_checkpoint
from tests.conftest import run

pytestmark = pytest.mark.usefixtures("one_torch_thread")
SIZE = {"worlds": 2, "rollout": 64}


@pytest.fixture(params=["fast", "original"])
def places(request: pytest.FixtureRequest, tmp_path: Path) -> dict[str, Path]:
    """Paths of one policy: a checkpoint, its weights, and these without the critic."""
    trainer = Trainer(TrainingConfig(variant("ffa_2"), request.param, **SIZE))
    generator = torch.Generator().manual_seed(0)
    for weight in trainer.policies[0].parameters():  # which float16 holds
        torch.nn.init.normal_(weight, std=0.1, generator=generator)
        weight.data.copy_(weight.data.half())
    found = {name: tmp_path / f"{name}.safetensors" for name in ("whole", "acting")} | {"zip": tmp_path / "a.zip"}
    checkpoint.write_checkpoint(found["zip"], resume.capture(trainer, trainer.config.header()))
    header, (weights,) = checkpoint.read_policies(found["zip"])
    own = {name: values.numpy() for name, values in weights.items()}
    policy_file.write(found["whole"], header, [own])
    acting = {name: values for name, values in own.items() if not name.startswith(policy_file.CRITIC)}
    policy_file.write(found["acting"], header, [acting])
    assert len(acting) < len(own)
    return found


def test_they_play_as_the_checkpoint_does(places: dict[str, Path]) -> None:
    players = {name: load_policy(path, 3) for name, path in places.items()}
    env = make_vec(players["zip"].scenario(variant("ffa_2")), 4, seed=0)
    observations, _ = env.reset()
    for _ in range(20):
        actions = {name: player(observations) for name, player in players.items()}
        assert np.array_equal(actions["whole"], actions["zip"])
        assert np.array_equal(actions["acting"], actions["zip"])
        observations, *_ = env.step(actions["zip"])
    explained = {name: player.explainer()(observations) for name, player in players.items()}
    assert np.isnan(explained["acting"][0]).all()
    np.testing.assert_array_equal(explained["whole"][0], explained["zip"][0])
    for name in ("whole", "acting"):
        assert all(map(np.array_equal, explained[name][1:], explained["zip"][1:])), name
    assert [player.critic for player in players.values()] == [True, False, True]
    assert all(player.header == players["zip"].header for player in players.values())


def test_they_are_named_as_checkpoints_are(places: dict[str, Path], tmp_path: Path, capsys: Any) -> None:
    """In rollouts, evaluations, films and the benchmark's descriptions, all of which take a checkpoint, too."""
    path, preset = str(places["acting"]), Player(places["zip"]).preset.name
    assert parse_lineup(f"{path}:2,scripted") == {path: 2.0, "scripted": 1.0}
    names = ("--worlds=2", "--steps=20", "--quiet")
    for policy, others in ((path, "scripted"), ("scripted", f"{path}:1,noop:1")):
        assert run(capsys, "rollout", "ffa_2", "--policy", policy, "--others", others, *names)[0] == 0
    assert "acting" in str(outlast.evaluate("ffa_2", [path, "random"], episodes=2, worlds=2))
    pytest.importorskip("imageio_ffmpeg", reason="needs imageio-ffmpeg: outlast[video]")
    assert film_checkpoint(places["acting"], tmp_path / "films") == [tmp_path / "films" / "acting.webm"]
    about = [described(places[name], task_of("ffa_2-v1")) for name in ("acting", "zip")]
    assert [(each["steps"], each["of_task"], each["met"]) for each in about] == [(0, True, [])] * 2
    config = TrainingConfig(variant("ffa_2"), preset, opponents={"self": 1.0, path: 1.0}, **SIZE)
    Trainer(config).collect()


def test_a_run_begins_with_their_weights_if_there_is_a_critic(places: dict[str, Path]) -> None:
    whole, acting = str(places["whole"]), str(places["acting"])
    preset = Player(whole).preset.name
    assert [parse_warm_start(text) for text in (whole, f"{whole}:2e6")] == [(whole, 0), (whole, 2_000_000)]
    trainer = Trainer(TrainingConfig(variant("ffa_2"), preset, warm_start=whole, **SIZE))
    trainer.take_weights()
    like = Player(places["zip"]).policies[0].state_dict()
    assert all(torch.equal(values, like[name]) for name, values in trainer.policies[0].state_dict().items())
    bare = Trainer(TrainingConfig(variant("ffa_2"), preset, warm_start=acting, **SIZE))
    with pytest.raises(TrainingError, match=r"acting\.safetensors has no critic, .*: --warm-start .*acting\.safet.*:"):
        bare.take_weights()
    taught = Trainer(TrainingConfig(variant("ffa_2"), preset, warm_start=f"{acting}:64", **SIZE))
    assert taught.imitate(lambda done, tags: None)


def test_weights_of_another_policy_are_refused(places: dict[str, Path], tmp_path: Path) -> None:
    header, (own,) = policy_file.read(places["acting"])
    cases: list[tuple[dict[str, Any], dict[str, Any], str]] = [
        ({}, {name: own[name] for name in list(own)[1:]}, "does not hold the weights"),
        ({}, own | {"critic.last.bias": np.zeros(1, np.float32)}, "does not hold the weights"),
        ({}, own | {"actor.last.bias": np.full(own["actor.last.bias"].shape, np.nan)}, "beyond 1000, or that are none"),
        ({"actions": [60_000]}, own, "too small for the observations"),
        ({"actions": [3, 3]}, own, "actor.last.weight"),
    ]
    for changes, weights, words in cases:
        policy_file.write(tmp_path / "b.safetensors", header | changes, [weights])
        with pytest.raises(TrainingError, match=rf"b\.safetensors is broken: .*{words}"):
            load_policy(tmp_path / "b.safetensors")
    (tmp_path / "c.safetensors").write_bytes(places["zip"].read_bytes())
    with pytest.raises(TrainingError, match=r"c\.safetensors is not a policy"):
        load_policy(tmp_path / "c.safetensors")

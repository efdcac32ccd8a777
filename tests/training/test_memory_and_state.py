"""Policies with a memory, and critics that learn from the state of the whole world."""

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from outlast import load_policy, make_vec, variant
from outlast.components import Body
from outlast.envs.rollout.memory import told
from outlast.training.base.config import CHUNK, TrainingConfig
from outlast.training.base.errors import TrainingError
from outlast.training.base.observation_layout import ObservationLayout
from outlast.training.base.presets import PRESETS, Form, Hyperparameters, preset
from outlast.training.policies import checkpoint
from outlast.training.policies.policy import ActorCritic
from outlast.training.policies.rows import Observed, Packer, Rows, concatenated
from outlast.training.ppo.learner import Learner
from outlast.training.ppo.minibatches import Samples, normalised
from outlast.training.ppo.rollout import NOBODY, Rollout
from outlast.training.ppo.trainer import Trainer, capture

SHORT = variant("ffa_2").replace(agents_health=10, safe_zone_radii=(9.0, 4.0), safe_zone_stand=10, safe_zone_shrink=10)
FORM = preset("fast").form
LAYOUT = ObservationLayout({"own": (3,), "others": (2, 4), "others_mask": (2,)})
SIZES, WIDTH = (3, 2), 8
STEPS, AGENTS = 2 * CHUNK, 5


def policy(chosen: str = "fast", memory: int = WIDTH) -> ActorCritic:
    torch.manual_seed(0)
    scales = np.ones(LAYOUT.own), np.ones(sum(kind.features for kind in LAYOUT.kinds))
    made = ActorCritic(SIZES, layout=LAYOUT, preset=preset(chosen), scales=scales, memory=memory)
    torch.nn.init.normal_(made.actor.last.weight, std=0.5)
    return made


def observed(rng: np.random.Generator, batch: int) -> dict[str, Any]:
    found = {key: rng.normal(size=(batch, *shape)).astype(np.float32) for key, shape in LAYOUT.shapes.items()}
    return found | {"others_mask": (rng.random((batch, 2)) < 0.5).astype(np.float32)}


def config(**changes: Any) -> TrainingConfig:
    given = {"scenario": SHORT, "preset": "fast", "steps": 10**6, "worlds": 4, "rollout": 4 * 32, "memory": WIDTH}
    settings = {"batch_size": 64, "n_epochs": 2}
    return TrainingConfig(**(given | {"settings": settings, "seed": 3, "threads": 1} | changes))


def saved(path: Path, **changes: Any) -> Path:
    made = config(**changes)
    trainer = Trainer(made)
    for own in trainer.policies:
        torch.nn.init.normal_(own.actor.last.weight, std=0.3)
    checkpoint.write_checkpoint(path, capture(trainer, made.header()))
    return path


@pytest.mark.parametrize("chosen", [name for name in PRESETS if not PRESETS[name].egocentric])  # has no fields here
def test_steps_one_by_one_are_the_steps_of_a_chunk(chosen: str) -> None:
    own, rng = policy(chosen), np.random.default_rng(1)
    packer = Packer(LAYOUT, Form(own.preset.leaky, False))
    steps = [packer(observed(rng, AGENTS)) for _ in range(STEPS)]
    begins = torch.from_numpy(rng.random((STEPS, AGENTS)) < 0.1)
    start = torch.from_numpy(rng.normal(size=(AGENTS, WIDTH)).astype(np.float32))
    with torch.no_grad():
        logs, values, last = own(concatenated(steps), start, begins)
        memory, apart = start, []
        for seen, where in zip(steps, begins, strict=True):
            alone, kept = own.logs(seen, memory, where)
            found, value, memory = own(seen, memory, where)
            assert torch.allclose(alone, found, atol=1e-6)
            assert torch.equal(kept, memory)
            apart.append((found, value))
    assert torch.allclose(logs, torch.cat([found for found, _ in apart], 2), atol=1e-6)
    assert torch.allclose(values, torch.cat([value for _, value in apart]), atol=1e-6)
    assert torch.allclose(last, memory, atol=1e-6)
    new = torch.ones(AGENTS, dtype=torch.bool)
    begun, zero = own.logs(seen, start, new), own.logs(seen, torch.zeros_like(start), ~new)
    assert all(map(torch.equal, begun, zero))
    with pytest.raises(ValueError, match="needs `memory`"):
        own(seen)


def rollout(own: ActorCritic, rng: np.random.Generator, agents: int = 32) -> Rollout:
    """The first number is shown in the first step of a chunk only; the first action of the last one is to say it."""
    cue, numbers = rng.integers(0, 2, agents), np.zeros((CHUNK, agents, 3), np.float32)
    numbers[0, :, 0] = 2 * cue - 1
    count = torch.zeros(CHUNK * agents, dtype=torch.int64)
    seen = Rows(torch.from_numpy(numbers.reshape(-1, 3)), torch.zeros(0, LAYOUT.columns), count)
    begins = np.zeros((CHUNK, agents), bool)
    begins[0] = True
    memory = rng.normal(size=(1, agents, WIDTH)).astype(np.float32)  # which means nothing
    with torch.no_grad():
        logs, _, _ = own(seen, torch.from_numpy(memory[0]), torch.from_numpy(begins))
        actions = own.choose(logs, torch.from_numpy(rng.random((logs.shape[2], logs.shape[1]), np.float32)))
        found = own.choices.of(actions, logs).view(CHUNK, agents).numpy()
    joint, zeros = actions.view(CHUNK, agents, -1).numpy(), np.zeros((CHUNK, agents), np.float32)
    rewards, learner = zeros.copy(), np.full((CHUNK, agents), NOBODY, np.int8)
    rewards[-1] = joint[-1, :, 0] == cue
    learner[-1] = 0
    given = {"own": numbers, "actions": joint, "log_probs": found, "values": zeros, "advantages": rewards}
    unused = {"rewards": rewards, "later": zeros, "ends": zeros > 0, "last": zeros[0], "idle": None}
    return Rollout({FORM: seen}, **given, **unused, learner=learner, alive=zeros > -1, begins=begins, memory=memory)


@pytest.mark.parametrize(("memory", "learned"), [(WIDTH, True), (0, False)])
@pytest.mark.by_day(1)
def test_what_only_a_memory_can_know_is_learned(memory: int, learned: bool) -> None:
    own, rng = policy(memory=memory), np.random.default_rng(0)
    torch.nn.init.normal_(own.actor.last.weight, std=0.01)
    numbers = Hyperparameters(batch_size=16, n_epochs=2, learning_rate=1e-2, target_kl=0.0)
    learner, share = Learner(own, numbers, torch.Generator().manual_seed(0)), list[float]()
    for _ in range(120 if learned else 40):
        made = rollout(own, rng)
        learner.update(made)
        share.append(float(made.advantages[-1].mean()))
    assert (np.mean(share[-20:]) > 0.9) == learned
    assert np.mean(share[:5]) < 0.5


@pytest.mark.parametrize("dead", ["keep", "drop"])
def test_learners_are_trained_on_what_agents_remembered(dead: str) -> None:
    """Until it is updated, the policy says of chunks what it said when it played: across ends, and with opponents."""
    trainer = Trainer(config(opponents={"self": 1.0, "past": 1.0, "scripted": 1.0}, snapshots=1, dead=dead))
    trainer.update(trainer.collect())
    trainer.collect()
    made, own = trainer.collect(), trainer.policies[0]
    samples = Samples(made, 0, own, torch.device("cpu"))
    batch = samples.select(samples.units)
    with torch.no_grad():
        logs, values, _ = own(batch.seen, batch.memory, batch.begins)
    mine = batch.weights > 0
    assert mine.sum() == (made.learner == 0).sum() < made.learner.size
    assert torch.allclose(own.choices.of(batch.actions, logs, batch.free)[mine], batch.old_log_probs[mine], atol=1e-5)
    assert torch.allclose(normalised(batch.returns - values, batch.weights)[mine], batch.advantages[mine], atol=1e-4)
    assert batch.weights.sum() == pytest.approx(1)
    assert made.begins[1:].any()
    assert (made.memory != 0).any(2).mean() > 0.9


def test_rollouts_that_are_no_whole_chunks_are_refused() -> None:
    with pytest.raises(TrainingError, match=r"100 steps has 25 of .* multiple of 16, such as --rollout 128$"):
        config(rollout=100)
    config(rollout=100, memory=0)


@pytest.mark.nightly
def test_a_start_by_imitation_and_one_with_saved_weights(tmp_path: Path) -> None:
    path, each = str(saved(tmp_path / "a.zip")), 4 * 32 * 2
    for teacher, memory in (("scripted", WIDTH), (path, 0), (path, 2 * WIDTH)):
        trainer, differs = Trainer(config(memory=memory, warm_start=f"{teacher}:{20 * each}")), []
        trainer.imitate(lambda done, tags, differs=differs: differs.append(tags["imitation/differs"]))
        assert differs[-1] < 0.9 * differs[0]
    trainer = Trainer(config(warm_start=path))
    trainer.take_weights()
    own, other = trainer.policies[0].state_dict(), load_policy(path).policies[0].state_dict()
    assert all(torch.equal(own[name], other[name]) for name in own)
    for changes in ({"memory": 0}, {"critic": "state"}):
        with pytest.raises(TrainingError, match="of preset 'fast' with memory 8 and state 0, but those to be trained"):
            Trainer(config(warm_start=path, **changes)).take_weights()


@pytest.mark.parametrize("policies", ["shared", "side"])
def test_a_world_is_played_the_same_alone_and_in_a_batch(tmp_path: Path, policies: str) -> None:
    path, played = saved(tmp_path / "a.zip", policies=policies), []
    for env in (make_vec(SHORT, 3, seed=1), make_vec(SHORT, 1, seed=1, first_world=2)):
        act, found = told(load_policy(path, seed=None), env), []
        observations, _ = env.reset()
        for _ in range(60):
            actions = act(observations)
            observations, *_ = env.step(actions)
            found.append(actions[-1])
        played.append(np.array(found))
    assert np.array_equal(*played)
    assert len(np.unique(played[0].reshape(60, -1), axis=0)) > 1


def test_play_is_that_of_the_policy_and_forgets_where_an_episode_begins(tmp_path: Path) -> None:
    player, rng = load_policy(saved(tmp_path / "a.zip"), seed=None), np.random.default_rng(0)
    env = make_vec(SHORT, 2, seed=1)
    observations, _ = env.reset()
    player.reset(np.ones(2, bool))
    own, memory = player.policies[0], torch.zeros(4, WIDTH)
    for begins in ([True, True], [False, False], [False, True], [False, False]):
        if True in begins:
            player.reset(np.array(begins))
        seen, where = player.packers[own.preset.form](observations), torch.tensor(begins).repeat_interleave(2)
        with torch.no_grad():
            logs, memory = own.logs(seen, memory, where)
        actions = player(observations)
        assert np.array_equal(actions.reshape(4, -1), logs.argmax(0).T.numpy())
        observations, *_ = env.step(rng.integers(0, env.action_sizes, actions.shape))


def test_a_player_must_know_where_episodes_begin(tmp_path: Path) -> None:
    player, observations = load_policy(saved(tmp_path / "a.zip")), make_vec(SHORT, 3, seed=1).reset()[0]

    def refused(call: Any, words: str) -> None:
        with pytest.raises(TrainingError, match=words):
            call()

    refused(lambda: player(observations), r"memory of None worlds, but observes \(3,\): tell it where .*reset")
    refused(lambda: player.reset(np.array([True, False, True])), "tell it of all worlds first")
    player.reset(np.ones(2, bool))
    refused(lambda: player(observations), r"memory of \(2,\) worlds, but observes \(3,\)")
    player.reset(np.ones(3, bool))
    player(observations)
    fewer = {key: values[:, :1] for key, values in observations.items()}
    refused(lambda: player(fewer), "memory of 6 agents, but observes 3")
    assert load_policy(saved(tmp_path / "b.zip", memory=0)).reset is None


def test_it_plays_as_an_opponent(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.zip")
    env: Any = gymnasium.make_vec("outlast/FreeForAll2-v1", 4, scenario=SHORT, others=f"{path},scripted")
    env.reset(seed=0)
    for _ in range(40):
        env.step(env.action_space.sample())
    for memory in (0, 2 * WIDTH):  # that of the learner, narrower and wider than the opponent's
        trainer = Trainer(config(memory=memory, opponents={"self": 1.0, str(path): 1.0}))
        for _ in range(2):
            trainer.update(trainer.collect())
        assert trainer.lane.memory.shape[1] == max(memory, WIDTH)
        assert (trainer.lane.opponent > 0).any()


WORLDS, TICKS, MEMBERS = 3, 32, 4
TEAMS = variant("teams_2").replace(ending_limit=20)


def stated(chosen: str = "fast", **changes: Any) -> Trainer:
    given = {"worlds": WORLDS, "rollout": WORLDS * TICKS, "critic": "state"}
    given |= {"settings": {"n_epochs": 1, "batch_size": 64, "target_kl": 0.0}}
    return Trainer(TrainingConfig(TEAMS, chosen, **(given | changes)))


def seen_by(trainer: Trainer) -> Observed:
    trainer.env.observe()
    return trainer.lane.observe()[trainer.preset.form]


def test_agents_of_a_world_get_the_same_state() -> None:
    trainer = stated()
    (seen,) = trainer.collect().seen.values()
    states = seen.state.view(TICKS, WORLDS, MEMBERS, trainer.state)
    assert (states == states[:, :, :1]).all()
    assert (states[:, 0] != states[:, 1]).any()
    assert (states[0] != states[-1]).any()


@pytest.mark.parametrize(("chosen", "memory"), [("fast", 0), ("fast", 8), ("original", 0), ("paper", 8)])
def test_values_depend_on_what_an_agent_cannot_see_and_actions_do_not(chosen: str, memory: int) -> None:
    trainer, agents = stated(chosen, memory=memory), WORLDS * MEMBERS
    given = (torch.zeros(agents, memory), torch.ones(agents, dtype=torch.bool)) if memory else ()
    policy, found = trainer.policies[0], []
    for moved in (0.0, 1.0):
        trainer.env.worlds[Body].x[1, trainer.env.worlds.span("heal").start] += moved  # what is seen_by stays
        with torch.no_grad():
            found.append((*policy(seen_by(trainer), *given)[:2], policy.logs(seen_by(trainer), *given)[0]))
    (logs, values, alone), (other_logs, other_values, other_alone) = found
    assert torch.equal(logs, other_logs)
    assert torch.equal(alone, other_alone)
    assert torch.allclose(alone, logs, atol=1e-6)
    differ = (values != other_values).view(WORLDS, MEMBERS)
    assert differ[1].all()
    assert not differ[[0, 2]].any()


def test_a_policy_is_saved_goes_on_and_plays_without_the_state(tmp_path: Path) -> None:
    trainer, path = stated(), tmp_path / "a.zip"
    before = trainer.policies[0].overview.weight.clone()
    trainer.update(trainer.collect())
    assert not torch.equal(trainer.policies[0].overview.weight, before)
    checkpoint.write_checkpoint(path, capture(trainer, trainer.config.header()))
    env = make_vec("teams_2", 2, seed=0)
    act, (observations, _) = told(load_policy(path), env), env.reset()
    assert act(observations).shape == (2, MEMBERS, 6)
    opposed = stated(opponents={str(path): 1.0, "past": 1.0}, snapshots=1)
    for _ in range(3):
        opposed.update(opposed.collect())
    drawn = [opposed.opponents.all[k] for k in opposed.lane.opponent]
    assert {"past" if each.past else each.name for each in drawn} == {str(path), "past"}
    stated(opponents={str(path): 1.0}, critic="own").collect()

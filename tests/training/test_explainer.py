"""What a policy says of itself: probabilities, values and attention, on its own and in recordings."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast import Recording, Replay, make_vec, record, variant
from outlast.envs.rollout.memory import told
from tests.conftest import run

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast import load_policy  # noqa: E402
from outlast.training.base.config import TrainingConfig  # noqa: E402
from outlast.training.base.presets import PRESETS  # noqa: E402
from outlast.training.policies import checkpoint  # noqa: E402
from outlast.training.policies.networks import Extractor  # noqa: E402
from outlast.training.ppo.trainer import Trainer  # noqa: E402
from outlast.training.runs.resume import capture  # noqa: E402
from tests.helpers.execution_modes import short  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")
Array = np.ndarray[Any, Any]
ACTIONS = (3, 3, 3, 2, 2, 2)


def saved(path: Path, preset: str = "original", **options: Any) -> Path:
    """A policy that is not nearly uniform, as a checkpoint."""
    config = TrainingConfig(short("ffa_2"), preset, worlds=4, rollout=4 * 32, seed=3, threads=1, **options)
    trainer = Trainer(config)
    for own in trainer.policies:
        torch.nn.init.normal_(own.actor.last.weight, std=0.3)
        for extractor in own.extractors:
            torch.nn.init.normal_(extractor.attention.in_proj_weight, std=0.5)
    checkpoint.write_checkpoint(path, capture(trainer, config.header()))
    return path


def played(path: Path, steps: int = 30) -> tuple[Any, dict[str, Array]]:
    """The likeliest player, and what agents observe after so many random steps, of which they see something."""
    player = load_policy(path, seed=None)
    env = make_vec(player.scenario(variant("ffa_2")), 4, seed=0)
    observations, _ = env.reset()
    for k in range(steps):
        observations, *_ = env.step(np.random.default_rng(k).integers(0, ACTIONS, (4, 2, 6)))
    return player, observations


@pytest.mark.parametrize("preset", PRESETS)
def test_probabilities_and_values_are_those_of_the_networks(tmp_path: Path, preset: str) -> None:
    player, observations = played(saved(tmp_path / "a.zip", preset))
    value, likely, attention = player.explainer()(observations)
    with torch.no_grad():
        logs, values, _ = player.policies[0](player.packer(observations))
    np.testing.assert_allclose(value, values.numpy().reshape(4, 2), rtol=1e-5)
    each = np.split(likely, np.cumsum(ACTIONS)[:-1], -1)
    for k, shares in enumerate(each):
        np.testing.assert_allclose(shares.sum(-1), 1, rtol=1e-5)
        np.testing.assert_allclose(shares.reshape(8, -1), logs[: ACTIONS[k], k].exp().T.numpy(), rtol=1e-4)
    assert np.array_equal(np.stack([shares.argmax(-1) for shares in each], -1), player(observations))
    assert attention.shape == (4, 2, sum(rows for _, rows in player.explainer().entities))
    assert (attention >= 0).all()
    assert (attention.sum(-1) <= 1 + 1e-5).all()
    assert attention.max() > 0.1


@pytest.mark.parametrize("preset", [name for name in PRESETS if not PRESETS[name].egocentric])
def test_attention_is_that_of_naive_attention(tmp_path: Path, preset: str) -> None:
    player, observations = played(saved(tmp_path / "a.zip", preset))
    attention = player.explainer()(observations)[2]
    for w in range(4):
        for i in range(2):
            mine = {key: array[w, i] for key, array in observations.items()}
            np.testing.assert_allclose(attention[w, i], naive(player, mine), atol=2e-5)


def naive(player: Any, mine: dict[str, Array]) -> Array:
    """The attention of one agent, row by row, head by head, in float64."""
    own: Extractor = player.policies[0].extractors[0]
    leaky, heads = player.preset.leaky, player.preset.heads
    weights = torch.split(own.weight * own.scale, [kind.features for kind in own.layout.kinds])
    rows, visible = [], []
    for kind, weight, bias in zip(own.layout.kinds, weights, own.bias, strict=True):
        made = mine[kind.key].astype(float) @ weight.detach().numpy() + bias.detach().numpy()
        rows += [*(np.tanh(made) if player.preset.activation == "tanh" else np.maximum(made, 0))]
        visible += [*(mine[f"{kind.key}_mask"] > 0)]
    if leaky:
        rows, visible = [*rows, np.zeros_like(rows[0])], [*visible, True]
    matrix, shift = (each.detach().numpy() for each in (own.attention.in_proj_weight, own.attention.in_proj_bias))
    queries, keys, _ = (np.split(np.array(rows) @ matrix.T + shift, 3, 1)[k] for k in range(3))
    shares = np.zeros(len(rows))
    for query in np.flatnonzero(visible):
        for q, k in zip(np.split(queries, heads, 1), np.split(keys, heads, 1), strict=True):
            logits = k @ q[query] / np.sqrt(q.shape[1]) + (~np.array(visible) if leaky else 0)
            power = np.exp(logits) * (True if leaky else np.array(visible))
            shares += power / power.sum() / heads / sum(visible)
    return shares[: sum(kind.rows for kind in own.layout.kinds)]


@pytest.mark.parametrize("policies", ["shared", "side"])
def test_it_has_a_memory_of_its_own(tmp_path: Path, policies: str) -> None:
    """Explained in between or not, a player does the same; and what it does is what was likeliest."""
    path = saved(tmp_path / "a.zip", "fast", memory=8, policies=policies)
    env, one, other = make_vec(short("ffa_2"), 3, seed=1), load_policy(path, None), load_policy(path, None)
    acts, explain = (told(one, env), told(other, env)), told(one.explainer(), env)
    observations, _ = env.reset()
    for _ in range(40):
        likely = explain(observations)[1]
        actions = acts[0](observations)
        assert np.array_equal(actions, acts[1](observations))
        best = [shares.argmax(-1) for shares in np.split(likely, np.cumsum(ACTIONS)[:-1], -1)]
        assert np.array_equal(np.stack(best, -1), actions)
        observations, *_ = env.step(actions)


def test_a_critic_of_the_state_says_no_value(tmp_path: Path) -> None:
    player, observations = played(saved(tmp_path / "a.zip", "fast", critic="state"))
    value, likely, _ = player.explainer()(observations)
    assert np.isnan(value).all()
    assert np.isfinite(likely).all()


def test_rollouts_record_it(tmp_path: Path, capsys: Any) -> None:
    """As the policy thought in the same rollout without a recording, and only of the agents that it plays."""
    path, names = saved(tmp_path / "a.zip"), ("--worlds=3", "--steps=50", "--seed=2", "--quiet")
    options = ("--policy", path, "--record-policy", *names)
    assert run(capsys, "rollout", "ffa_2", *options, "--record", tmp_path / "a.rec")[0] == 0
    replay, player = Replay(Recording.open(tmp_path / "a.rec")), load_policy(path, 2)
    env, explain = make_vec(player.scenario(variant("ffa_2")), 3, seed=2), player.explainer()
    observations, _ = env.reset()
    for tick in replay.ticks():
        if tick:
            value, likely, attention = explain(observations)
            assert replay.policy is not None
            np.testing.assert_array_equal(replay.policy["value"], value)
            np.testing.assert_array_equal(replay.policy["probabilities"], likely.astype(np.float16))
            np.testing.assert_array_equal(replay.policy["attention"], attention.astype(np.float16))
            observations, *_ = env.step(player(observations))
    others = ("--others", "scripted", "--record", tmp_path / "b.rec")
    assert run(capsys, "rollout", "ffa_2", *options, *others)[0] == 0
    replay = Replay(Recording.open(tmp_path / "b.rec"))
    for _ in replay.ticks(last=20):
        pass
    assert replay.policy is not None
    assert np.isnan(replay.policy["probabilities"]).all(-1).sum(1).tolist() == [1, 1, 1]


def test_a_policy_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    player, env = load_policy(saved(tmp_path / "a.zip")), make_vec("teams_4", 1, seed=0)
    with pytest.raises(ValueError, match="the policy was trained on ffa_2 and does not fit here"):
        record(env, tmp_path / "a.rec", policy=player)
    assert not (tmp_path / "a.rec").exists()

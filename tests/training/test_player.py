"""Trained policies as functions and as opponents; their files; and what they say of their own choices."""

import contextlib
import json
import math
import signal
from concurrent.futures import ThreadPoolExecutor
from copy import deepcopy
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from safetensors.numpy import save

from outlast import Recording, Replay, load_policy, make_vec, record, variant
from outlast.envs.rollout.memory import told
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.training.base import policy_file
from outlast.training.base.config import TrainingConfig, parse_warm_start
from outlast.training.base.errors import TrainingError
from outlast.training.base.policy_file import RUN_JSON
from outlast.training.base.presets import PRESETS, preset
from outlast.training.policies import checkpoint
from outlast.training.policies.player import EpisodeNoise, Player
from outlast.training.ppo.trainer import Trainer, capture, restore
from outlast.training.runs.film import recorded_scenario
from tests.conftest import run
from tests.helpers.added_fields import Stamina
from tests.helpers.checkpoints import KEPT
from tests.helpers.execution_modes import short
from tests.training.test_networks import embedded


def saved(path: Path, chosen: str = "original") -> Trainer:
    """A trainer with a policy that is not nearly uniform, as a checkpoint."""
    trainer = Trainer(TrainingConfig(variant("teams_3"), chosen, worlds=4, rollout=256))
    generator = torch.Generator().manual_seed(0)  # of its own, so that the order of tests does not matter
    torch.nn.init.normal_(trainer.policies[0].actor.last.weight, std=0.02, generator=generator)
    checkpoint.write_checkpoint(path, capture(trainer, {}))
    return trainer


def test_files_play_in_mixtures(tmp_path: Path) -> None:
    """By path in a text or mapping; and as (seed, world, episode, tick, agent) say, so that a seed is an episode."""
    for name in ("a.zip", "b.zip"):
        saved(tmp_path / name)
    text = f"{tmp_path}/a.zip:1,scripted:1,{tmp_path}/b.zip:2"
    mapping = {tmp_path / "a.zip": 1, "scripted": 1, tmp_path / "b.zip": 2}
    game: dict[str, Any] = {"scenario": "teams_3", "cameras_mode": "revealed"}

    def played(env: Any, **options: Any) -> Any:
        env.reset(**options)
        return go_on(env)

    def go_on(env: Any) -> Any:
        """Return what all agents observe: the learner sees little of its opponents, which act by chance."""
        return np.array([(env.step(np.ones((8, 6), int)), env.base_env.observe()["own"])[1].copy() for _ in range(5)])

    one, other = (gymnasium.make_vec("outlast/Teams-v1", 8, others=others, **game) for others in (text, mapping))
    first = played(one, seed=0)
    assert np.array_equal(played(other, seed=0), first)
    following, state = go_on(one), other.get_state()  # type: ignore[attr-defined]
    assert not np.array_equal(following, first)
    played(other)
    other.set_state(state)  # type: ignore[attr-defined]
    assert np.array_equal(go_on(other), following)
    assert np.array_equal(played(one, seed=0), first)
    assert not np.array_equal(played(one, seed=8), first)
    lone: Any = gymnasium.make("outlast/Teams-v1", others=text, **game)
    lone.reset(seed=0)
    for expected in first:
        lone.step(np.ones(6, int))
        np.testing.assert_allclose(lone.unwrapped.base_env.observe()["own"][0], expected[0], atol=1e-6)


def test_chances_are_those_of_the_policy() -> None:
    env = make_vec("teams_3", 256, seed=0)
    env.reset()
    noise, drawn = EpisodeNoise(env, [1, 3]), []
    for _ in range(40):
        drawn.append(noise().reshape(256, 2, 6) - 0.5)
        env.step(np.ones((256, 4, 6), int))
    numbers = np.stack(drawn).astype(float)  # (ticks, worlds, agents, actions)
    assert -0.5 <= numbers.min() < numbers.max() < 0.5
    assert abs(numbers.mean()) < 4 * math.sqrt(1 / 12 / numbers.size)
    assert abs(numbers.var() - 1 / 12) < 4 * math.sqrt(1 / 180 / numbers.size)
    for axis in range(4):
        one, two = np.split(np.moveaxis(numbers, axis, 0)[: numbers.shape[axis] // 2 * 2], 2)
        assert abs((one * two).mean()) < 4 / 12 / math.sqrt(one.size)


def test_a_player_takes_one_thread_and_leaves_the_others_alone(tmp_path: Path) -> None:
    """Those are for the networks of its opponents, also where something goes wrong."""
    saved(tmp_path / "a.zip")
    observations, _ = make_vec(preset("original").scenario(variant("teams_3")), 3, seed=0).reset()
    torch.set_num_threads(3)  # put back by the fixture
    players, found = [Player(tmp_path / "a.zip") for _ in range(4)], []
    for player in players:
        player.policies[0].extractors[0].register_forward_hook(lambda *_: found.append(torch.get_num_threads()))
    with ThreadPoolExecutor(4) as pool:  # for each of its threads, PyTorch begins with the number as it then is
        for _ in range(5):
            list(pool.map(lambda player: player(observations), players))
        assert set(pool.map(lambda _: torch.get_num_threads(), range(8))) == {3}
    assert found == [1] * 20
    players[0].policies[0].extractors[0].register_forward_hook(lambda *_: signal.raise_signal(signal.SIGINT))
    with pytest.raises(KeyboardInterrupt):
        players[0](observations)
    assert torch.get_num_threads() == 3


@pytest.mark.parametrize("path", sorted(KEPT.rglob("*.safetensors")), ids=lambda path: str(path.relative_to(KEPT)))
@pytest.mark.by_day(8)
def test_every_kept_policy_plays(path: Path) -> None:
    with pytest.raises(ValueError, match="seed = 'likeliest': an integer >= 0 is needed"):
        load_policy(path, seed="likeliest")  # type: ignore[arg-type]
    player = load_policy(path, seed=None)
    game, differs = recorded_scenario(player.header)
    assert differs == ""
    with contextlib.closing(make_vec(game, 4, seed=0)) as env:
        player.check(env)
        actions = player(env.reset()[0])
    assert actions.shape == (4, env.num_agents, len(env.action_sizes))
    assert len(np.unique(actions[..., :3])) > 1


def test_scales_are_those_of_the_file(tmp_path: Path) -> None:
    trainer = saved(tmp_path / "a.zip", "scaled")
    files = checkpoint.read_checkpoint(tmp_path / "a.zip")
    header = json.loads(files[RUN_JSON])
    scale = trainer.policies[0].extractors[0].own_scale.clone()
    where = list(header["fields"]["own"]).index("health")
    assert scale[where] == np.float32(1 / 100)
    header["fields"]["own"]["health"][1] = 50.0
    scale[where] = 1 / 50
    files |= {RUN_JSON: json.dumps(header).encode()}
    checkpoint.write_checkpoint(tmp_path / "b.zip", files)
    assert torch.equal(Player(tmp_path / "b.zip").policies[0].extractors[0].own_scale, scale)
    restore(trainer, files)
    assert all(torch.equal(extractor.own_scale, scale) for extractor in trainer.policies[0].extractors)


def test_what_does_not_fit_is_a_sentence(tmp_path: Path) -> None:
    """But "masked" policies, which ignore the rows of hidden entities, play where they are revealed."""
    saved(tmp_path / "a.zip")
    saved(tmp_path / "b.zip", "paper")
    player = Player(tmp_path / "a.zip")
    for here, words in (
        (variant("teams_2"), "it needs box_items, box_slot, boxes; give"),
        (variant("teams_3").replace(n_heals=5), "heals is 15 x 2 in training but 5 x 2 here; give"),
        (variant("ffa_1"), "it needs box_items, box_slot, boxes; others is 3 x "),
    ):
        with pytest.raises(TrainingError, match=f"a.zip: .* was trained on teams_3 and does not fit here: {words}"):
            player.check(make_vec(player.scenario(here), 1))
    for others in (str(tmp_path / "a.zip"), player, {"noop": 1, tmp_path / "a.zip": 1}):
        with pytest.raises(TrainingError, match=r"'revealed', here it is 'masked'; make .* with cameras_mode='reveale"):
            gymnasium.make("outlast/Teams-v1", scenario="teams_3", others=others)
    both = f"{tmp_path}/a.zip,{tmp_path}/b.zip"
    gymnasium.make("outlast/Teams-v1", scenario="teams_3", cameras_mode="revealed", others=both)
    with pytest.raises(TrainingError, match="'masked', here it is 'omniscient'"):
        gymnasium.make("outlast/Teams-v1", scenario="teams_3", cameras_mode="omniscient", others=tmp_path / "b.zip")
    # rows of the same length, but of other numbers
    trainer = Trainer(TrainingConfig(variant("ffa_1").replace(n_agents=4).with_(Stamina()), worlds=4, rollout=256))
    checkpoint.write_checkpoint(tmp_path / "a.zip", capture(trainer, {}))
    player, team = Player(tmp_path / "a.zip"), preset("original").scenario(variant("teams_1").without("boxes"))
    player.check(trainer.env)
    with pytest.raises(TrainingError, match=r"a\.zip: .* rows 'own' of id, health, .*stamina; here they are id, team"):
        player.check(make_vec(team, 1))


HEADER: dict[str, Any] = {"version": 1, "steps": 3, "preset": "fast", "memory": 0, "state": 0, "team": [0, 0]}
HEADER |= {"observations": {"own": [8]}, "fields": {"own": {"id": [1, 1.0]}}, "actions": [3, 2]}
HEADER |= {"scenario": fingerprint(variant("ffa_2"))}


def test_what_is_written_is_read(tmp_path: Path) -> None:
    """In order of the policies, of which there are more than ten, and to the bit where float16 holds the numbers."""
    exact = [{"a.weight": np.full((2, 3), k / 8, np.float32), "a.bias": np.float32([k])} for k in range(12)]
    exact[3]["a.weight"] = np.random.default_rng(0).normal(size=(2, 3)).astype(np.float32)
    places = [tmp_path / "a.safetensors", tmp_path / "b.safetensors"]
    for place in places:
        policy_file.write(place, HEADER, exact)
    assert places[0].read_bytes() == places[1].read_bytes()
    header, found = policy_file.read(places[0])
    assert header == HEADER
    assert [{name: values.dtype for name, values in own.items()} for own in found] == [
        {"a.weight": np.float32, "a.bias": np.float32}
    ] * 12
    assert not np.array_equal(found[3]["a.weight"], exact[3]["a.weight"])
    np.testing.assert_allclose(found[3].pop("a.weight"), exact[3].pop("a.weight"), atol=2**-10)
    np.testing.assert_equal(found, exact)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is not a policy"),
        (save({"0.a": np.zeros(2, np.float16)}), "does not describe a run"),
        (save({"0.a": np.zeros(2, np.float16)}, {"outlast": "{}"}), "its .*preset.* is missing"),
        (None, r"its tensors are not called 0\.NAME, 1\.NAME"),
    ],
)
def test_other_files_are_refused(content: bytes, message: str, tmp_path: Path) -> None:
    place = tmp_path / "a.safetensors"
    place.write_bytes(content) if content is not None else policy_file.write(place, HEADER, [])
    with pytest.raises(TrainingError, match=message):
        policy_file.read(place)


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
    checkpoint.write_checkpoint(found["zip"], capture(trainer, trainer.config.header()))
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
    for name in ("whole", "acting"):  # with a critic, both are computed together, which rounds otherwise
        for one, other in zip(explained[name][1:], explained["zip"][1:], strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-6, err_msg=name)
    assert [player.critic for player in players.values()] == [True, False, True]
    assert all(player.header == players["zip"].header for player in players.values())


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
    nans = np.full(own["actor.last.bias"].shape, np.nan)
    cases: list[tuple[dict[str, Any], dict[str, Any], str]] = [
        ({}, {name: own[name] for name in list(own)[1:]}, "does not hold the weights"),
        ({}, own | {"critic.last.bias": np.zeros(1, np.float32)}, "does not hold the weights"),
        ({}, own | {"actor.last.bias": nans}, "are NaN or beyond 1000"),
        ({"actions": [60_000]}, own, "too small for the observations"),
        ({"actions": [3, 3]}, own, "actor.last.weight"),
        ({"memory": 9}, own, "does not hold the weights"),
        ({"memory": 4096}, own, "too small for"),
    ]
    for changes, weights, words in cases:
        policy_file.write(tmp_path / "b.safetensors", header | changes, [weights])
        with pytest.raises(TrainingError, match=rf"b\.safetensors is broken: .*{words}"):
            load_policy(tmp_path / "b.safetensors")


Array = np.ndarray[Any, Any]
ACTIONS = (3, 3, 3, 2, 2, 2)


def explained_policy(path: Path, preset: str = "original", **options: Any) -> Path:
    """A policy that is not nearly uniform, as a checkpoint."""
    trainer = Trainer(TrainingConfig(short("ffa_2"), preset, worlds=4, rollout=4 * 32, seed=3, threads=1, **options))
    for own in trainer.policies:
        torch.nn.init.normal_(own.actor.last.weight, std=0.3)
        for extractor in own.extractors:
            torch.nn.init.normal_(extractor.attention.in_proj_weight, std=0.5)
    checkpoint.write_checkpoint(path, capture(trainer, trainer.config.header()))
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
    player, observations = played(explained_policy(tmp_path / "a.zip", preset))
    value, likely, attention = player.explainer()(observations)
    with torch.no_grad():
        logs, values, _ = player.policies[0](player.packers[player.preset.form](observations))
    np.testing.assert_allclose(value, values.numpy().reshape(4, 2), rtol=1e-5)
    each = np.split(likely, np.cumsum(ACTIONS)[:-1], -1)
    for k, shares in enumerate(each):
        np.testing.assert_allclose(shares.sum(-1), 1, rtol=1e-5)
        np.testing.assert_allclose(shares.reshape(8, -1), logs[: ACTIONS[k], k].exp().T.numpy(), rtol=1e-4)
    assert np.array_equal(np.stack([shares.argmax(-1) for shares in each], -1), player(observations))
    assert attention.shape == (4, 2, sum(rows for _, rows in player.explainer().entities))
    assert attention.min() >= 0
    assert 0.1 < attention.max() <= attention.sum(-1).max() <= 1 + 1e-5


@pytest.mark.parametrize("preset", [name for name in PRESETS if not PRESETS[name].egocentric])
def test_attention_is_that_of_naive_attention(tmp_path: Path, preset: str) -> None:
    player, observations = played(explained_policy(tmp_path / "a.zip", preset))
    flat = {key: array.reshape(8, *array.shape[2:]) for key, array in observations.items()}
    attention = player.explainer()(observations)[2].reshape(8, -1)
    np.testing.assert_allclose(attention, naive_attention(player, flat).detach(), atol=2e-5)


def naive_attention(player: Any, observations: dict[str, Array]) -> torch.Tensor:
    own, leaky = deepcopy(player.policies[0].extractors[0]).double(), player.preset.leaky
    rows, visible = embedded(own, own.layout, observations, torch.tanh if leaky else torch.relu)
    if leaky:
        rows, visible = torch.nn.functional.pad(rows, (0, 0, 0, 1)), torch.nn.functional.pad(visible, (0, 1), value=1)
    _, shares = own.attention(rows, rows, rows, key_padding_mask=1 - visible if leaky else visible == 0)
    mean = (shares.nan_to_num() * visible[..., None]).sum(1) / visible.sum(1, keepdim=True).clamp(min=1)
    return mean[:, : mean.shape[1] - leaky]


@pytest.mark.parametrize("policies", ["shared", "side"])
def test_it_has_a_memory_of_its_own(tmp_path: Path, policies: str) -> None:
    """Explained in between or not, a player does the same; and what it does is what was likeliest."""
    path = explained_policy(tmp_path / "a.zip", "fast", memory=8, policies=policies)
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


def test_rollouts_record_it_of_policies_that_fit(tmp_path: Path, capsys) -> None:
    """As the policy thought in the same rollout without a recording; of others, see test_policy_record.py."""
    path, names = explained_policy(tmp_path / "a.zip"), ("--worlds=3", "--steps=50", "--seed=2", "--quiet")
    options = ("--policy", path, "--record-policy", *names)
    assert run(capsys, "rollout", "ffa_2", *options, "--record", tmp_path / "a.rec")[0] == 0
    replay, player = Replay(Recording.open(tmp_path / "a.rec")), load_policy(path, 2)
    env, explain = make_vec(player.scenario(variant("ffa_2")), 3, seed=2), player.explainer()
    observations, _ = env.reset()
    for tick in replay.ticks():
        if tick:
            found = zip(("value", "probabilities", "attention"), explain(observations), strict=True)
            expected = {key: values.astype(np.float32 if key == "value" else np.float16) for key, values in found}
            np.testing.assert_equal({key: replay.policy[key] for key in expected}, expected)  # type: ignore[index]
            observations, *_ = env.step(player(observations))
    with pytest.raises(ValueError, match="the policy was trained on ffa_2 and does not fit here"):
        record(make_vec("teams_4", 1, seed=0), tmp_path / "c.rec", policy=player)
    assert not (tmp_path / "c.rec").exists()

"""Trained policies as functions, and as opponents."""

import contextlib
import json
import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import outlast
from outlast import make_vec, variant
from outlast.training.base.errors import TrainingError

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast import load_policy  # noqa: E402
from outlast.training.base.config import TrainingConfig  # noqa: E402
from outlast.training.base.noise import EpisodeNoise  # noqa: E402
from outlast.training.base.presets import PRESETS, preset  # noqa: E402
from outlast.training.base.run_header import NAME  # noqa: E402
from outlast.training.policies import checkpoint  # noqa: E402
from outlast.training.policies.player import Player  # noqa: E402
from outlast.training.ppo.trainer import Trainer  # noqa: E402
from outlast.training.runs import resume  # noqa: E402
from outlast.training.runs.episode import recorded_scenario  # noqa: E402
from tests.helpers.added_fields import Stamina  # noqa: E402
from tests.helpers.checkpoints import KEPT  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")


def saved(path: Path, chosen: str = "original") -> Trainer:
    """A trainer with a policy that is not nearly uniform, as a checkpoint."""
    trainer = Trainer(TrainingConfig(variant("teams_3"), chosen, worlds=4, rollout=256))
    generator = torch.Generator().manual_seed(0)  # of its own, so that the order of tests does not matter
    torch.nn.init.normal_(trainer.policies[0].actor.last.weight, std=0.02, generator=generator)
    checkpoint.write_checkpoint(path, resume.capture(trainer, {}))
    return trainer


@pytest.mark.parametrize("chosen", PRESETS)
def test_a_player_has_the_policy_of_the_trainer(tmp_path: Path, chosen: str) -> None:
    trainer = saved(tmp_path / "a.zip", chosen)
    trainer.collect()
    observations = trainer.env.observe()
    with torch.no_grad():
        own = trainer.policies[0]
        expected = own.choose(own.logs(trainer.lane.packer(observations))[0], None).numpy().reshape(4, 4, -1)
    assert np.array_equal(Player(tmp_path / "a.zip", seed=None)(observations), expected)
    one, other = (Player(tmp_path / "a.zip", seed=7) for _ in range(2))
    drawn = [(one(observations), other(observations)) for _ in range(3)]
    assert all(np.array_equal(*pair) for pair in drawn)
    assert any((pair[0] != expected).any() for pair in drawn)


def test_a_player_plays_a_whole_batch_and_an_opponent(tmp_path: Path) -> None:
    saved(tmp_path / "a.zip")
    player = Player(tmp_path / "a.zip")
    scenario = player.scenario(variant("teams_3"))
    assert scenario.numbers()["cameras_mode"] == "revealed"
    env = make_vec(scenario, 3, seed=0)
    observations, _ = env.reset()
    assert player(observations).shape == (3, 4, 6)
    lone: Any = gymnasium.make("outlast/Teams-v1", scenario=scenario, others=player)
    lone.reset(seed=0)
    for _ in range(3):
        _, reward, *_ = lone.step(lone.action_space.sample())
    assert reward == 1
    many = gymnasium.make_vec("outlast/Teams-v1", 3, scenario=scenario, others=load_policy(tmp_path / "a.zip"))
    many.reset(seed=0)
    played = [many.action_space.sample() for _ in range(3)]
    assert len({actions.tobytes() for actions in played}) == 3
    for actions in played:
        _, rewards, *_ = many.step(actions)
    assert rewards.tolist() == [1, 1, 1]


def test_files_play_in_mixtures(tmp_path: Path) -> None:
    """By path in a text or mapping; and as (seed, world, episode, tick, agent) say, so that a seed is an episode."""
    for name in ("a.zip", "b.zip"):
        saved(tmp_path / name)
    text = f"{tmp_path}/a.zip:1,scripted:1,{tmp_path}/b.zip:2"
    mapping = {tmp_path / "a.zip": 1, "scripted": 1, tmp_path / "b.zip": 2}
    idle = np.ones((8, 6), int)

    def played(env: Any) -> Any:
        """Of all agents: opponents act by chance, and the learner sees little of them."""
        return [(env.step(idle), env.base_env.observe()["own"].copy())[1] for _ in range(5)]

    envs = [
        gymnasium.make_vec("outlast/Teams-v1", 8, scenario="teams_3", cameras_mode="revealed", others=others)
        for others in (text, mapping)
    ]
    first = []
    for env in envs:
        env.reset(seed=0)
        first.append(played(env))
    assert np.array_equal(*first)
    following, state = played(envs[0]), envs[1].get_state()
    assert not np.array_equal(following, first[0])
    envs[1].reset()
    played(envs[1])
    envs[1].set_state(state)
    assert np.array_equal(played(envs[1]), following)
    envs[0].reset(seed=0)
    assert np.array_equal(played(envs[0]), first[0])
    envs[0].reset(seed=8)
    assert not np.array_equal(played(envs[0]), first[0])
    lone: Any = gymnasium.make("outlast/Teams-v1", scenario="teams_3", cameras_mode="revealed", others=text)
    for _ in range(2):
        lone.reset(seed=0)
        for expected in first[0]:
            lone.step(idle[0])
            np.testing.assert_allclose(lone.unwrapped.base_env.observe()["own"][0], expected[0], atol=1e-6)


def test_chances_are_those_of_the_policy() -> None:
    """Keyed numbers are uniform and independent: of ticks, agents and actions."""
    env = make_vec("teams_3", 256, seed=0)
    env.reset()
    noise, drawn = EpisodeNoise(env, [1, 3]), []
    for _ in range(40):
        drawn.append(noise().reshape(256, 2, 6).copy())
        env.step(np.ones((256, 4, 6), int))
    numbers = np.stack(drawn).astype(float)  # (ticks, worlds, agents, actions)
    assert 0 <= numbers.min() < numbers.max() < 1
    count = numbers.size
    assert abs(numbers.mean() - 0.5) < 4 * math.sqrt(1 / 12 / count)
    assert abs(numbers.var() - 1 / 12) < 4 * math.sqrt(1 / 180 / count)
    centred = numbers - 0.5
    for one, two in (
        (centred[1:], centred[:-1]), (centred[:, 1:], centred[:, :-1]), (centred[:, :, 0], centred[:, :, 1]),
        (centred[..., 1:], centred[..., :-1]),
    ):  # fmt: skip
        assert abs((one * two).mean()) < 4 / 12 / math.sqrt(one.size)


def test_other_cameras_than_in_training_are_refused(tmp_path: Path) -> None:
    """But "masked" policies, which ignore the rows of hidden entities, play where they are revealed."""
    saved(tmp_path / "a.zip")
    saved(tmp_path / "b.zip", "paper")
    words = r"trained with cameras_mode = 'revealed', here it is 'masked'; make .* with cameras_mode='revealed'"
    for others in (str(tmp_path / "a.zip"), Player(tmp_path / "a.zip"), {"noop": 1, tmp_path / "a.zip": 1}):
        with pytest.raises(TrainingError, match=words):
            gymnasium.make("outlast/Teams-v1", scenario="teams_3", others=others)
    both = f"{tmp_path}/a.zip,{tmp_path}/b.zip"
    gymnasium.make("outlast/Teams-v1", scenario="teams_3", cameras_mode="revealed", others=both)
    with pytest.raises(TrainingError, match="'masked', here it is 'omniscient'"):
        gymnasium.make("outlast/Teams-v1", scenario="teams_3", cameras_mode="omniscient", others=tmp_path / "b.zip")


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
    assert torch.get_num_threads() == 3

    def fail(*_: Any) -> None:
        raise KeyboardInterrupt

    players[0].policies[0].extractors[0].register_forward_hook(fail)
    with pytest.raises(KeyboardInterrupt):
        players[0](observations)
    assert torch.get_num_threads() == 3


@pytest.mark.parametrize("chosen", PRESETS)
def test_an_agent_that_sees_nothing_plays(tmp_path: Path, chosen: str) -> None:
    """Alone in a batch; and batches of none."""
    saved(tmp_path / "a.zip", chosen)
    player = Player(tmp_path / "a.zip")
    for batch in ((1,), (), (0, 4)):
        blind = {key: np.zeros((*batch, *shape), np.float32) for key, shape in player.shapes.items()}
        assert player(blind).shape == (*batch, 6)


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
    """Where a policy plays and where a run goes on, whatever is declared now."""
    trainer = saved(tmp_path / "a.zip", "scaled")
    files = checkpoint.read_checkpoint(tmp_path / "a.zip")
    header = json.loads(files[NAME])
    scale = trainer.policies[0].extractors[0].own_scale.clone()
    where = list(header["fields"]["own"]).index("health")
    assert scale[where] == np.float32(1 / 100)
    header["fields"]["own"]["health"][1] = 50.0
    scale[where] = 1 / 50
    files |= {NAME: json.dumps(header).encode()}
    checkpoint.write_checkpoint(tmp_path / "b.zip", files)
    assert torch.equal(Player(tmp_path / "b.zip").policies[0].extractors[0].own_scale, scale)
    resume.restore(trainer, files)
    assert all(torch.equal(extractor.own_scale, scale) for extractor in trainer.policies[0].extractors)


def test_rows_of_other_fields_are_refused(tmp_path: Path) -> None:
    """As long as those of the policy, but of other numbers."""
    scenario = variant("ffa_1").replace(n_agents=4).with_(Stamina())
    trainer = Trainer(TrainingConfig(scenario, worlds=4, rollout=256))
    checkpoint.write_checkpoint(tmp_path / "a.zip", resume.capture(trainer, {}))
    player, team = Player(tmp_path / "a.zip"), preset("original").scenario(variant("teams_1").without("boxes"))
    player.check(trainer.env)
    with pytest.raises(TrainingError, match=r"a\.zip: .* rows 'own' of id, health, .*stamina; here they are id, team"):
        player.check(make_vec(team, 1))


def test_other_observations_are_refused(tmp_path: Path) -> None:
    saved(tmp_path / "a.zip")
    observations, _ = make_vec("teams_2", 2, seed=0).reset()
    with pytest.raises(
        TrainingError, match=r"a\.zip: .* teams_3 and does not fit here: it needs box_items, box_slot, boxes;"
    ):
        Player(tmp_path / "a.zip")(observations)


@pytest.mark.parametrize(
    ("here", "words"),
    [
        (variant("teams_2"), "it needs box_items, box_slot, boxes; give"),
        (variant("teams_3").replace(n_heals=5), "heals is 15 x 2 in training and 5 x 2 here; give"),
        (variant("ffa_1"), "it needs box_items, box_slot, boxes; others is 3 x "),
    ],
)
def test_what_does_not_fit_is_a_sentence(tmp_path: Path, here: outlast.Scenario, words: str) -> None:
    saved(tmp_path / "a.zip")
    player = Player(tmp_path / "a.zip")
    env = make_vec(player.scenario(here), 1)
    with pytest.raises(TrainingError, match=f"a.zip: the policy was trained on teams_3 and does not fit here: {words}"):
        player.check(env)
    env.close()

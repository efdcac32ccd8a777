"""Stable-Baselines3 with what belongs to it: wrappers, attributes, pictures, and PPO, which learns."""

import csv
import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest

from outlast.envs.errors import ClosedError, NotResetError
from outlast.systems import FineMotors
from tests.adapters.test_sb3 import SHORT, WORLDS, draw, make_sb3, walk
from tests.conftest import COMPILED, scaled
from tests.helpers.execution_modes import COUNTS, equal, short

vec = pytest.importorskip("stable_baselines3.common.vec_env", reason="needs stable_baselines3: outlast[sb3]")
torch = pytest.importorskip("torch", reason="needs torch: outlast[sb3]")

EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "sb3_ppo.py"
pytestmark = pytest.mark.usefixtures("one_torch_thread")


def pair() -> tuple[Any, Any]:
    """Two environments of the same worlds, one to be wrapped."""
    return make_sb3(SHORT, WORLDS, seed=0), make_sb3(SHORT, WORLDS, seed=0)


# ---- wrappers


def test_a_monitor_counts_what_the_statistics_say(tmp_path: Path) -> None:
    kept = ("alive", "kills", "deaths_zone")
    env, rows = vec.VecMonitor(make_sb3(SHORT, WORLDS, seed=0), str(tmp_path / "log"), kept), []
    for _, _, dones, infos in walk(env):
        assert [i for i, info in enumerate(infos) if "episode" in info] == np.flatnonzero(dones).tolist()
        for i in np.flatnonzero(dones):
            episode, statistics = infos[i]["episode"], infos[i]["statistics"]
            assert (episode["r"], episode["l"]) == (statistics["return"], statistics["length"])
            assert [episode[key] for key in kept[1:]] == [statistics[key] for key in kept[1:]]
            rows.append([episode["r"], episode["l"], infos[i]["alive"]])
    env.close()
    with open(tmp_path / "log.monitor.csv") as file:
        next(file)  # a comment
        assert [[float(row["r"]), int(row["l"]), int(row["alive"])] for row in csv.DictReader(file)] == rows
    assert {row[2] for row in rows} == {0, 1}


def test_a_monitor_keeps_statistics_also_of_agents_that_an_episode_does_not_have() -> None:
    """Theirs are 0."""
    env, absent = vec.VecMonitor(make_sb3(short(COUNTS), WORLDS, seed=0), info_keywords=("return", "length")), 0
    for _, _, dones, infos in walk(env):
        for info in [infos[i] for i in np.flatnonzero(dones) if not infos[i]["present"]]:
            assert (info["episode"]["return"], info["episode"]["length"]) == (0, 0)
            assert "statistics" not in info
            absent += 1
    assert absent


def test_normalized_observations_are_the_normalized_ones() -> None:
    """The last ones of an episode, too; those handed in stay as they are."""
    plain, inner = pair()
    env, ends = vec.VecNormalize(inner, clip_obs=3.0, clip_reward=2.0), 0
    for expected, mine in zip(walk(plain), walk(env), strict=True):
        observations, rewards, dones, infos = mine
        assert equal(env.get_original_obs(), expected[0])
        assert np.array_equal(env.get_original_reward(), expected[1])
        assert (rewards.dtype, dones.tolist()) == (np.float32, expected[2].tolist())
        for key, values in observations.items():
            rms = env.obs_rms[key]
            normal = np.clip((expected[0][key] - rms.mean) / np.sqrt(rms.var + env.epsilon), -3, 3)
            assert np.allclose(values, normal, atol=1e-6)
            for i in np.flatnonzero(dones):
                last = expected[3][i]["terminal_observation"][key]
                normal = np.clip((last - rms.mean) / np.sqrt(rms.var + env.epsilon), -3, 3)
                assert np.allclose(infos[i]["terminal_observation"][key], normal, atol=1e-6)
        ends += dones.sum()
    assert ends > 0


def test_stacked_frames_are_the_last_two() -> None:
    """An episode begins with nothing before it, and ends with its own last two."""
    plain, inner = pair()
    env, before, ends = vec.VecFrameStack(inner, 2), make_sb3(SHORT, WORLDS, seed=0).reset(), 0
    for expected, (stacked, _, dones, infos) in zip(walk(plain), walk(env), strict=True):
        for key, values in expected[0].items():
            width = values.shape[-1]
            assert np.array_equal(stacked[key][..., width:], values)
            assert np.array_equal(stacked[key][~dones][..., :width], before[key][~dones])
            assert not stacked[key][dones][..., :width].any()
            for i in np.flatnonzero(dones):
                last = np.concatenate([before[key][i], expected[3][i]["terminal_observation"][key]], -1)
                assert np.array_equal(infos[i]["terminal_observation"][key], last)
        before, ends = expected[0], ends + dones.sum()
    assert ends > 0


def test_other_wrappers_take_it() -> None:
    plain, inner = pair()
    env = vec.VecExtractDictObs(vec.VecCheckNan(inner, raise_exception=True), "own")
    assert env.observation_space.shape == (9,)
    for expected, (observations, _, dones, infos) in zip(walk(plain), walk(env), strict=True):
        assert np.array_equal(observations, expected[0]["own"])
        for i in np.flatnonzero(dones):
            last = expected[3][i]["terminal_observation"]["own"]
            assert np.array_equal(infos[i]["terminal_observation"], last)


# ---- attributes


def test_attributes_are_shared_by_all() -> None:
    env = make_sb3("ffa_1", 3, seed=0, render_mode="rgb_array")
    assert env.get_attr("render_mode") == ["rgb_array"] * 6
    assert env.get_attr("num_agents", 4) == [2]
    assert env.get_attr("metadata", [0, 5]) == [{"name": "ffa_1", "render_modes": ["rgb_array"], "render_fps": 30}] * 2
    assert env.env_is_wrapped(gymnasium.Wrapper, [1, 2]) == [False] * 2
    assert env.has_attr("render_mode")
    assert not env.has_attr("gravity")
    with pytest.raises(IndexError):
        env.get_attr("render_mode", 6)
    env.set_attr("render_worlds", 2)
    assert env.render_worlds == 2
    env.set_attr("render_worlds", 3, range(6))
    with pytest.raises(ValueError, match="'render_worlds' is shared"):
        env.set_attr("render_worlds", 4, [0, 1])
    assert env.get_attr("render_worlds", 0) == [3]
    with pytest.raises(AttributeError, match="no other; step was"):
        env.env_method("step", [0] * 6, indices=0)


def test_worlds_take_no_options() -> None:
    env = make_sb3("ffa_1", 2, seed=0)
    env.set_options([{}] * 4)
    for options in ({"reset_mask": [True, False]}, [{}, {"easy": 1}]):
        with pytest.raises(ValueError, match="worlds take none"):
            env.set_options(options)


def test_a_closed_one_says_so() -> None:
    env = make_sb3("ffa_1", 2, seed=0, render_mode="rgb_array")
    env.reset()
    env.close()
    env.close()
    for call in (env.reset, lambda: env.step(np.ones((4, 6), int)), env.action_masks, env.render, env.get_images):
        with pytest.raises(ClosedError):
            call()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"render_mode": "human"}, "render_mode = 'human': None or 'rgb_array'"),
        ({"render_worlds": 0}, "render_worlds = 0"),
        ({"threads": 0}, "threads = 0"),
        ({"seed": -1}, "seed = -1"),
    ],
)
def test_bad_options_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_sb3("ffa_1", 2, **options)


def test_evaluations_count_every_agent_alike_where_episodes_are_a_multiple_of_them() -> None:
    """With fewer episodes than agents, Stable-Baselines3 counts the last ones only."""
    from stable_baselines3.common.evaluation import evaluate_policy

    env, counted = make_sb3("ffa_2", 2, seed=0, max_episode_steps=3), list[int]()
    idle = SimpleNamespace(predict=lambda seen, **rest: (np.tile(env.base_env.noop, (env.num_envs, 1)), None))
    note = lambda here, everything: counted.append(here["i"]) if here["done"] else None  # noqa: E731
    for episodes, expected in ((2 * env.num_envs, [0, 1, 2, 3] * 2), (2, [2, 3])):
        counted.clear()
        _, lengths = evaluate_policy(
            idle, vec.VecMonitor(env), episodes, callback=note, return_episode_rewards=True, warn=False
        )
        assert (counted, lengths) == (expected, [3] * episodes)
    env.close()


# ---- pictures


def test_pictures_are_those_of_the_worlds() -> None:
    from outlast.envs.rendering.rgb import draw as picture

    env = make_sb3("ffa_1", 3, seed=0, render_mode="rgb_array", render_worlds=2)
    for call in (env.get_images, env.render):
        with pytest.raises(NotResetError, match="3 worlds have not started"):
            call()
    env.reset()
    worlds = [picture(env.base_env.worlds, w) for w in range(3)]
    assert len({world.tobytes() for world in worlds}) == 3
    images = env.get_images()
    assert len(images) == 6
    for i, image in enumerate(images):
        assert image is images[i // 2 * 2]
        assert np.array_equal(image, worlds[i // 2])
    for i, image in zip([5, 0], env.env_method("render", indices=[5, 0]), strict=True):
        assert np.array_equal(image, worlds[i // 2])
    height = worlds[0].shape[0]
    tiles = env.render()
    assert np.array_equal(tiles[:height], worlds[0])
    assert np.array_equal(tiles[height:], worlds[1])
    assert np.array_equal(env.render("rgb_array"), tiles)
    env.render_worlds = 9
    assert env.render().shape == tuple(np.array(worlds[0].shape) * (2, 2, 1))  # there are three


def test_without_a_render_mode_there_are_none() -> None:
    env = make_sb3("ffa_1", 1, seed=0)
    env.reset()
    with pytest.warns(UserWarning, match="no `render_mode`"):
        assert env.render() is None
    with pytest.raises(ValueError, match="render_mode='rgb_array'"):
        env.get_images()


def test_a_window_shows_the_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    pygame = pytest.importorskip("pygame", reason="a window needs pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = make_sb3("ffa_1", 3, seed=0, render_mode="rgb_array", render_worlds=2)
    env.reset()
    assert vec.VecMonitor(env).render("human") is None
    shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
    assert np.array_equal(shown, env.render())
    env.close()
    assert pygame.display.get_surface() is None
    with pytest.warns(UserWarning, match="'human' or 'rgb_array'"):
        assert make_sb3("ffa_1", 1).render("human") is None


def test_videos(tmp_path: Path) -> None:
    pytest.importorskip("moviepy", reason="needs moviepy")
    import cv2

    env = make_sb3("ffa_1", 2, seed=0, render_mode="rgb_array")
    recorder = vec.VecVideoRecorder(env, str(tmp_path), lambda step: step == 0, video_length=10)
    recorder.reset()
    size = env.render().shape[:2]
    for _ in range(12):
        recorder.step(draw(env, np.random.default_rng(0)))
    recorder.close()
    (path,) = tmp_path.glob("*.mp4")
    film = cv2.VideoCapture(str(path))
    assert film.get(cv2.CAP_PROP_FPS) == env.metadata["render_fps"]
    assert (film.get(cv2.CAP_PROP_FRAME_HEIGHT), film.get(cv2.CAP_PROP_FRAME_WIDTH)) == size
    assert abs(film.get(cv2.CAP_PROP_FRAME_COUNT) - 11) <= 1  # moviepy drops a frame at times


# ---- learning


def test_ppo_keeps_what_its_agents_saw() -> None:
    """The rollout that it learns from: observations as they were when the actions were chosen, not a step later."""
    from stable_baselines3 import PPO

    env, reference = pair()
    steps, agents = scaled(40, least=24), env.num_envs
    model = PPO("MultiInputPolicy", env, n_steps=steps, batch_size=steps * agents, n_epochs=1, gamma=0, seed=4)
    model.learn(1)  # one rollout
    kept = model.rollout_buffer
    observed = {key: rows.reshape(agents, steps, *rows.shape[1:]) for key, rows in kept.observations.items()}
    acted = kept.actions.reshape(agents, steps, -1).astype(int)
    reference.seed(4)  # as PPO did
    seen, dones = reference.reset(), np.ones(agents, bool)
    for t in range(steps):
        assert equal(seen, {key: rows[:, t] for key, rows in observed.items()})
        assert dones.tolist() == kept.episode_starts[t].tolist()
        seen, rewards, dones, _ = reference.step(acted[:, t])
        assert rewards.tolist() == kept.rewards[t].tolist()
    assert kept.episode_starts[1:].any()


def test_maskable_ppo_draws_what_the_masks_leave() -> None:
    """The masks of its rollout are those of the worlds in which it acted."""
    contrib = pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed: pip install 'outlast[contrib]'")
    scenario, steps = SHORT.replace(melee_cooldown=5), scaled(40, least=24)
    env, reference = (make_sb3(scenario, WORLDS, seed=0, observations="flat") for _ in range(2))
    agents, form = env.num_envs, {"n_steps": steps, "batch_size": steps * env.num_envs, "n_epochs": 1, "seed": 4}
    model = contrib.MaskablePPO("MlpPolicy", env, **form)
    model.learn(1)  # one rollout
    acted = model.rollout_buffer.actions.reshape(agents, steps, -1).astype(int)
    masks = model.rollout_buffer.action_masks.reshape(agents, steps, -1) > 0
    reference.seed(4)
    reference.reset()
    first = np.concatenate([[0], reference.base_env.action_sizes[:-1]]).cumsum()  # entry of each action's value 0
    for t in range(steps):
        assert np.array_equal(masks[:, t], reference.action_masks())
        assert np.take_along_axis(masks[:, t], first + acted[:, t], 1).all()
        reference.step(acted[:, t])
    assert not masks.all()


@pytest.mark.parametrize("algorithm", ["PPO", "SAC"])
def test_continuous_actions_are_those_of_the_worlds(algorithm: str) -> None:
    """What it kept, played again, pays the same; SAC has continuous actions only."""
    import stable_baselines3

    scenario, steps = SHORT.with_(FineMotors()), scaled(40, least=24)
    env, reference = (
        make_sb3(scenario, WORLDS, seed=0, observations="flat", scaled=True, actions="continuous") for _ in range(2)
    )
    options: dict[str, Any] = {"learning_starts": 4, "buffer_size": 40 * env.num_envs, "gradient_steps": 2}
    if algorithm == "PPO":
        options = {"n_steps": steps, "n_epochs": 1, "batch_size": steps, "gamma": 0}
    model = getattr(stable_baselines3, algorithm)("MlpPolicy", env, seed=4, **options)
    before = [value.clone() for value in model.policy.parameters()]
    model.learn(steps * env.num_envs)
    assert any((a != b).any() for a, b in zip(before, model.policy.parameters(), strict=True))
    kept = model.rollout_buffer if algorithm == "PPO" else model.replay_buffer
    actions, rewards = kept.actions, kept.rewards
    if algorithm == "PPO":  # which keeps one sub-environment behind the other, and what its Gaussians drew
        actions = actions.reshape(env.num_envs, steps, -1).swapaxes(0, 1).clip(-1, 1)
    reference.seed(4)
    reference.reset()
    for t in range(steps):
        _, paid, _, _ = reference.step(actions[t])
        assert paid.tolist() == rewards[t].tolist()


@pytest.mark.nightly
@pytest.mark.timeout(1800)
@pytest.mark.skipif(not COMPILED, reason="kernels as plain Python are too slow to learn with")
@pytest.mark.parametrize(("algorithm", "steps"), [("ppo", 400_000), ("maskable", 400_000), ("recurrent", 800_000)])
def test_ppo_learns(algorithm: str, steps: int) -> None:
    """The example of the documents: a trained agent lives far longer, and by many standard errors."""
    pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed: pip install 'outlast[contrib]'")
    before, after = runpy.run_path(str(EXAMPLE))["main"](steps, algorithm=algorithm)
    error = np.hypot(before.std(), after.std()) / np.sqrt(len(after))
    assert after.mean() > before.mean() + max(6 * error, 30)

"""Stable-Baselines3: its conventions, the bits of the batched environment, its wrappers, and PPO, which learns."""

import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium
import numpy as np
import pytest

import outlast
from outlast import make_vec
from outlast.envs.core.spaces import alive, counts_vary, present, side
from outlast.envs.errors import NotResetError, PendingError
from outlast.systems import FineMotors
from tests.helpers.execution_modes import COUNTS, EACH_LEVEL, HUNT, equal, short
from tests.helpers.goal import TICK, won_at_the_limit

vec = pytest.importorskip("stable_baselines3.common.vec_env", reason="needs stable_baselines3: outlast[sb3]")
pytest.importorskip("torch", reason="needs torch: outlast[sb3]")
pytestmark = pytest.mark.usefixtures("one_torch_thread")
make_sb3 = outlast.adapters.make_sb3  # importing it above would fail before the line above can skip

WORLDS, AGENTS = 5, 4  # of SHORT
SHORT = short("teams_3").replace(ending_limit=22)  # ends both ways, early
STEPS = 150


def draw(env: Any, rng: np.random.Generator) -> np.ndarray[Any, Any]:
    return rng.integers(0, env.action_space.nvec, (env.num_envs, len(env.action_space.nvec)))


def agent(observations: dict[str, Any], *index: int) -> dict[str, Any]:
    return {key: values[index] for key, values in observations.items()}


def walk(env: Any, seed: int = 0) -> Any:
    """Reset, and yield (observations, rewards, dones, infos) of steps with random actions."""
    rng = np.random.default_rng(seed)
    env.reset()
    for _ in range(STEPS):
        yield env.step(draw(env, rng))


@pytest.mark.parametrize("name", ["teams_3", HUNT, *EACH_LEVEL])
def test_it_is_the_batched_environment(name: str) -> None:
    """Beside SAME_STEP with the same seeds and actions; agent i of world w is w * agents + i. Who is absent is dead."""
    scenario = short(name).replace(ending_limit=22)
    env, batch = make_sb3(scenario, WORLDS, seed=3), make_vec(scenario, WORLDS, autoreset_mode="SameStep")
    assert equal(env.reset(), {key: np.concatenate(rows) for key, rows in batch.reset(seed=3)[0].items()})
    rng, ended, cut = np.random.default_rng(0), 0, 0
    for _ in range(STEPS):
        actions, sides = draw(env, rng), side(batch.worlds)
        observations, rewards, dones, infos = env.step(actions)
        expected, reward, terminated, truncated, info = batch.step(actions.reshape(WORLDS, AGENTS, 6))
        assert equal(observations, {key: np.concatenate(rows) for key, rows in expected.items()})
        assert (rewards.dtype, dones.dtype, env.reset_infos[0].keys() >= {"alive"}) == (np.float32, bool, True)
        assert rewards.tolist() == reward.ravel().tolist()
        assert dones.tolist() == np.repeat(terminated | truncated, AGENTS).tolist()
        for i in np.flatnonzero(dones):
            w, k = divmod(int(i), AGENTS)
            assert equal(infos[i]["terminal_observation"], agent(info["final_obs"][w], k))
            assert infos[i]["TimeLimit.truncated"] is bool(truncated[w])
            own = {key: values[w] for key, values in info["statistics"].items()}
            own |= {"return": own["return"][k], "kills": own["kills"][sides[w, k]]}
            there = sides[w] >= 0
            assert infos[i].get("statistics") == (own if there[k] else None)
            assert all(type(value) in (int, float) for value in infos[i].get("statistics", {}).values())
            dead = own["deaths_melee"] + own["deaths_zone"]
            assert dead == there.sum() - sum(infos[o]["alive"] for o in range(w * AGENTS, (w + 1) * AGENTS))
        living, existing = alive(batch.worlds).ravel(), present(batch.worlds).ravel()
        for i in np.flatnonzero(~dones):
            expected_info = {"present": int(existing[i])} if counts_vary(batch.worlds) else {}
            assert infos[i] == {"alive": int(living[i]), "TimeLimit.truncated": False} | expected_info
        ended, cut = ended + terminated.sum(), cut + truncated.sum()
    assert min(ended, cut) > 0


def test_what_is_won_in_the_last_tick_of_the_limit_is_not_cut_off() -> None:
    env = make_sb3(won_at_the_limit(), 2, seed=0)
    env.reset()
    for _ in range(TICK - 1):
        assert not env.step(np.ones((env.num_envs, 6), int))[2].any()
    _, _, dones, infos = env.step(np.ones((env.num_envs, 6), int))
    assert dones.all()
    assert not any(info["TimeLimit.truncated"] for info in infos)


def test_no_seed_is_a_new_one() -> None:
    drawn = []
    for _ in range(2):
        np.random.seed(0)  # noqa: NPY002
        env = make_sb3("ffa_1", 2)
        drawn += [env.reset()["own"].tobytes(), env.seed()[0], env.reset()["own"].tobytes()]
    assert len(set(drawn)) == 6


def test_step_async_and_step_wait_take_turns() -> None:
    env, other = make_sb3("ffa_1", 2, seed=0), make_sb3("ffa_1", 2, seed=0)
    actions = np.tile([2, 1, 1, 0, 0, 0], (4, 1))
    env.step_async(actions)
    with pytest.raises(NotResetError, match="reset them"):
        env.step_wait()
    env.reset()
    other.reset()
    with pytest.raises(PendingError, match="without step_async"):
        env.step_wait()
    env.step_async(actions)
    with pytest.raises(PendingError, match="call step_wait"):
        env.step_async(actions)
    assert equal(env.step_wait()[0], other.step(actions)[0])
    env.step_async(actions)
    assert equal(env.reset(), other.reset())  # drops it
    assert equal(env.step(actions)[0], other.step(actions)[0])


EXAMPLE = Path(__file__).parents[2] / "docs" / "examples" / "sb3_ppo.py"


def test_a_monitor_keeps_statistics_also_of_agents_that_an_episode_does_not_have() -> None:
    env, absent = vec.VecMonitor(make_sb3(short(COUNTS), WORLDS, seed=0), info_keywords=("return", "length")), 0
    for _, _, dones, infos in walk(env):
        for info in [infos[i] for i in np.flatnonzero(dones) if not infos[i]["present"]]:
            assert (info["episode"]["return"], info["episode"]["length"]) == (0, 0)
            assert "statistics" not in info
            absent += 1
    assert absent


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


def test_evaluations_count_every_agent_alike_where_episodes_are_a_multiple_of_them() -> None:
    from stable_baselines3.common.evaluation import evaluate_policy

    env, counted = make_sb3("ffa_2", 2, seed=0, max_episode_steps=3), list[int]()
    idle = SimpleNamespace(predict=lambda seen, **rest: (np.tile(env.base_env.noop, (env.num_envs, 1)), None))
    note = lambda here, everything: counted.append(here["i"]) if here["done"] else None  # noqa: E731
    options: dict[str, Any] = {"callback": note, "return_episode_rewards": True, "warn": False}
    _, lengths = evaluate_policy(idle, vec.VecMonitor(env), 2 * env.num_envs, **options)
    assert (counted, lengths) == ([0, 1, 2, 3] * 2, [3] * 8)


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


def test_maskable_ppo_keeps_what_its_agents_saw_and_draws_what_masks_leave() -> None:
    """Observations as they were when the actions were chosen, not a step later; and the masks of those worlds."""
    contrib = pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed: pip install 'outlast[sb3]'")
    scenario, steps = SHORT.replace(melee_cooldown=5), 40
    env, reference = (make_sb3(scenario, WORLDS, seed=0) for _ in range(2))
    agents, form = env.num_envs, {"n_steps": steps, "batch_size": steps * env.num_envs, "n_epochs": 1, "seed": 4}
    model = contrib.MaskablePPO("MultiInputPolicy", env, gamma=0, **form)
    model.learn(1)  # one rollout
    kept = model.rollout_buffer
    observed = {key: rows.reshape(agents, steps, *rows.shape[1:]) for key, rows in kept.observations.items()}
    acted = kept.actions.reshape(agents, steps, -1).astype(int)
    masks = kept.action_masks.reshape(agents, steps, -1) > 0
    first = np.concatenate([[0], reference.base_env.action_sizes[:-1]]).cumsum()  # entry of each action's value 0
    reference.seed(4)  # as PPO did
    seen, dones = reference.reset(), np.ones(agents, bool)
    for t in range(steps):
        assert equal(seen, {key: rows[:, t] for key, rows in observed.items()})
        assert dones.tolist() == kept.episode_starts[t].tolist()
        assert np.array_equal(masks[:, t], reference.action_masks())
        assert np.take_along_axis(masks[:, t], first + acted[:, t], 1).all()
        seen, rewards, dones, _ = reference.step(acted[:, t])
        assert rewards.tolist() == kept.rewards[t].tolist()
    assert kept.episode_starts[1:].any()
    assert not masks.all()


def test_continuous_actions_are_those_of_the_worlds() -> None:
    """What SAC kept, played again, pays the same."""
    from stable_baselines3 import SAC

    scenario, steps = SHORT.with_(FineMotors()), 25
    env, reference = (
        make_sb3(scenario, WORLDS, seed=0, observations="flat", scaled=True, actions="continuous") for _ in range(2)
    )
    model = SAC("MlpPolicy", env, seed=4, learning_starts=4, buffer_size=40 * env.num_envs, gradient_steps=1)
    before = [value.clone() for value in model.policy.parameters()]
    model.learn(steps * env.num_envs)
    assert any((a != b).any() for a, b in zip(before, model.policy.parameters(), strict=True))
    kept = model.replay_buffer
    reference.seed(4)
    reference.reset()
    for t in range(steps):
        assert reference.step(kept.actions[t])[1].tolist() == kept.rewards[t].tolist()


@pytest.mark.nightly
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(("algorithm", "steps"), [("ppo", 400_000), ("maskable", 400_000), ("recurrent", 800_000)])
def test_ppo_learns(algorithm: str, steps: int) -> None:
    """The example of the documents: a trained agent lives far longer, and by many standard errors."""
    pytest.importorskip("sb3_contrib", reason="sb3-contrib is not installed: pip install 'outlast[sb3]'")
    before, after = runpy.run_path(str(EXAMPLE))["main"](steps, algorithm=algorithm)
    error = np.hypot(before.std(), after.std()) / np.sqrt(len(after))
    assert after.mean() > before.mean() + max(6 * error, 30)

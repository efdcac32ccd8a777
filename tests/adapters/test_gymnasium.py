"""One agent of one world as an ordinary Gymnasium environment, by its own name and by its registered ones."""

import copy
import subprocess
import sys
import threading
from importlib.util import find_spec
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import outlast
from outlast import VARIANTS, make_vec
from outlast.envs.adapters.gymnasium_learners import SurvivalLearnerVectorEnv
from outlast.envs.adapters.gymnasium_single import SurvivalEnv
from outlast.envs.adapters.registry import IDS
from outlast.envs.core.spaces import alive, present, side
from outlast.envs.errors import NotResetError, StateError, UsageError
from outlast.envs.rollout.policies import POLICIES
from tests.helpers.execution_modes import ALL, HUNT, equal, short

SEED = 3
IDLE = [1, 1, 1, 0, 0, 0]


def make(name: str = "teams_3", **options: Any) -> SurvivalEnv:
    return SurvivalEnv(short(name), **options)


def drawn(tick: int) -> Any:
    return np.random.default_rng(tick).integers(0, [3, 3, 3, 2, 2, 2])


@pytest.mark.parametrize("name", IDS)
@pytest.mark.filterwarnings("ignore:.*A Box observation space (minimum|maximum) value is -?infinity")
def test_gymnasiums_own_checker_finds_nothing(name: str) -> None:
    """Neither an error nor a warning, pictures included: in tests, every warning is an error.

    But for one, that infinite bounds are probably too wide: velocities, angles and health have no others. Levels are in
    test_suites.py.
    """
    env = gymnasium.make(name).unwrapped
    check_env(env, skip_render_check=find_spec("pygame") is None)  # it also opens a window
    assert (env.metadata["name"], env.metadata["render_fps"]) == (outlast.variant(IDS[name]).name, 30)


@pytest.mark.parametrize("dead", ["end", "keep"])
@pytest.mark.parametrize(("name", "learner"), [("teams_3", 0), ("teams_3", 3), (HUNT, 0), (HUNT, 2), (ALL, 1)])
def test_it_is_an_agent_of_the_batched_environment(name: str, learner: int, dead: str) -> None:
    """The others' actions are noted by the function that gives them, and the world is played again."""
    others: list[Any] = []

    def play(observations: dict[str, Any]) -> Any:
        assert {key: values.shape[:2] for key, values in observations.items()} == dict.fromkeys(observations, (1, 3))
        ids = observations["own"][..., 0].astype(int)
        others.append((ids, np.random.default_rng(len(others)).integers(0, [3, 3, 3, 2, 2, 2], (1, 3, 6))))
        return others[-1][1]

    env = make(name, learner=learner, dead=dead, others=play)
    batch = make_vec(short(name), 1, autoreset_mode="Disabled")
    seen, info = env.reset(seed=SEED)
    expected, _ = batch.reset(seed=[SEED])
    assert info["alive"] is True
    total, done, length, sides, there = 0.0, False, 0, side(batch.worlds, 0), present(batch.worlds, 0)
    while not done:
        assert equal(seen, {key: values[0, learner] for key, values in expected.items()})
        seen, reward, terminated, truncated, info = env.step(drawn(length))
        joint = np.insert(others[-1][1], learner, drawn(length), axis=1)
        expected, payment, ended, cut, batch_info = batch.step(joint)
        length += 1
        total += reward
        lives = bool(alive(batch.worlds)[0, learner])
        assert reward == payment[0, learner]
        assert (terminated, truncated) == (ended[0] or (dead == "end" and not lives), cut[0])
        assert (info["alive"], info["length"], info["return"]) == (lives, length, total)
        done = terminated or truncated
    ids = [i for i in range(4) if i != learner]
    assert all(seen.tolist() == [[i if there[i] else 0 for i in ids]] for seen, _ in others)  # rows of the absent are 0
    assert length > 5
    if dead == "keep":
        statistics = batch_info["statistics"]
        assert info["kills"] == statistics["kills"][0, sides[learner]]
        assert all(info[key] == statistics[key][0] for key in ("deaths_zone", "first_death"))
    with pytest.raises(NotResetError, match="after the end of the episode; call reset"):
        env.step(IDLE)
    env.reset()
    env.step(IDLE)


@pytest.mark.parametrize("make_one", [gymnasium.make, gymnasium.make_vec])
def test_a_seed_is_given_to_reset(make_one: Any) -> None:
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'seed'.*seeded by reset\(seed=\.\.\.\)"):
        make_one("outlast/FreeForAll1-v1", seed=3)


@pytest.mark.parametrize("name", ["teams_3", ALL])
def test_types_are_pythons_own_and_infos_keep_their_keys(name: str) -> None:
    env = make(name)
    _, first = env.reset(seed=SEED)
    done = False
    while not done:
        _, reward, terminated, truncated, info = env.step(IDLE)
        assert (type(reward), type(terminated), type(truncated)) == (float, bool, bool)
        assert {key: type(value) for key, value in info.items()} == {key: type(value) for key, value in first.items()}
        done = terminated or truncated
    assert {type(value) for value in first.values()} == {bool, int, float}
    assert {"alive", "length", "return", "kills", "deaths_zone", "deaths_melee"} < first.keys()


# ---- pictures


def test_a_window_shows_every_tick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Opened by gymnasium.make or by hand; reset and step draw by themselves."""
    pygame = pytest.importorskip("pygame", reason="a window needs pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env, seen = gymnasium.make("outlast/FreeForAll-v1", render_mode="human"), SurvivalEnv(render_mode="rgb_array")
    for each in (env, seen):
        each.reset(seed=SEED)
    for _ in range(2):
        shown = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
        assert np.array_equal(shown, seen.render())
        for each in (env, seen):
            each.step(IDLE)
    assert env.render() is None
    env.close()
    assert pygame.display.get_surface() is None


class Wanderer:
    """Turns for as many ticks as it has been called for in a world, and then walks."""

    def __init__(self) -> None:
        self.ticks = np.zeros(0, int)

    def reset(self, where: Any) -> None:
        self.ticks = np.where(where, 0, self.ticks if self.ticks.shape == where.shape else 0)

    def __call__(self, observations: Any) -> Any:
        self.ticks += 1
        actions = np.tile(IDLE, (*observations["own"].shape[:2], 1))
        actions[..., 2], actions[..., 0] = 1 + (self.ticks[:, None] % 7 < 3), self.ticks[:, None] % 3
        return actions


def test_a_copy_takes_numbers_and_others_along_and_leaves_those_of_the_original() -> None:
    env, plain = (gymnasium.make("outlast/Teams-v1", others=Wanderer()).unwrapped for _ in range(2))
    for each in (env, plain):
        each.reset(seed=SEED)
        each.base_env.set_numbers(motors_ahead=1.0, rewards_basis="members")
        for _ in range(4):
            each.step(IDLE)
    other = copy.deepcopy(env)
    assert other.base_env.numbers() == env.base_env.numbers()
    for _ in range(2):
        other.step(IDLE)
    for _ in range(6):
        (seen, *result), (expected, *wanted) = env.step(IDLE), plain.step(IDLE)
        assert equal(seen, expected)
        assert result == wanted


def test_a_policy_may_know_its_environment_and_one_that_cannot_be_copied_is_named() -> None:
    policy = Wanderer()
    env = gymnasium.make("outlast/Teams-v1", others=policy).unwrapped
    policy.env = env  # type: ignore[attr-defined]
    env.reset(seed=SEED)
    env.step(IDLE)
    other = copy.deepcopy(env)
    assert other._recipe.keywords["others"].env is other
    policy.lock = threading.Lock()  # type: ignore[attr-defined]
    with pytest.raises(UsageError, match=r"cannot be copied: cannot pickle '_thread.lock' object; give it"):
        copy.deepcopy(env)


def test_a_policy_with_a_memory_plays_in_one_environment_at_a_time() -> None:
    policy = Wanderer()
    first, second = (gymnasium.make("outlast/Teams-v1", others=policy) for _ in range(2))
    for env in (first, second, first):
        env.reset(seed=SEED)
        env.step(IDLE)
    with pytest.raises(UsageError, match="has played in other worlds since it began to play here: give each"):
        second.step(IDLE)
    first.step(IDLE)
    copies = gymnasium.make_vec("outlast/Teams-v1", 2, vectorization_mode="sync", others=policy)
    copies.reset(seed=SEED)
    copies.envs[0].step(IDLE)
    copies.envs[1].step(IDLE)
    with pytest.raises(UsageError, match="Wanderer"):
        copies.envs[0].step(IDLE)


def test_states_go_on_where_they_were() -> None:
    """Also in the step in which the learner has died and its world goes on."""
    env, other = make(), make()
    for seed in range(20):
        env.reset(seed=seed)
        done = False
        while not done:
            seen, _, terminated, truncated, info = env.step(IDLE)
            done = terminated or truncated
            if info["length"] == 5:
                middle, expected = env.get_state(), seen
        if not env.get_state().arrays["over"][0]:
            break
    assert not info["alive"]
    end = env.get_state()
    assert equal(other.set_state(middle), expected)
    for each in (env, other):
        each.set_state(end)
        with pytest.raises(NotResetError, match="after the end"):
            each.step(IDLE)
        each.set_state(middle)
    assert equal(env.step(IDLE)[0], other.step(IDLE)[0])
    with pytest.raises(StateError, match="another scenario"):
        make("ffa_3").set_state(middle)


def test_ids_name_the_eight_variants() -> None:
    assert (IDS["outlast/FreeForAll-v1"], IDS["outlast/Teams-v1"]) == ("ffa_3", "teams_3")
    assert len(IDS) == 10
    assert set(IDS.values()) == set(VARIANTS)
    assert (IDS["outlast/FreeForAll1-v1"], IDS["outlast/Teams4-v1"]) == ("ffa_1", "teams_4")
    assert set(IDS) < set(gymnasium.registry)
    env = gymnasium.make("outlast/FreeForAll-v1", scenario="1v1_heals_low")
    assert env.unwrapped.base_env.scenario.name == "ffa_1"


PROGRAMS = {
    "an id with a colon needs no import": """
import gymnasium
env = gymnasium.make("outlast:outlast/FreeForAll1-v1")
env.reset(seed=0)
env.step(env.action_space.sample())
assert gymnasium.make_vec("outlast:outlast/FreeForAll1-v1", num_envs=2).spec.id == env.spec.id
""",
    "a second import is silent, and what stands behind the ids is loaded late": """
import importlib, sys
import gymnasium, outlast
importlib.reload(outlast.envs.adapters.registry)
importlib.reload(outlast)
assert outlast.envs.adapters.registry.IDS.keys() < gymnasium.registry.keys()
late = {f"outlast.envs.adapters.gymnasium_{name}" for name in ("single", "learners", "agents")} | {"cv2"}
assert not late & set(sys.modules)
""",
}


@pytest.mark.parametrize("name", PROGRAMS)
def test_registration_in_a_fresh_process(name: str) -> None:
    """Gymnasium's warnings, such as that of an id registered twice, are errors."""
    command = [sys.executable, "-W", "error::UserWarning", "-c", PROGRAMS[name]]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


MADE: dict[str, tuple[dict[str, Any], str]] = {
    "no such agent": ({"learner": 2}, "learner = 2: an agent of ffa_3 .* 0 to 1"),
    "an agent by name": ({"learner": "agent_0"}, "learner = 'agent_0'.*integer"),
    "an agent as truth": ({"learner": True}, "learner = True"),
    "no such policy": ({"others": "clever"}, f"others = 'clever': clever: {', '.join(POLICIES)} or a saved"),
    "a number for a policy": ({"others": 3}, "others = 3: 3 is not a policy"),
}


@pytest.mark.parametrize("name", MADE)
def test_environments_that_cannot_be(name: str) -> None:
    options, message = MADE[name]
    for kind in (SurvivalEnv, lambda **options: SurvivalLearnerVectorEnv(2, **options)):
        with pytest.raises(ValueError, match=message):
            kind(**options)


def test_a_batch_names_the_wrapper_that_opens_windows() -> None:
    with pytest.raises(ValueError, match=r"render_mode = 'human'.*gymnasium\.wrappers\.vector\.HumanRendering"):
        SurvivalLearnerVectorEnv(2, render_mode="human")

"""One agent of one world as an ordinary Gymnasium environment, by its own name and by its registered ones."""

import copy
import pickle
import subprocess
import sys
import threading
from importlib.util import find_spec
from pathlib import Path
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
from outlast.envs.core.agents import alive, present, side
from outlast.envs.errors import ActionError, ClosedError, NotResetError, StateError, UsageError
from outlast.envs.rollout.policies import POLICIES
from tests.conftest import scaled
from tests.helpers.execution_modes import ALL, EACH_LEVEL, HUNT, LEVELS, equal, short

SEED, STEPS = 3, 60  # enough for an episode of short()
IDLE = [1, 1, 1, 0, 0, 0]


def make(name: str = "teams_3", **options: Any) -> SurvivalEnv:
    return SurvivalEnv(short(name), **options)


def given(name: str) -> dict[str, Any]:
    """Arguments of gymnasium.make for one of LEVELS; an id has its own scenario."""
    return {"scenario": short(name)} if name in LEVELS else {}


def drawn(tick: int) -> Any:
    return np.random.default_rng(tick).integers(0, [3, 3, 3, 2, 2, 2])


def arrays(result: Any) -> list[np.ndarray[Any, Any]]:
    return [value for part in result if isinstance(part, dict) for value in part.values() if np.ndim(value)]


# ---- the contract


@pytest.mark.parametrize("name", [*IDS, *EACH_LEVEL])
@pytest.mark.filterwarnings("ignore:.*A Box observation space (minimum|maximum) value is -?infinity")
def test_gymnasiums_own_checker_finds_nothing(name: str) -> None:
    """Neither an error nor a warning, pictures included: in tests, every warning is an error.

    But for one, that infinite bounds are probably too wide: velocities, angles and health have no others.
    """
    scenario = short(name) if name in LEVELS else outlast.variant(IDS[name])
    env = gymnasium.make("outlast/FreeForAll-v1" if name in LEVELS else name, **given(name)).unwrapped
    check_env(env, skip_render_check=find_spec("pygame") is None)  # it also opens a window
    assert (env.metadata["name"], env.metadata["render_fps"]) == (scenario.name, 30)
    env.close()


@pytest.mark.parametrize("dead", ["end", "keep"])
@pytest.mark.parametrize(
    ("name", "learner"),
    [("teams_3", 0), ("teams_3", 2), ("teams_3", 3), (HUNT, 0), (HUNT, 2), (ALL, 1)],
)
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
        assert {key: info[key] for key in ("kills", "deaths_zone", "first_death")} == {
            "kills": batch_info["statistics"]["kills"][0, sides[learner]],
            "deaths_zone": batch_info["statistics"]["deaths_zone"][0],
            "first_death": batch_info["statistics"]["first_death"][0],
        }
    with pytest.raises(NotResetError, match="after the end of the episode; call reset"):
        env.step(IDLE)
    env.reset()
    env.step(IDLE)


@pytest.mark.parametrize("make_one", [gymnasium.make, gymnasium.make_vec])
def test_a_seed_is_given_to_reset(make_one: Any) -> None:
    with pytest.raises(TypeError, match=r"unexpected keyword argument 'seed'.*seeded by reset\(seed=\.\.\.\)"):
        make_one("outlast/FreeForAll1-v1", seed=3)


@pytest.mark.parametrize("name", ["teams_3", ALL])
def test_death_ends_the_episode_or_does_not(name: str) -> None:
    """Somewhere among a few episodes the learner dies before its world ends; then, dead= makes the difference."""
    lengths: dict[str, list[int]] = {}
    for dead in ("end", "keep"):
        env, lengths[dead] = make(name, dead=dead), []
        for seed in range(scaled(20, least=6)):
            _, info = env.reset(seed=seed)
            done = False
            while not done:
                lived = info["alive"]
                _, _, terminated, truncated, info = env.step(IDLE)
                done = terminated or truncated
                assert done or info["alive"] or dead == "keep"
                assert lived or not info["alive"]
            lengths[dead].append(info["length"])
    assert np.all(np.array(lengths["end"]) <= lengths["keep"])
    assert lengths["end"] != lengths["keep"]


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


def test_what_comes_out_is_not_used_again() -> None:
    env = make()
    results = [env.reset(seed=SEED), env.step(IDLE), env.step(IDLE), env.reset()]
    assert len(arrays(results[0])) > 5
    for k, result in enumerate(results):
        for array in arrays(result):
            assert array.flags.writeable
            assert not any(np.shares_memory(array, other) for older in results[:k] for other in arrays(older))


def test_seeds_begin_and_the_next_reset_goes_on() -> None:
    env, other = make(), make()
    first, second = env.reset(seed=SEED)[0], env.reset()[0]
    assert not equal(first, second)
    assert equal(first, other.reset(seed=SEED, options={"anything": 1})[0])
    for tick in range(5):
        other.step(drawn(tick))
    assert equal(second, other.reset()[0])
    assert env.np_random.random() == np.random.default_rng(SEED).random()
    assert not equal(make().reset()[0], make().reset()[0])  # without any seed, no two are alike


def test_time_limits_truncate() -> None:
    scenario = VARIANTS["ffa_3"].replace(ending_limit=4)
    for env in (SurvivalEnv(scenario), gymnasium.make("outlast/FreeForAll-v1", max_episode_steps=4)):
        env.reset(seed=SEED)
        assert [env.step(IDLE)[2:4] for _ in range(4)] == [(False, False)] * 3 + [(False, True)]


# ---- others


@pytest.mark.parametrize("name", ["random", "noop", "scripted"])
def test_the_same_seed_gives_the_same_game(name: str) -> None:
    first, second = (make(others=name) for _ in range(2))
    second.reset(seed=SEED + 1)
    second.step(IDLE)
    games = [[env.reset(seed=SEED)[0]] + [env.step(drawn(t))[0] for t in range(10)] for env in (first, second)]
    assert all(equal(a, b) for a, b in zip(*games, strict=True))


# ---- pictures


def test_pictures_are_those_of_the_world() -> None:
    from outlast.envs.rendering.rgb import draw, text

    env, written = make(render_mode="rgb_array"), make(render_mode="ansi")
    for each in (env, written):
        with pytest.raises(NotResetError, match="render"):
            each.render()
        each.reset(seed=SEED)
    frame = env.render()
    assert (frame.dtype, frame.ndim, frame.shape[2]) == (np.uint8, 3, 3)
    assert np.array_equal(frame, draw(env.base_env.worlds, 0))
    assert written.render() == text(written.base_env.worlds, 0)
    env.step(IDLE)
    assert not np.array_equal(env.render(), frame)
    with pytest.warns(UserWarning, match="without a render_mode"):
        assert make().render() is None


def test_gymnasium_collects_pictures() -> None:
    env = gymnasium.make("outlast/FreeForAll-v1", render_mode="rgb_array_list")
    env.reset(seed=SEED)
    env.step(IDLE)
    assert [frame.shape for frame in env.render()] == [(512, 512, 3)] * 2


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


def test_a_window_for_many_worlds_is_gymnasiums(monkeypatch: pytest.MonkeyPatch) -> None:
    pygame = pytest.importorskip("pygame", reason="a window needs pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    batch = SurvivalLearnerVectorEnv(4, render_mode="rgb_array")
    env = gymnasium.wrappers.vector.HumanRendering(batch, screen_size=(200, 200))
    env.reset(seed=SEED)
    env.step(np.tile(IDLE, (4, 1)))
    shown = pygame.surfarray.array3d(pygame.display.get_surface())
    assert len(np.unique(shown.reshape(-1, 3), axis=0)) > 10
    env.close()


# ---- wrappers, copies


def test_pictures_can_be_the_observations() -> None:
    env = gymnasium.make("outlast/FreeForAll2-v1", render_mode="rgb_array", max_episode_steps=5)
    beside = gymnasium.wrappers.AddRenderObservation(env, render_only=False)
    seen, _ = beside.reset(seed=0)
    assert {*seen} - {*env.observation_space} == {"pixels"}
    before = seen["pixels"].copy()
    assert np.array_equal(before, outlast.draw(env.unwrapped.base_env.worlds, 0))  # type: ignore[attr-defined]
    for _ in range(3):  # full speed backwards
        seen = beside.step(np.zeros(env.action_space.shape, int))[0]
    assert seen in beside.observation_space
    assert not np.array_equal(before, seen["pixels"])
    beside.close()


def test_wrappers_for_single_environments() -> None:
    env = gymnasium.make("outlast/FreeForAll-v1", scenario=short("ffa_3"))
    env = gymnasium.wrappers.RecordEpisodeStatistics(gymnasium.wrappers.FlattenObservation(env))
    observation, _ = env.reset(seed=SEED)
    assert env.observation_space.contains(observation)
    info: dict[str, Any] = {}
    while "episode" not in info:
        *_, info = env.step(IDLE)
    assert (info["episode"]["r"], info["episode"]["l"]) == (info["return"], info["length"])


def test_pickles_are_made_anew() -> None:
    env = gymnasium.make("outlast/Teams-v1", learner=2, others="scripted").unwrapped
    expected, _ = env.reset(seed=SEED)
    following = env.step(IDLE)[0]
    other = pickle.loads(pickle.dumps(env))
    with pytest.raises(NotResetError):
        other.step(IDLE)
    assert equal(other.reset(seed=SEED)[0], expected)
    assert equal(other.step(IDLE)[0], following)
    assert other.spec == env.spec


def test_copies_go_on_from_where_an_environment_is() -> None:
    """Also under wrappers, which copy what they count, and into the next episode."""
    env = gymnasium.make("outlast/Teams-v1", learner=2, others="scripted", max_episode_steps=5)
    with pytest.raises(NotResetError):
        copy.deepcopy(env.unwrapped).step(IDLE)
    env.reset(seed=SEED)
    env.step(IDLE)
    env.action_space.seed(3)
    other = copy.deepcopy(env)
    assert other.unwrapped.spec == env.unwrapped.spec
    for _ in range(4):
        (seen, *result, _), (expected, *wanted, _) = (each.step(each.action_space.sample()) for each in (other, env))
        assert equal(seen, expected)
        assert result == wanted
    assert result[-1]
    assert equal(other.reset()[0], env.reset()[0])


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
    """One after the other is right, as in a notebook; in turns, each would remember what the other has seen."""
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


@pytest.mark.parametrize("form", [bool, np.int64, float])
def test_seeds_are_whole_numbers_of_any_kind(form: Any) -> None:
    env = make()
    if form is np.int64:
        assert equal(env.reset(seed=form(1))[0], env.reset(seed=1)[0])
    else:
        with pytest.raises(ValueError, match=r"seed = .*an integer from 0"):
            env.reset(seed=form(1))


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


# ---- the registry


def test_ids_name_the_eight_variants() -> None:
    assert {name: IDS[name] for name in ("outlast/FreeForAll-v1", "outlast/Teams-v1")} == {
        "outlast/FreeForAll-v1": "ffa_3", "outlast/Teams-v1": "teams_3",
    }  # fmt: skip
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
assert sum(name.startswith("outlast/") for name in gymnasium.registry) == 10
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


# ---- bad input

MADE: dict[str, tuple[dict[str, Any], type[Exception], str]] = {
    "no such agent": ({"learner": 2}, ValueError, "learner = 2: an agent of ffa_3 .* 0 to 1"),
    "an agent below zero": ({"learner": -1}, ValueError, "learner = -1"),
    "an agent by name": ({"learner": "agent_0"}, ValueError, "learner = 'agent_0'.*integer"),
    "an agent as truth": ({"learner": True}, ValueError, "learner = True"),
    "no such policy": (
        {"others": "clever"},
        ValueError,
        f"others = 'clever': clever: {', '.join(POLICIES)} or a saved policy ",
    ),
    "a misspelt policy": ({"others": "scriptd:0.5,random"}, ValueError, "scriptd: did you mean scripted"),
    "no saved policy": (
        {"others": "policy.pt"},
        ValueError,
        r"policy.pt: .* \(a model's name, FILE.zip, FILE.safetensors or the folder of a run\) is needed",
    ),
    "no policy": ({"others": None}, ValueError, "others = None: None is no policy: .*, or a function"),
    "a number for a policy": ({"others": 3}, ValueError, "others = 3: 3 is no policy"),
    "a mixture of nothing": ({"others": {}}, ValueError, f"a mixture of nothing: {', '.join(POLICIES)} or"),
    "a policy twice": ({"others": "random,noop,random:2"}, ValueError, "random is there twice: give it once"),
    "a file twice": ({"others": {"a.zip": 1, Path("./a.zip"): 1}}, ValueError, "a.zip is there twice"),
    "no weight": ({"others": {"random": 0}}, ValueError, "the weight of random is 0: a finite number above 0"),
    "neither dead nor alive": ({"dead": "remove"}, ValueError, "dead = 'remove': allowed are 'end', 'keep'"),
    "no such picture": ({"render_mode": "svg"}, ValueError, "render_mode = 'svg': allowed are None, 'rgb_array'"),
}


def test_a_batch_names_the_wrapper_that_opens_windows() -> None:
    with pytest.raises(ValueError, match=r"render_mode = 'human'.*gymnasium\.wrappers\.vector\.HumanRendering"):
        SurvivalLearnerVectorEnv(2, render_mode="human")


@pytest.mark.parametrize("name", MADE)
def test_environments_that_cannot_be(name: str) -> None:
    options, error, message = MADE[name]
    for kind in (SurvivalEnv, lambda **options: SurvivalLearnerVectorEnv(2, **options)):
        with pytest.raises(error, match=message):
            kind(**options)


ACTIONS: dict[str, tuple[Any, str]] = {
    "too few": ([0] * 5, r"shape \(5,\): \(actions,\) = \(6,\) is needed"),
    "one too deep": ([IDLE], r"shape \(1, 6\)"),
    "ragged": ([0, [1]], "is needed"),
    "one number": (3, r"shape \(\)"),
    "floats": ([0.0] * 6, "float64: integers"),
    "truth": ([True] * 6, "bool: integers"),
    "too high": ([0, 0, 3, 0, 0, 0], r"action 2 \(turn\) of .* is 3: 0 to 2"),
    "below zero": ([0, 0, 0, 0, 0, -1], r"action 5 \(give\) of .* is -1: 0 to 1"),
}


@pytest.mark.parametrize("name", ACTIONS)
def test_actions_that_are_refused_change_nothing(name: str) -> None:
    asked: list[int] = []

    def play(observations: dict[str, Any]) -> Any:
        asked.append(1)
        return np.full((1, 3, 6), len(asked) % 2)

    env, reference = make(others=play), make(others=lambda observations: np.ones((1, 3, 6), int))
    env.reset(seed=SEED)
    reference.reset(seed=SEED)
    with pytest.raises(ActionError, match=ACTIONS[name][1]):
        env.step(ACTIONS[name][0])
    assert asked == []
    assert equal(env.step(IDLE)[0], reference.step(np.array(IDLE, np.uint8))[0])


@pytest.mark.parametrize("seed", [-1, 1.5, 2**64, "1"])
def test_seeds_are_refused(seed: Any) -> None:
    with pytest.raises((ValueError, gymnasium.error.Error)):
        make().reset(seed=seed)


def test_before_reset_and_after_close() -> None:
    env = make()
    for call in (lambda: env.step(IDLE), env.state, env.action_masks):
        with pytest.raises(NotResetError, match="before reset"):
            call()
    env.reset()
    env.close()
    env.close()
    for call in (env.reset, lambda: env.step(IDLE), env.unwrapped.action_masks):
        with pytest.raises(ClosedError):
            call()

"""What holds for all environments of many worlds, whichever library they are made for: spaces, seeds, pictures."""

import copy
import inspect
import pickle
import re
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import outlast
import tests.adapters.test_puffer  # noqa: F401  # it imports PufferLib where that leaves no link behind
from outlast.components import Body
from outlast.ecs import NumberError
from outlast.envs.adapters.gymnasium_single import SurvivalEnv
from outlast.envs.errors import ActionError, ClosedError, NotResetError
from outlast.envs.rendering.rgb import draw, text
from outlast.errors import ScenarioError
from tests.conftest import digest
from tests.helpers.covering import covering

WORLDS = 64
SAMPLES = 20
NEEDS = {
    "make_sb3": "stable_baselines3", "make_puffer": "pufferlib", "parallel_env": "pettingzoo", "aec_env": "pettingzoo",
    "SurvivalMultiAgentEnv": "ray",
}  # fmt: skip
BATCHED = ("make_vec", "make_agents", "gymnasium.make_vec", "make_sb3", "make_puffer")
LONE = ("gymnasium.make", "parallel_env", "aec_env", "SurvivalMultiAgentEnv")  # of one world
ALL = (*BATCHED, *LONE)


def make(name: str, scenario: Any = "ffa_1", worlds: int = 3, **options: Any) -> Any:
    """The environments of an adapter, without the wrappers of its library."""
    if find_spec(NEEDS.get(name, "numpy")) is None:
        pytest.skip(f"needs {NEEDS[name]}")
    if name == "gymnasium.make":
        return gymnasium.make("outlast/FreeForAll-v1", scenario=scenario, **options).unwrapped
    if name == "gymnasium.make_vec":
        return gymnasium.make_vec("outlast/FreeForAll-v1", num_envs=worlds, scenario=scenario, **options)
    if name == "SurvivalMultiAgentEnv":
        return outlast.adapters.SurvivalMultiAgentEnv({"scenario": scenario, **options})
    place = outlast if name == "make_vec" else outlast.adapters
    env = getattr(place, name)(scenario, *([] if name in LONE else [worlds]), **options)
    return env.unwrapped if name == "aec_env" else env


def base(env: Any) -> Any:
    """The worlds below."""
    return getattr(env, "base_env", env)


@pytest.mark.parametrize("name", ALL)
def test_nothing_goes_before_reset_or_after_close(name: str) -> None:
    env = make(name)
    steps = [] if name == "SurvivalMultiAgentEnv" else [lambda: env.step(actions(env))]  # which says how it ended
    for call in (env.state, env.action_masks, *steps):
        with pytest.raises(NotResetError, match=r"before reset\(\)|reset them|reset\(\)"):
            call()
    env.reset()
    shape = (base(env).num_worlds, *base(env).state_space.shape)
    assert env.state().shape == (shape[1:] if name in LONE else shape)
    assert len(env.action_masks())
    env.close()
    env.close()
    for call in (env.reset, env.action_masks, *steps):
        with pytest.raises(ClosedError):
            call()


@pytest.mark.parametrize("name", [name for name in ALL if name != "make_puffer"])  # which writes into its arrays
def test_what_is_handed_out_stays_as_it_is(name: str) -> None:
    env = make(name)
    results = [env.reset(), *(env.step(actions(env)) for _ in range(3))]
    for k, result in enumerate(results):
        for array in arrays(result):
            assert array.flags.writeable
            assert not any(np.shares_memory(array, other) for older in results[:k] for other in arrays(older))


def arrays(result: Any) -> list[Any]:
    """All arrays in what an environment returned."""
    if isinstance(result, (dict, tuple, list)):
        return [array for part in (result.values() if isinstance(result, dict) else result) for array in arrays(part)]
    return [result] if isinstance(result, np.ndarray) and result.ndim and result.dtype != object else []


@pytest.mark.parametrize("name", ALL)
def test_every_adapter_goes_on_from_a_state(name: str) -> None:
    env, other = make(name, n_agents=2), make(name, n_agents=2)
    for each in (env, other):
        each.reset()
    saved, before = env.get_state(), digest(base(env).worlds)
    found = []
    for each in (env, env, other):
        each.set_state(saved)
        assert digest(base(each).worlds) == before
        found.append([each.step(actions(each)), digest(base(each).worlds)])
        assert found[-1][1] != before
    for result, after in found[1:]:
        assert after == found[0][1]
        if name != "make_puffer":
            assert all(map(np.array_equal, arrays(result), arrays(found[0][0])))


@pytest.mark.parametrize("name", ["gymnasium.make", "parallel_env", "aec_env"])
def test_copies_go_on_and_pickles_begin_anew(name: str) -> None:
    env = make(name)
    env.reset(seed=4)
    env.step(actions(env))
    base(env).set_numbers(motors_ahead=1.0)
    other, anew = copy.deepcopy(env), pickle.loads(pickle.dumps(env))
    assert base(other).numbers() == base(env).numbers()
    for _ in range(3):
        one, two = (arrays(each.step(actions(each))) for each in (env, other))
        assert all(map(np.array_equal, one, two))
    with pytest.raises(NotResetError):
        anew.state()
    assert all(map(np.array_equal, arrays(anew.reset(seed=4)), arrays(env.reset(seed=4))))


@pytest.mark.parametrize("name", ALL)
@pytest.mark.filterwarnings("ignore::UserWarning")  # of PettingZoo, which calls some of its attributes deprecated
def test_an_environment_has_what_its_librarys_classes_declare(name: str) -> None:
    """Annotations without a value, properties and methods, whoever reads them."""
    env = outlast.adapters.aec_env("ffa_1") if name == "aec_env" and find_spec("pettingzoo") else make(name)
    env.reset()
    theirs = [kind for kind in type(env).__mro__ if kind is not object and not kind.__module__.startswith("outlast.")]
    assert theirs
    for kind in theirs:
        for attribute in {*kind.__dict__, *inspect.get_annotations(kind)}:
            assert attribute.startswith("_") or hasattr(env, attribute), f"{kind.__name__}.{attribute}"
    assert env.metadata.keys() >= {"name", "render_modes", "render_fps"}
    assert env.render_mode is None


@pytest.mark.parametrize("name", ["parallel_env", "SurvivalMultiAgentEnv"])
def test_spaces_by_agent_are_those_of_each_agent(name: str) -> None:
    env = make(name, n_agents=3)
    for kind in ("observation_space", "action_space"):
        each = getattr(env, kind if name == "parallel_env" else f"get_{kind}")
        assert list(getattr(env, f"{kind}s")) == env.possible_agents
        assert all(each(agent) is space for agent, space in getattr(env, f"{kind}s").items())


GAMES: dict[str, tuple[outlast.Scenario, set[str]]] = {
    "nothing varies": (outlast.variant("ffa_2"), {"alive"}),
    "a number varies": (outlast.variant("ffa_2").vary(melee_damage=outlast.distributions.integers(5, 20)), {"alive"}),
    "counts vary": (outlast.variant("ffa_2").vary(n_agents=outlast.distributions.integers(1, 2)), {"alive", "present"}),
}


@pytest.mark.parametrize("name", [name for name in ALL if name not in ("aec_env", "make_puffer")])
@pytest.mark.parametrize("game", GAMES)
def test_infos_have_present_where_the_number_of_agents_varies(name: str, game: str) -> None:
    scenario, expected = GAMES[game]
    env = make(name, scenario, **({"dead": "keep"} if name in LONE else {}))
    info = env.reset()[1] if name != "make_sb3" else env.reset() and env.reset_infos[0]
    info = info["agent_0"] if hasattr(env, "possible_agents") else info
    assert {"alive", "present"} & info.keys() == expected


@pytest.mark.parametrize("name", ALL)
def test_numbers_are_keywords_of_every_factory(name: str) -> None:
    env = make(name, melee_damage=20)
    assert base(env).scenario == outlast.variant("ffa_1").replace(melee_damage=20)
    env.close()
    for wrong, right in (("melee_damge", "melee_damage"), ("render_mod", "render_mode")):
        with pytest.raises(NumberError, match=f"ffa_1 has no number '{wrong}'; did you mean .*{right}"):
            make(name, **{wrong: 1})
    with pytest.raises(NumberError, match=r"melee\.damage = -1"):
        make(name, melee_damage=-1)
    with pytest.raises(ScenarioError, match="no variant 'ffa_9'"):
        make(name, "ffa_9")


TOGETHER = ("make_agents", "make_sb3", "make_puffer")  # where all agents end together, the dead are kept
WRONG: dict[tuple[str, Any], tuple[str, ...]] = {
    ("threads", 0): BATCHED,
    ("worlds", 0): BATCHED,
    ("autoreset_mode", "never"): ("make_vec", "make_agents", "gymnasium.make_vec"),
    ("seed", -1): ("make_vec", *TOGETHER, "parallel_env", "aec_env"),
    ("render_mode", "svg"): ALL,
    ("dead", "bury"): tuple(name for name in ALL if name != "make_vec"),
    ("dead", "end"): TOGETHER,
    ("max_episode_steps", 0): tuple(name for name in ALL if name not in ("make_vec", "gymnasium.make")),
    ("copy", "no"): ("make_vec", "make_agents", "gymnasium.make_vec"),
    ("check_actions", 1): ("make_vec", *TOGETHER),
    ("action_masks", None): ("make_vec", "make_agents", "gymnasium.make", "gymnasium.make_vec", "parallel_env"),
    ("scaled", "yes"): ALL,
}


@pytest.mark.parametrize(("option", "name"), [(option, name) for option, names in WRONG.items() for name in names])
@pytest.mark.filterwarnings("ignore")  # of Gymnasium, about a mode that is missing
def test_options_that_cannot_be_are_refused(option: tuple[str, Any], name: str) -> None:
    key, value = option
    with pytest.raises(ValueError, match=f"{key} = {value!r}|num_envs = 0|num_worlds = 0"):
        make(name, **{key: value})


@pytest.mark.parametrize(("name", "seed"), covering(ALL, [-1, True, 1.5, "7", 2**64]))
def test_seeds_that_are_none_are_refused(name: str, seed: Any) -> None:
    env = make(name)
    with pytest.raises((ValueError, gymnasium.error.Error)):
        env.seed(seed) if name == "make_sb3" else env.reset(seed=seed)


BAD: dict[str, tuple[Any, str]] = {
    "one too few": (lambda noop: noop[..., :-1], "shape"),
    "one too deep": (lambda noop: noop[None], "shape"),
    "floats": (lambda noop: noop * 0.5, "float64: integers"),
    "truth": (lambda noop: noop > 0, "bool: integers"),
    "too high": (lambda noop: noop + 3, r"action 0 \(ahead\) of .* is 4: 0 to 2"),
    "wraps around": (lambda noop: noop.astype(int) + 255, r"action 0 \(ahead\) of .* is 256: 0 to 2"),
    "below zero": (lambda noop: noop.astype(int) - 3, r"action 0 \(ahead\) of .* is -2"),
    "text": (lambda noop: "attack", r"shape \(\)"),
}


@pytest.mark.parametrize(("name", "what"), covering(ALL, BAD))
def test_actions_that_cannot_be_change_nothing(name: str, what: str) -> None:
    env, (change, words) = make(name), BAD[what]
    env.reset()
    before, good = digest(base(env).worlds), actions(env)
    bad = {agent: change(own) for agent, own in good.items()} if isinstance(good, dict) else change(good)
    with pytest.raises(ActionError, match=words):
        env.step(bad)
    assert digest(base(env).worlds) == before
    env.step(good)


def actions(env: Any) -> Any:
    """All agents do nothing."""
    noop = base(env).noop
    if hasattr(env, "possible_agents"):
        return dict.fromkeys(env.agents, noop)
    shape = getattr(env, "num_envs", None) or getattr(env, "num_agents", None)
    if env is base(env):
        return np.tile(noop, (env.num_worlds, env.num_agents, 1))
    return noop if shape is None else np.tile(noop, (shape, 1))


@pytest.mark.parametrize("name", [name for name in ALL if name != "make_vec"])
def test_max_episode_steps_truncates(name: str) -> None:
    build = SurvivalEnv if name == "gymnasium.make" else partial(make, name)  # gymnasium.make wraps it in TimeLimit
    env = build(max_episode_steps=3)
    env.reset()
    cut = []
    for _ in range(3):
        result = env.step(actions(env))
        flags = [info["TimeLimit.truncated"] for info in result[3]] if name == "make_sb3" else result[3]
        cut.append(any(flags.values()) if isinstance(flags, dict) else bool(np.any(flags)))
    assert cut == [False, False, True]


def sample(space: Any) -> bytes:
    drawn = space.sample()
    return b"".join(np.asarray(part).tobytes() for part in (drawn.values() if isinstance(drawn, dict) else [drawn]))


@pytest.mark.parametrize("kind", ["action_space", "observation_space"])
@pytest.mark.parametrize("name", BATCHED)
def test_samples_of_a_space_differ_and_its_seed_repeats_them(name: str, kind: str) -> None:
    """The space is asked for anew in every line, as in a user's loop."""
    env = make(name)
    for of in [kind] if name == "make_sb3" else [kind, f"single_{kind}"]:
        assert len({sample(getattr(env, of)) for _ in range(SAMPLES)}) > SAMPLES / 2  # two of 216 actions may be alike
        getattr(env, of).seed(7)
        first = [sample(getattr(env, of)) for _ in range(SAMPLES)]
        assert [sample(getattr(env, of)) for _ in range(SAMPLES)] != first
        getattr(env, of).seed(7)
        assert [sample(getattr(env, of)) for _ in range(SAMPLES)] == first


def starts(env: Any) -> list[bytes]:
    """Where all bodies of each world are."""
    body = base(env).worlds[Body]
    return [x.tobytes() + y.tobytes() for x, y in zip(body.x, body.y, strict=True)]


def seeded(name: str, seed: int) -> Iterator[list[bytes]]:
    """The first worlds of a seed in all the ways in which it can be given."""
    env = make(name, "ffa_1", WORLDS)
    if name == "make_sb3":
        env.seed(seed)
        env.reset()
    else:
        env.reset(seed=seed)
    yield starts(env)
    env.close()
    if not name.startswith("gymnasium."):  # Gymnasium has no seed at the start
        env = make(name, "ffa_1", WORLDS, seed=seed)
        env.reset()
        yield starts(env)
        env.close()


@pytest.mark.parametrize("name", ALL)
def test_a_world_of_a_seed_is_the_same_in_every_adapter_and_no_two_seeds_share_one(name: str) -> None:
    """But for gymnasium.make_vec, whose worlds are seeded as Gymnasium's own: seed + number."""
    batch = outlast.make_vec("ffa_1", WORLDS, seed=0)
    batch.reset()
    for zero, one in zip(seeded(name, 0), seeded(name, 1), strict=True):
        assert len(set(zero)) == len(set(one)) == (WORLDS if name in BATCHED else 1)
        if name == "gymnasium.make_vec":
            assert len({*zero} & {*one}) == WORLDS - 1
            assert not {*zero} & {*next(seeded(name, WORLDS))}
            assert zero == [next(seeded("gymnasium.make", seed))[0] for seed in range(WORLDS)]
        else:
            assert zero == starts(batch)[: len(zero)]
            assert not {*zero} & {*one}


PAGE = (Path(__file__).parents[2] / "docs" / "libraries.md").read_text(encoding="utf-8")
RENDERS = {  # adapter -> what the page says of it: modes, and what render() returns
    adapter: (re.findall(r'"(\w+)"', modes), returns)
    for adapters, modes, returns in re.findall(r'^\| (`.+?) \| (`"rgb_array".*?) \| (.*) \|$', PAGE, re.MULTILINE)
    for adapter in re.findall(r"`([\w.]+)`", adapters)
}


@pytest.mark.parametrize("adapter", RENDERS)
@pytest.mark.parametrize("mode", ["rgb_array", "ansi", "human"])
@pytest.mark.filterwarnings("ignore")  # of Gymnasium, about a mode that is missing
def test_adapters_render_what_the_page_says(adapter: str, mode: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if mode == "human":
        pytest.importorskip("pygame", reason="a window needs pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    modes, returns = RENDERS[adapter]
    if mode not in modes:
        with pytest.raises(ValueError, match=mode):
            make(adapter, render_mode=mode)
        return
    env = make(adapter, render_mode=mode)
    with pytest.raises(NotResetError):
        env.render()
    env.reset()
    frames = env.render()
    if mode == "human":
        assert frames is None
    elif "one frame per environment" in returns:
        assert len(frames) == env.num_envs
        frames = frames[0]
    if mode == "rgb_array":
        assert (frames.dtype, frames.ndim, frames.shape[2]) == (np.uint8, 3, 3)
        assert "tile" in returns or np.array_equal(frames, draw(base(env).worlds, 0))
    elif mode == "ansi":
        assert frames == text(base(env).worlds, 0)


def test_the_page_describes_all_adapters() -> None:
    described = re.findall(r"^\| .* \| (`.+`) \| .* \|$", PAGE.split("## Arguments")[0], re.MULTILINE)
    adapters = {
        name.removeprefix("outlast.").removeprefix("adapters.")
        for cell in described
        for name in re.findall(r"`([\w.]+)`", cell)
    }
    assert RENDERS.keys() == adapters - {"envs.adapters.benchmarl", "make_torchrl"}  # which draw nothing

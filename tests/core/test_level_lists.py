"""Levels: what an episode was made from, kept, changed, and played again."""

import copy
import functools
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import levels, role
from outlast.components import Body
from outlast.distributions import choice, free, integers, log_uniform, uniform
from outlast.ecs import NumberError
from outlast.ecs.memory.numbers import Given
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import NotResetError, StateError
from outlast.envs.levels import check
from outlast.envs.scenarios.parse import with_roles
from outlast.envs.scenarios.scenario_json import plain_roles
from outlast.errors import ScenarioError
from outlast.levels import FloorPlan, Level
from outlast.systems import Maze
from tests.conftest import digest, draw_actions, scaled
from tests.helpers.refusals import begin, refuses

DUEL = outlast.variant("ffa_3").vary(
    n_agents=integers(2, 4),
    melee_damage=integers(5, 20),
    cameras_depth=uniform(5, 12),
    cameras_cone=choice("sector", "kite"),
    safe_zone_radii=choice((12.5, 10, 7.5, 5, 4, 2, 1), (12, 9, 7, 5, 4, 2, 1)),
)


def make(count: int = 6, seed: int = 3) -> SurvivalVectorEnv:
    env = outlast.make_vec(DUEL, count, seed=seed)
    env.reset()
    return env


def played(env: SurvivalVectorEnv, seed: int) -> list[Any]:
    rng, found = np.random.default_rng(seed), []
    for _ in range(scaled(20, least=2)):
        observations, rewards, *_ = env.step(draw_actions(env, rng))
        found += [*observations.values(), rewards]
    return found


GAMES = {
    "numbers": DUEL,
    "walls": outlast.variant("ffa_3").with_(Maze()),
    "roles": outlast.variant("teams_2").roles(one=role(1, motors_ahead=0.4), other=role(3), drawn="anyone"),
}


@pytest.mark.parametrize("game", GAMES)
def test_a_level_is_the_episode_again(game: str) -> None:
    env, other = (outlast.make_vec(GAMES[game], 6, seed=seed) for seed in (3, 99))
    for each in (env, other, env):
        each.reset()
    other.set_levels(env.levels())
    other.reset()
    assert other.levels() == env.levels()
    for mine, its in zip(played(env, 0), played(other, 0), strict=True):
        np.testing.assert_array_equal(mine, its)


@functools.cache
def drawn(seed: int, world: int, episode: int) -> dict[str, Any]:
    """The numbers that a world alone draws for an episode."""
    env = outlast.make_vec(DUEL, 1, seed=seed, first_world=world)
    for _ in range(episode):
        env.reset()
    return dict(env.levels()[0].numbers)


class Planned:
    """What a world plays, and what it is going to play: numbers until they are taken back, or for one episode."""

    def __init__(self, world: int, seed: int) -> None:
        self.world, self.key, self.waiting = world, [seed, world, 0], None
        self.numbers, self.once = dict[str, Any](), set[str]()
        self.begin()

    def give(self, level: Level) -> None:
        self.numbers = {name: value for name, value in self.numbers.items() if name not in self.once} | level.numbers
        self.once, self.waiting = {*level.numbers}, level.key

    def set(self, numbers: dict[str, Any]) -> None:
        self.numbers = {name: value for name, value in (self.numbers | numbers).items() if value is not None}
        self.once -= numbers.keys()

    def begin(self, seed: int | None = None) -> None:
        self.key = self.key if seed is None else [seed, self.world, 0]
        self.key[2] += 1
        key = self.waiting or tuple(self.key)
        self.plays = Level(drawn(*key) | self.numbers, key)
        self.give(Level())


@pytest.mark.parametrize("seed", range(scaled(8, least=1)))
def test_levels_numbers_seeds_and_states_in_any_order(seed: int) -> None:
    """Each world plays what was given to it, a level once and numbers until they are taken back; and then its own."""
    rng, env, worlds = np.random.default_rng(seed), make(), [Planned(w, 3) for w in range(6)]
    kept = env.get_state(), copy.deepcopy(worlds)
    for _ in range(60):
        mask = rng.random(6) < 0.5
        mask[rng.integers(6)] = True
        chosen = [worlds[w] for w in np.flatnonzero(mask)]
        counts = {"agents_count": int(rng.integers(2, 5))} if rng.random() < 0.7 else {}
        match rng.choice(["set", "free", "give", "keep", "restore", "reset", "reset", "seed"]):
            case "set" | "free" as call:
                numbers = {"melee_damage": int(rng.integers(5, 21)), **counts}
                numbers = numbers if call == "set" else dict.fromkeys(numbers)
                env.set_numbers(numbers, mask=mask)
                for world in chosen:
                    world.set(numbers)
            case "give":
                key = (int(rng.integers(9)), 0, int(rng.integers(1, 4))) if rng.random() < 0.5 else None
                env.set_levels([Level(counts, key)], mask=mask)
                for world in chosen:
                    world.give(Level(counts, key))
            case "keep":
                kept = env.get_state(), copy.deepcopy(worlds)
            case "restore":
                order = rng.integers(6, size=6)
                env.set_state(kept[0][order])
                worlds = [copy.deepcopy(kept[1][w]) for w in order]
                for w, world in enumerate(worlds):
                    world.world = w
            case call:
                begun = int(rng.integers(9)) if call == "seed" else None
                env.reset(seed=begun, options={"reset_mask": mask})
                for world in chosen:
                    world.begin(begun)
        assert env.levels() == [world.plays for world in worlds]


def test_mutations_change_so_many_numbers_and_stay_in_range() -> None:
    env, rng = make(), np.random.default_rng(0)
    (level, *_) = env.levels()
    for count in range(len(DUEL.varied) + 1):
        changed = level.mutated(DUEL, rng, count)
        assert sum(changed.numbers[name] != level.numbers[name] for name in level.numbers) <= count
        assert changed.key == level.key
        check(changed, dict(DUEL.varied))
    assert level.mutated(DUEL, rng, rekey=True).key != level.key
    for count in (-1, 1.0, True):
        with pytest.raises(NumberError, match="an integer >= 0 is needed"):
            level.mutated(DUEL, rng, count)  # type: ignore[arg-type]
    env.set_levels([level.mutated(DUEL, rng, 3, rekey=True) for _ in range(6)])
    env.reset()
    assert len({each.key for each in env.levels()}) == 6


def test_levels_of_worlds_are_levels_for_worlds(tmp_path: Path) -> None:
    layouts = [outlast.levels.FloorPlan(walls=[(0, 0.1 * k, 4, 0.3, 0.7)]).layout() for k in (1, 2, 3)]
    walls = outlast.systems.Walls(layout=layouts[0])
    scenario = outlast.variant("ffa_2").with_(walls).vary(walls_layout=choice(*layouts), motors_ahead=choice(0.1, 0.3))
    env, other = (outlast.make_vec(scenario, 6, seed=seed) for seed in (3, 4))
    env.reset(), other.reset()
    levels.save(tmp_path / "levels.json", scenario, env.levels())
    for give in (
        lambda: other.set_numbers({name: env.numbers()[name] for name, _ in scenario.varied}),
        lambda: other.set_levels(env.levels()),
        lambda: other.set_levels(levels.load(tmp_path / "levels.json", scenario)),
    ):
        give()
        other.reset()
        for name, _ in scenario.varied:
            np.testing.assert_array_equal(env.numbers()[name], other.numbers()[name])
    with pytest.raises(NumberError, match=r"motors_ahead = 0.2: it varies as choice\(0.1, 0.3\)"):
        other.set_numbers(motors_ahead=0.2)


@pytest.mark.parametrize(
    ("change", "error", "reason"),
    [
        ({"seed": 3}, ScenarioError, "it has 'seed'"),
        ({"numbers": {"melee_damage": math.nan}}, NumberError, "level 0: melee_damage"),
        ({"numbers": {"melee_damage": 10**400}}, NumberError, "level 0"),
        ({"numbers": {"melee_reach": 2}}, NumberError, "does not vary here"),
        ({"key": [1, 2]}, ScenarioError, "seed, world and episode are needed"),
        ({"key": [1, 2, 0]}, ScenarioError, "needed, from 0, 0 and 1"),
    ],
)
def test_files_that_are_none_are_refused(tmp_path: Path, change: Any, error: Any, reason: str) -> None:
    path, given = tmp_path / "levels.json", [Level({"melee_damage": 5, "agents_count": 3}, (1, 2, 3))]
    levels.save(path, DUEL, given)
    assert levels.load(path, DUEL) == given
    content = json.loads(path.read_text())
    path.write_text(json.dumps(content | {"levels": [content["levels"][0] | change]}))
    with pytest.raises(error, match=reason):
        levels.load(path, DUEL)


def test_levels_are_made_of_plain_values() -> None:
    radii = (12, 9, 7, 5, 4, 2, 1)
    """Equal levels are one key, as buffers of levels need them, whatever the order of their numbers."""
    level = Level({"melee_damage": np.int64(7), "safe_zone_radii": np.array(radii)}, tuple(np.arange(3)))
    assert level == Level({"melee_damage": 7, "safe_zone_radii": list(radii)}, (0, 1, 2))
    assert level.numbers["safe_zone_radii"] == radii
    assert {level: 0.5}[Level({"safe_zone_radii": radii, "melee_damage": 7}, (0, 1, 2))] == 0.5
    assert {type(each) for each in (*level.key, level.numbers["melee_damage"])} == {int}  # type: ignore[misc]


def test_recordings_and_states_keep_levels_that_wait(tmp_path: Path) -> None:
    env = outlast.make_vec(DUEL, 6, seed=3)
    outlast.record(env, tmp_path / "a.rec")
    env.reset()
    for level in (Level({"agents_count": 3}), Level({"agents_count": 3}, (7, 5, 2))):
        for k in range(3):
            env.set_levels([level])
            env.set_numbers({"melee_damage": 7 + k}, mask=np.arange(6) < 3)
            state = env.get_state()
            played(env, k)
            env.reset()
    block = env.worlds.block.copy()
    env.close()
    replay = outlast.Replay(outlast.Recording.open(tmp_path / "a.rec"))
    assert list(replay.ticks())
    np.testing.assert_array_equal(replay.worlds.block, block)
    other = make(seed=8)
    other.set_state(state)
    other.reset()
    assert {each.key for each in other.levels()} == {(7, 5, 2)}


def test_keys_that_are_none_are_refused_in_states() -> None:
    env = make()
    state = env.get_state()
    state.arrays["world"][1].view(np.uint64)[4 + env.worlds.dims["varied words"]] = 2
    with pytest.raises(StateError, match="the key of random numbers in world 1 is invalid"):
        env.set_state(state)


PLAN = FloorPlan(walls=[(-4, 0, 0.5, 8), (4, 0, 0.5, 8, 0.6)])
WALLED = outlast.variant("ffa_3").with_(PLAN.mechanic(6)).vary(walls_layout=free(PLAN.layout(6)))


def test_free_layouts_are_any_that_is_given(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    plans = [
        FloorPlan(walls=[(*rng.uniform(-9, 9, 2), 0.5, 3, rng.uniform(0, 3)) for _ in range(count)])
        for count in (1, 3, 6)
    ]
    given = [Level({"walls_layout": plan.layout(6)}, (5, k, 1)) for k, plan in enumerate(plans)]
    levels.save(tmp_path / "walls.json", WALLED, given)
    assert levels.load(tmp_path / "walls.json", WALLED) == given
    env = outlast.make_vec(WALLED, 4, seed=0)
    env.set_levels(given, mask=[False, True, True, True])
    env.reset()
    found = [FloorPlan.of_world(env.worlds, w) for w in range(4)]
    for plan, expected in zip(found, [PLAN, *plans], strict=True):
        np.testing.assert_allclose(plan.walls, expected.walls, atol=1e-6)
    for w, plan in enumerate(plans, 1):  # as if the plan were that of the scenario
        alone = outlast.make_vec(outlast.variant("ffa_3").with_(plan.mechanic(6)), 1, seed=5, first_world=w - 1)
        alone.reset()
        np.testing.assert_array_equal(env.worlds[Body].x[w], alone.worlds[Body].x[0])
        env.set_state(env.get_state())
    env.reset()
    assert len(FloorPlan.of_world(env.worlds, 2).walls) == 2  # for one episode


def test_observations_of_free_numbers_and_of_words_are_within_their_bounds() -> None:
    game = WALLED.vary(cameras_cone=choice("sector", "kite"), melee_blocked=choice(True, False)).observe_numbers()
    far = FloorPlan(walls=[(9.5, -9.5, 0.5, 0.5)]).layout(6)
    for in_units in (True, False):
        env = outlast.make_vec(game, 1, seed=0, scaled=not in_units)
        env.set_levels([Level({"walls_layout": far, "cameras_cone": "kite", "melee_blocked": True})])
        observations, _ = env.reset()
        assert env.observation_space.contains(observations)
        fields = env.fields["numbers"]
        assert [(fields[key].low, fields[key].high) for key in ("cameras_cone", "melee_blocked")] == [(0, 1)] * 2
        place = fields["walls_layout"].start
        found = observations["numbers"][0, 0, place : place + 36] * (1 if in_units else fields["walls_layout"].scale)
        np.testing.assert_allclose(found, far, rtol=1e-6)


Env = SurvivalVectorEnv
PLANS = [FloorPlan(walls=[(3.0 * k, 1, 0.5, 6, 0.1 * k)]) for k in range(3)]
ROLES = {"hunter": role(1, melee_damage=20), "prey": role(agents_health=integers(40, 60))}
GAME = (
    outlast.variant("teams_3")
    .with_(PLANS[0].mechanic(3))
    .vary(
        n_agents=integers(2, 4),
        motors_ahead=log_uniform(0.1, 0.5),
        cameras_cone=choice("sector", "kite"),
        melee_blocked=choice(True, False),
        walls_layout=free(PLANS[0].layout(3)),
    )
    .roles(**ROLES, drawn="anyone")
)
NAN = math.nan


@pytest.fixture(scope="module")
def pair() -> list[Env]:
    return [outlast.make_vec(GAME, 3, seed=0) for _ in range(2)]


OUTSIDE = FloorPlan(walls=[(12, 0, 4, 1)]).layout(3)
OVERLAPPING = FloorPlan(starts=[(0, 0, 0, 4, 4), (1, 1, 1, 4, 4)]).layout(3)
BELOW = (0.0, 0, -1, 1, 0, 0) * 3
NO_FLOOR = FloorPlan(walls=[(0, 0, 24.9, 24.9)]).layout(3)
SET: list[tuple[dict[Any, Any], str]] = [  # what set_numbers refuses, and with which words
    ({"motors_ahead": np.full((3, 1), 0.2)}, "motors_ahead = (0.2,): it varies as log_un"),
    ({"motors_ahead": [0.2] * 4}, "4 values; give one, or one for each of the 3"),
    ({"motors_ahead": [0.2, NAN, 0.2]}, "motors_ahead = nan: it varies as log"),
    ({"n_agents": True}, "agents_count = True: it varies as integers"),
    ({"cameras_cone": "round"}, "'round': it varies as choice('sect"),
    ({"melee_damage": 3}, "roles differ in it; make new worlds"),
    ({"n_agents": 2, "agents_count": 3}, "agents_count is given twice"),
    ({1: 2}, "has no number '1'"),
    ({"n_agents": 2, "melee_reach": -1}, "melee.reach = -1"),
    ({"mask": [True] * 3, "rewards_kill": 1.5}, "rewards_kill is the same in all worlds: leave out the mask"),
    ({"mask": [True], "n_agents": 2}, "mask must be bool, of shape (3,)"),
    ({"walls_layout": (0.0,) * 6}, "18 finite numbers are needed"),
    ({"walls_layout": OUTSIDE}, "rectangle 0 at (12, 0) reaches to (14, 0.5), outside of the room"),
]
PLAYED: list[tuple[Any, str]] = [  # what set_levels refuses
    ([Level({"walls_layout": NO_FLOOR})], "walls.layout leaves 0 square metres where agents can be"),
    ([Level({"walls_layout": OVERLAPPING})], "overlaps that of side 0 at (0, 0); move them apart"),
    ([], "0 levels for 3 worlds: one, or as many, are needed"),
    (Level(), "a list of outlast.levels.Level is needed"),
    ([Level(), {}, Level()], "level 1 is {}: an outlast.levels.Level is needed"),
    ([Level({"n_agents": 2}, (1, 2, 3)), Level(), Level({"motors_ahead": 9})], "take its full name, agents_count"),
    ([Level(key=(1, 2, 3)), Level(), Level({"motors_ahead": 9})], "level 2: motors_ahead = 9: it varies as"),
]


def give(env: Env, given: Any) -> None:
    if isinstance(given, dict):
        env.set_numbers({name: value for name, value in given.items() if name != "mask"}, mask=given.get("mask"))
    else:
        env.set_levels(given)


@pytest.mark.parametrize(("given", "words"), [*SET, *PLAYED])
def test_what_cannot_be_given_in_an_episode_changes_nothing(pair: list[Env], given: Any, words: str) -> None:
    refuses(pair, lambda env: give(env, given), ValueError if words.startswith("mask") else NumberError, words)


def test_numbers_of_no_episode_are_an_error() -> None:
    env = outlast.make_vec("ffa_2", 2)
    assert env.numbers() == env.scenario.numbers()
    with pytest.raises(NotResetError, match=r"numbers\(\) before reset\(\): those that differ are of the episodes"):
        outlast.make_vec(GAME, 2).numbers()
    with pytest.raises(NotResetError, match=r"levels\(\) before reset"):
        outlast.make_vec(GAME, 2).levels()
    with pytest.raises(NumberError, match="take seeds"):
        env.set_levels([Level()])


def test_what_is_given_in_an_episode_waits_for_the_next_one() -> None:
    pair = [outlast.make_vec(GAME, 3, seed=0) for _ in range(2)]
    begin(pair)
    numbers = {"n_agents": [2, 4, 3], "motors_ahead": 0.4, "cameras_cone": "kite", "walls_layout": PLANS[2].layout(3)}
    pair[0].set_numbers(numbers)
    pair[0].set_levels([Level(key=(1, 2, 3))], mask=[False, False, True])
    rng = np.random.default_rng(2)
    for _ in range(4):
        actions = draw_actions(pair[0], rng)
        one, two = (env.step(actions) for env in pair)
        for mine, its in zip([*one[0].values(), *one[1:4]], [*two[0].values(), *two[1:4]], strict=True):
            np.testing.assert_array_equal(mine, its)
        note = pair[0].worlds[Given].words.copy()
        pair[0].worlds[Given].words[:] = pair[1].worlds[Given].words
        assert digest(pair[0].worlds) == digest(pair[1].worlds)
        pair[0].worlds[Given].words[:] = note
    pair[0].reset()
    now = pair[0].numbers()
    assert now["agents_count"].tolist() == [2, 4, 3]
    assert set(now["cameras_cone"].tolist()) == {"kite"}
    np.testing.assert_array_equal(now["walls_layout"], np.float32([PLANS[2].layout(3)] * 3))
    assert pair[0].levels()[2].key == (1, 2, 3)


MADE: list[tuple[Callable[[], Any], str]] = [
    (lambda: GAME.vary(n_agents=integers(2, 3), agents_count=integers(2, 4)), "agents_count is given twice"),
    (lambda: outlast.make_vec(GAME.vary(walls_layout=choice(PLANS[0].layout(3), OUTSIDE)), 1), "(12, 0) reaches to"),
    (lambda: GAME.vary(rewards_kill=integers(2**24 - 1, 2**24 + 1)), "cannot hold integers above 16777216 exact"),
    (lambda: GAME.replace(melee_damage=integers(1, 5)), "a value is needed; Scenario.vary lets it differ from"),
    (lambda: levels.save("a.json", GAME, [Level(), Level({"agents_count": 9})]), "level 1: agents_count"),
    (lambda: levels.save("a.json", GAME, [Level({"motors_ahead": object()})]), "level 0: motors_ahead"),
    (lambda: levels.save("a.json", GAME, [Level(), 3]), "level 1 is 3"),
    (lambda: levels.save("a.json", GAME, [Level({"walls_layout": BELOW})]), "rectangle 0 at (0, 0) is -1 x 1 m"),
    (lambda: Level({"speed": 3}).mutated(GAME, np.random.default_rng(0)), "speed does not vary here; these do: agents"),
    (lambda: Level().mutated(GAME, 0), "rng = 0: a generator is needed, as np.random"),
    *((lambda key=key: Level({}, key), "seed, world and episode are needed")
      for key in ((1, 2), (1, 2, 3.0), (1, 2, 2**64), "abc")),
    *((lambda numbers=numbers: Level(numbers), "values by name are needed") for numbers in (None, [3])),
    (lambda: outlast.variant("ffa_3").vary(safe_zone_radii=free((5, 4))), "does not declare"),
    (lambda: free((1, math.inf)), "a tuple of finite numbers"),
    (lambda: uniform(2, 1), "the first must be below the second"),
    (lambda: log_uniform(0, 1), "the lower end must be above 0"),
    (lambda: integers(1.5, 2), "two integers are needed"),
    (lambda: choice(1), "2 to 65536"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "words"), MADE)
def test_what_cannot_be_made_is_refused(
    make: Callable[[], Any], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(NumberError) as raised:
        make()
    assert words in str(raised.value)
    assert not list(tmp_path.iterdir())


def files(tmp_path: Path) -> dict[str, tuple[dict[str, Any], Callable[[Path], Any]]]:
    levels.save(tmp_path / "levels", GAME, [Level({"agents_count": 2}, (1, 2, 3))])
    PLANS[0].save(tmp_path / "plan")
    contents = {name: json.loads((tmp_path / name).read_text()) for name in ("levels", "plan")}
    assert GAME.by_role
    return {
        "levels": (contents["levels"], lambda path: levels.load(path, GAME)),
        "plan": (contents["plan"], FloorPlan.load),
        "scenario": (json.loads(GAME.to_json()), outlast.Scenario.load),
        "roles": (plain_roles(GAME.by_role), lambda path: with_roles(GAME, path)),
    }


@pytest.mark.parametrize("kind", ["levels", "plan", "scenario", "roles"])
def test_json_of_another_version_or_shape_is_refused(kind: str, tmp_path: Path) -> None:
    content, read = files(tmp_path)[kind]
    path = tmp_path / "file.json"
    path.write_text(json.dumps(content))
    read(path)
    if "version" in content:
        path.write_text(json.dumps(content | {"version": 99}))
        with pytest.raises(ScenarioError, match="version 99"):
            read(path)
    for key in content.keys() - {"about", "varied", "observed", "origin", "added", "width", "height"}:
        path.write_text(json.dumps({name: value for name, value in content.items() if name != key}))
        if kind == "scenario" and key == "roles":
            continue  # one without roles
        with pytest.raises((ScenarioError, NumberError)):
            read(path)
        for other in (7, "x", [7], {"x": 7}, None):
            path.write_text(json.dumps(content | {key: other}))
            if key == "name" and other == "x":
                continue
            with pytest.raises((ScenarioError, NumberError)):
                read(path)

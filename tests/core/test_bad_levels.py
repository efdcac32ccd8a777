"""What levels cannot be: each error names it, says what was expected, and leaves worlds and files as they were."""

import json
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import FloorPlan, Level, ScenarioError, choice, integers, levels, log_uniform, role, uniform
from outlast.ecs import NumberError
from outlast.ecs.declarations.roles import plain
from outlast.ecs.memory.numbers import Given
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import NotResetError
from outlast.envs.scenarios.roles_file import with_roles
from tests.conftest import digest, draw_actions

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
        walls_layout=outlast.free(PLANS[0].layout(3)),
    )
    .roles(**ROLES, drawn="anyone")
)
NAN = math.nan


@pytest.fixture(scope="module")
def pair() -> Iterator[tuple[Env, Env]]:
    """Two equal environments: one gets the bad input, the other does not."""
    yield (one := outlast.make_vec(GAME, 3, seed=0)), (other := outlast.make_vec(GAME, 3, seed=0))
    one.close(), other.close()


def begin(pair: tuple[Env, Env]) -> None:
    """Bring both into the middle of an episode."""
    rng = np.random.default_rng(1)
    for env in pair:
        env.set_numbers(dict.fromkeys((name for name, _ in GAME.varied), None))
        env.reset(seed=4)
    for actions in (draw_actions(pair[0], rng) for _ in range(3)):
        for env in pair:
            env.step(actions)


def stay_equal(pair: tuple[Env, Env], reset: bool = True) -> None:
    """In the next steps, and in the next episode."""
    rng = np.random.default_rng(2)
    for tick in range(4):
        actions = draw_actions(pair[0], rng)
        for env in pair:
            env.step(actions) if tick != 2 or not reset else env.reset()
        assert digest(pair[0].worlds) == digest(pair[1].worlds)


OUTSIDE = FloorPlan(walls=[(12, 0, 4, 1)]).layout(3)
OVERLAPPING = FloorPlan(starts=[(0, 0, 0, 4, 4), (1, 1, 1, 4, 4)]).layout(3)
BELOW = (0.0, 0, -1, 1, 0, 0) * 3
NO_FLOOR = FloorPlan(walls=[(0, 0, 24.9, 24.9)]).layout(3)
SET: list[tuple[dict[Any, Any], str]] = [  # what set_numbers refuses, and with which words
    ({"motors_ahead": np.full((3, 1), 0.2)}, "motors_ahead = (0.2,): it varies as log_un"),
    ({"motors_ahead": [0.2] * 4}, "4 values; give one, or one for each of the 3"),
    ({"motors_ahead": []}, "0 values; give one, or one for each of the 3"),
    ({"motors_ahead": [0.2, NAN, 0.2]}, "motors_ahead = nan: it varies as log"),
    ({"motors_ahead": [0.2, None, 0.2]}, "motors_ahead = None"),
    ({"motors_ahead": 10**400}, "it varies as"),
    ({"n_agents": True}, "agents_count = True: it varies as integers"),
    ({"cameras_cone": "round"}, "'round': it varies as choice('sect"),
    ({"melee_damage": 3}, "roles differ in it; make new worlds"),
    ({"n_agents": 2, "agents_count": 3}, "agents_count is given twice"),
    ({1: 2}, "has no number '1'"),
    ({"n_agents": 2, "motors_ahead": 9}, "motors_ahead = 9: it varies as"),
    ({"n_agents": 2, "melee_reach": -1}, "melee.reach = -1"),
    ({"mask": [True] * 3, "rewards_kill": 1.5}, "rewards_kill is the same in all worlds: leave out the mask"),
    ({"mask": [True], "n_agents": 2}, "mask must be bool, of shape (3,)"),
    ({"walls_layout": (0.0,) * 6}, "18 finite numbers are needed"),
    ({"walls_layout": ((1.0,), *[0.0] * 17)}, "18 finite numbers"),
    ({"walls_layout": OUTSIDE}, "rectangle 0 at (12, 0) reaches to (14, 0.5), outside of the room"),
    ({"walls_layout": PLANS[0]}, "FloorPlan(1 walls, 0 start areas): it va"),
]
PLAYED: list[tuple[Any, str]] = [  # what set_levels refuses
    ([Level({"walls_layout": NO_FLOOR})], "walls.layout leaves 0 square metres where agents can be"),
    ([Level({"walls_layout": OVERLAPPING})], "overlaps that of side 0 at (0, 0); move them apart"),
    ([], "0 levels for 3 worlds: one, or as many, are needed"),
    ([Level()] * 2, "2 levels for 3 worlds"),
    (Level(), "a list of outlast.Level is needed"),
    ([Level(), {}, Level()], "level 1 is {}: an outlast.Level is needed"),
    ([Level({"n_agents": 2}, (1, 2, 3)), Level(), Level({"motors_ahead": 9})], "take its full name, agents_count"),
    ([Level(key=(1, 2, 3)), Level(), Level({"motors_ahead": 9})], "level 2: motors_ahead = 9: it varies as"),
]


def give(env: Env, given: Any) -> None:
    """Set levels, or numbers, of the worlds of a mask if there is one."""
    if isinstance(given, dict):
        env.set_numbers({name: value for name, value in given.items() if name != "mask"}, mask=given.get("mask"))
    else:
        env.set_levels(given)


@pytest.mark.parametrize(("given", "words"), [*SET, *PLAYED])
def test_what_cannot_be_given_in_an_episode_changes_nothing(pair: tuple[Env, Env], given: Any, words: str) -> None:
    begin(pair)
    before = digest(pair[0].worlds)
    with pytest.raises(ValueError if words.startswith("mask") else NumberError) as raised:
        give(pair[0], given)
    assert words in str(raised.value)
    assert digest(pair[0].worlds) == before
    stay_equal(pair)


def test_numbers_of_no_episode_are_an_error() -> None:
    env = outlast.make_vec("ffa_2", 2)
    assert env.numbers() == env.scenario.numbers()
    with pytest.raises(NotResetError, match=r"numbers\(\) before reset\(\): those that differ are of the episodes"):
        outlast.make_vec(GAME, 2).numbers()
    with pytest.raises(NotResetError, match=r"levels\(\) before reset"):
        outlast.make_vec(GAME, 2).levels()
    with pytest.raises(NumberError, match="seeds decide"):
        env.set_levels([Level()])


def test_what_is_given_in_an_episode_waits_for_the_next_one(pair: tuple[Env, Env]) -> None:
    """The running one goes on as it would have, to the bit, but for the note of what is given."""
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
    (lambda: GAME.vary(room_thickness=uniform(0.1, 0.9)), "room.thickness = 0.9: must be"),
    (lambda: GAME.vary(n_agents=integers(2, 3), agents_count=integers(2, 4)), "agents_count is given twice"),
    (lambda: GAME.vary(melee_reach=choice(1.0, NAN)), "melee.reach = nan: a finite number"),
    (lambda: GAME.roles(**ROLES, observed="no"), "observed = 'no': allowed are True and False"),
    (
        lambda: outlast.make_vec(GAME.vary(walls_layout=choice(PLANS[0].layout(3), OUTSIDE)), 1),
        "(12, 0) reaches to (14, 0",
    ),
    (
        lambda: GAME.vary(rewards_kill=integers(2**24 - 1, 2**24 + 1)),
        "float32, which has no integer above 16777216 exact",
    ),
    (
        lambda: GAME.replace(melee_damage=integers(1, 5)),
        "a value is needed; Scenario.vary lets it differ from world to",
    ),
    (lambda: levels.save("a.json", GAME, Level()), "a list of outlast.Level is needed"),
    (
        lambda: levels.save("a.json", GAME, [Level(), Level({"walls_layout": BELOW})]),
        "rectangle 0 at (0, 0) is -1 x 1 m",
    ),
    (
        lambda: Level({"speed": 3}).mutated(GAME, np.random.default_rng(0)),
        "speed does not vary here; these do: agents_co",
    ),
    (lambda: Level().mutated(GAME, 0), "rng = 0: a generator is needed, as np.random"),
    (lambda: Level({}, (1, 2)), "seed, world and episode are needed"),
    (lambda: Level({}, (1, 2, 3.0)), "seed, world and episode are needed"),
    (lambda: Level({}, (1, 2, 2**64)), "seed, world and episode are needed"),
    (lambda: Level({}, "abc"), "seed, world and episode are needed"),
    (lambda: Level(None), "values by name are needed"),
    (lambda: Level([3]), "values by name are needed"),
    (lambda: outlast.variant("ffa_3").vary(safe_zone_radii=outlast.free((5, 4))), "does not declare"),
    (lambda: outlast.free(3.0), "a tuple of finite numbers"),
    (lambda: outlast.free((1, math.inf)), "a tuple of finite numbers"),
    (lambda: uniform(2, 1), "the first must be below the second"),
    (lambda: uniform(0, math.inf), "two finite numbers are needed"),
    (lambda: log_uniform(0, 1), "the lower end must be above 0"),
    (lambda: integers(1.5, 2), "two integers are needed"),
    (lambda: choice(1), "2 to 65536"),
]


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
    """What each kind of file holds, and how it is read."""
    levels.save(tmp_path / "levels", GAME, [Level({"agents_count": 2}, (1, 2, 3))])
    PLANS[0].save(tmp_path / "plan")
    contents = {name: json.loads((tmp_path / name).read_text()) for name in ("levels", "plan")}
    assert GAME.by_role
    return {
        "levels": (contents["levels"], lambda path: levels.load(path, GAME)),
        "plan": (contents["plan"], FloorPlan.load),
        "scenario": (json.loads(GAME.to_json()), outlast.Scenario.load),
        "roles": (plain(GAME.by_role), lambda path: with_roles(GAME, path)),
    }


@pytest.mark.parametrize("kind", ["levels", "plan", "scenario", "roles"])
def test_json_of_another_version_or_shape_is_refused(kind: str, tmp_path: Path) -> None:
    """By the name of what is wrong with it, for each key in turn."""
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


def test_levels_that_could_not_be_read_are_not_written(tmp_path: Path) -> None:
    path = tmp_path / "levels.json"
    levels.save(path, GAME, [Level({"agents_count": np.int64(2), "motors_ahead": np.float32(0.2)})])
    before = path.read_text()
    assert levels.load(path, GAME) == [Level({"agents_count": 2, "motors_ahead": float(np.float32(0.2))})]
    wrong = ({"agents_count": 9}, {"motors_ahead": NAN}, {"motors_ahead": object()}, {"melee_reach": 1.0})
    cases: list[Any] = [([Level(), Level(each)], f"level 1: {next(iter(each))}") for each in wrong]
    cases += [([Level({"n_agents": 3})], "level 0: n_agents does not"), ([Level(), 3], "level 1 is 3")]
    for given, reason in cases:
        with pytest.raises(NumberError, match=reason):
            levels.save(path, GAME, given)
        assert path.read_text() == before

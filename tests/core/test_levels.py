"""Numbers and counts that differ from world to world: each world is the game that has them, whatever the others are."""

import math
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import systems
from outlast.distributions import choice, integers, log_uniform, uniform
from outlast.ecs import Clock, Component, Entity, NumberError
from outlast.ecs.memory.numbers import Given, Varied
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import StateError
from outlast.envs.scenarios.scenario import Scenario
from tests.conftest import COMPILED, draw_actions, few_by_day, scaled
from tests.reference.random_numbers import keyed

TEAMS = outlast.variant("teams_4").vary(
    n_agents=integers(2, 6),
    n_heals=integers(1, 15),
    n_boxes=integers(1, 8),
    agents_health=integers(30, 60),
    agents_radius=uniform(0.3, 0.6),
    cameras_fov=log_uniform(0.5, 1.5),
    cameras_cone=choice("sector", "kite"),
    melee_blocked=choice(True, False),
    melee_damage=integers(5, 20),
    safe_zone_radii=choice((12.5, 10, 7.5, 5, 4, 2, 1), (12, 9, 7, 5, 4, 2, 1)),
    ending_limit=integers(60, 90),
)
ROLES = {
    "hunter": outlast.role(1, melee_damage=integers(15, 25), agents_health=80, cameras_depth=uniform(8, 14)),
    "prey": outlast.role(agents_health=integers(20, 40), pickup_reach=1.5),
}
COUNTS = outlast.variant("teams_4").vary(
    n_agents=integers(2, 6),
    n_heals=integers(1, 15),
    n_boxes=integers(1, 8),
    agents_radius=uniform(0.3, 0.5),
    motors_ahead=log_uniform(0.1, 0.5),
    safe_zone_damage=integers(0, 3),
    ending_limit=integers(12, 24),
)
MIXED = COUNTS.roles(**ROLES, drawn="anyone")
PLANS = [
    outlast.levels.FloorPlan(
        walls=[(3 * k - 8, 3, 0.5, 6), (-6, -5, 4, 1 + k / 4, 0.2 * k), (6, k - 9, 3, 0.5, 1.0)],
        starts=[(0, -10, 0, 3, 14), (1, 10, 0, 3, 10 + k)],
    )
    for k in range(6)
]
GAMES: dict[str, Scenario] = {
    "numbers": TEAMS.replace(ending_limit=20).vary(ending_limit=integers(12, 24)),
    "mazes": MIXED.with_(systems.Maze(blocks=40)).vary(
        maze_columns=integers(2, 6),
        maze_rows=integers(2, 6),
        maze_loops=uniform(0, 1),
        maze_thickness=uniform(0.2, 0.5),
    ),
    "rooms": MIXED.with_(systems.Rooms(blocks=24)).vary(
        rooms_columns=integers(1, 3), rooms_rows=integers(1, 3), rooms_doors=uniform(0, 1), rooms_door=uniform(1.2, 2)
    ),
    "pillars": MIXED.with_(systems.Pillars()).vary(pillars_count=integers(1, 12), pillars_least=uniform(0.5, 1.5)),
    "floor plans": COUNTS.roles(**ROLES, drawn="side")
    .with_(PLANS[0].mechanic(5))
    .vary(walls_layout=choice(*(plan.layout(5) for plan in PLANS))),
}
WORLDS, STEPS, SAMPLE = scaled(1024, least=4), scaled(36, least=5), scaled(20, least=4)
REFERRING = {"Gift", "Item", "Bag", "Weapon", "Died", "Health", "BoxItem", "Sight", "Cells"}  # they hold rows or sizes


def make(scenario: Scenario = TEAMS, count: int = 8, **options: Any) -> SurvivalVectorEnv:
    env = outlast.make_vec(scenario, count, seed=3, **options)
    env.reset()
    return env


def fixed(scenario: Scenario, numbers: dict[str, Any], w: int) -> Scenario:
    own = {name: tuple(values[w].tolist()) if values.ndim > 1 else values[w].item() for name, values in numbers.items()}
    return scenario.replace(**own)


def same_entities(one: SurvivalVectorEnv, w: int, other: SurvivalVectorEnv) -> None:
    """Who is in world w of one is as in the only world of the other, and nobody else is there."""
    for name in one.worlds.layout.archetypes:
        mine, its = one.worlds.span(name), other.worlds.span(name)
        count = its.stop - its.start
        assert not one.worlds[Entity].alive[w, mine][count:].any()
        assert (one.worlds[Entity].identity[w, mine][count:] == -1).all()
        for component in one.worlds.components:
            if component.__mro__[1] is Component and component.__name__ not in REFERRING:
                for column in component.columns:
                    values = getattr(one.worlds[component], column)[w, mine][:count]
                    np.testing.assert_array_equal(values, getattr(other.worlds[component], column)[0, its], column)


def compare_with_worlds_alone(scenario: Scenario, chosen: Any) -> None:
    """Some worlds of a batch of 1024, each with a batch of one world in which its numbers are fixed.

    What was drawn is then set, so that episodes behind the first one have the same numbers, and another layout.
    """
    many, rng = make(scenario, WORLDS), np.random.default_rng(0)
    numbers = {name: values for name, values in many.numbers().items() if name in dict(scenario.varied)}
    assert all(len(np.unique(values, axis=0)) > 1 for values in numbers.values())
    many.set_numbers(numbers)
    played = [(actions := draw_actions(many, rng)[chosen], play(many, chosen, actions)) for _ in range(STEPS)]
    for k, w in enumerate(chosen.tolist()):
        one = make(fixed(scenario, numbers, w), 1, first_world=w)
        there = one.num_agents
        assert there == numbers["agents_count"][w]
        for actions, (observations, rewards, terminated, truncated, info) in played:
            mine = one.step(actions[k : k + 1, :there])
            np.testing.assert_array_equal(rewards[k, :there], mine[1][0])
            assert not rewards[k, there:].any()
            assert (terminated[k], truncated[k]) == (mine[2][0], mine[3][0])
            assert info["present"][k].tolist() == [i < there for i in range(many.num_agents)]
            for key, values in mine[0].items():
                own = observations[key][k]
                np.testing.assert_array_equal(own[tuple(map(slice, values[0].shape))], values[0], key)
                assert not own[there:].any()
        assert one.worlds[Clock].episode[0, 0] > 1 or not COMPILED
        same_entities(many, w, one)


def play(env: SurvivalVectorEnv, chosen: Any, actions: Any) -> Any:
    """A step in which all others do nothing: what it returns of the chosen worlds."""
    all_actions = np.tile(env.noop, (env.num_worlds, env.num_agents, 1))
    all_actions[chosen] = actions
    observations, *signals, info = env.step(all_actions)
    own = {key: values[chosen] for key, values in observations.items()}
    return own, *(values[chosen] for values in signals), {"present": info["present"][chosen]}


@pytest.mark.parametrize("game", few_by_day(GAMES, ("mazes",)))
def test_every_world_is_the_game_that_has_its_numbers(game: str) -> None:
    compare_with_worlds_alone(GAMES[game], np.linspace(0, WORLDS - 1, SAMPLE).astype(int))


def test_draws_are_those_of_the_random_numbers_by_name() -> None:
    share = lambda word: (word >> 11) / 2**53  # noqa: E731
    low, high = math.log(0.1), math.log(0.4)
    drawn = {
        "melee_reach": (uniform(1, 3), lambda word: np.float32(1 + share(word) * 2)),
        "motors_ahead": (log_uniform(0.1, 0.4), lambda word: np.float32(math.exp(low + share(word) * (high - low)))),
        "melee_damage": (integers(2, 5), lambda word: 2 + (word * 4 >> 64)),
        "heals_amount": (choice(1, 1, 40), lambda word: (1, 1, 40)[word * 3 >> 64]),
    }
    env = make(outlast.variant("ffa_1").vary(**{name: each for name, (each, _) in drawn.items()}), 64)
    for episode in (1, 2):
        for name, (_, value) in drawn.items():
            words = [keyed((3, w, episode), 0, f"vary {name}", 0)[0] for w in range(64)]
            assert env.numbers()[name].tolist() == [value(word) for word in words]
        env.reset()


def test_numbers_are_observed_by_all_who_are_there() -> None:
    env = make(TEAMS.observe_numbers("melee_damage", "safe_zone_radii"))
    observations, info = env.reset()
    fields = env.fields["numbers"]
    assert list(fields) == ["melee_damage", "safe_zone_radii"]
    for w, there in enumerate(info["present"].sum(1)):
        row = [info["numbers"]["melee_damage"][w], *info["numbers"]["safe_zone_radii"][w]]
        assert observations["numbers"][w].tolist() == [row] * there + [[0] * len(row)] * (env.num_agents - there)
    assert observations["numbers"] in env.observation_space["numbers"]


def test_statistics_have_the_numbers_of_the_episode() -> None:
    env = make(TEAMS.replace(ending_limit=3).vary(ending_limit=integers(2, 4)), 16)
    numbers = env.numbers()
    for _ in range(4):
        *_, info = env.step(np.tile(env.noop, (16, env.num_agents, 1)))
        if found := info.get("statistics"):
            assert found["melee_blocked"].dtype.kind == "i"  # 0 or 1 in tables, too
            kept = [found[name] == numbers[name] for name in ("melee_damage", "melee_blocked")]
            assert np.all([*kept, found["length"] == found["ending_limit"]], axis=0)[info["_statistics"]].all()


def spoiled(env: SurvivalVectorEnv, component: type[Component], column: str, index: Any, value: Any) -> str:
    state = env.get_state()
    getattr(env.worlds.layout.columns(state.arrays["world"], component), column)[index] = value
    with pytest.raises(StateError) as caught:
        env.set_state(state)
    return str(caught.value)


def test_states_that_no_draw_leads_to_are_refused() -> None:
    env = make()
    count, radius = (env.worlds.layout.varied[name].start for name in ("agents_count", "agents_radius"))
    assert "agents_count in world 0 is not of integers(2, 6)" in spoiled(env, Varied, "words", (0, count), -5)
    assert "agents_count in world 1 is not of" in spoiled(env, Given, "words", (1, count), 1 << 32 | 7)
    assert "agents_count in world 1 is not of" in spoiled(env, Given, "words", (1, count), 3)
    nan = np.float32(np.nan).view(np.int32)
    assert "agents_radius in world 2 is not of uniform(0.3, 0.6)" in spoiled(env, Varied, "words", (2, radius), nan)
    assert "Entity.identity" in spoiled(env, Entity, "identity", (0, 0), -1)


@pytest.mark.parametrize(
    ("numbers", "reason"),
    [
        ({"melee_damage": uniform(1, 2)}, "it has type int, so take integers or choice"),
        ({"melee_damage": integers(-5, 2)}, "melee.damage = -5: must be >= 0"),
        ({"melee_damige": integers(1, 2)}, "did you mean melee_damage"),
        ({"n_agents": integers(0, 3)}, "agents.count = 0: must be >= 1"),
        ({"safe_zone_radii": choice((5, 2), (5,))}, "all tuples must have one length"),
        ({"n_agents": integers(1, 4)}, "2 teams, but there are only 1 agents"),
        ({"n_heals": integers(1, 80)}, "do not fit into spawn_grid.cells"),
        ({"inventory_slots": integers(1, 4)}, "cannot vary: Inventory.dims() reads it when worlds are made"),
    ],
)
def test_what_cannot_vary_is_refused(numbers: dict[str, Any], reason: str) -> None:
    with pytest.raises(NumberError) as caught:
        outlast.variant("teams_4").vary(**numbers).worlds(1).close()
    assert reason in str(caught.value)


def test_values_of_numpy_are_those_of_python_in_files() -> None:
    scenario = outlast.variant("ffa_1").vary(
        motors_ahead=uniform(np.float32(0.1), np.float32(0.3)),
        melee_damage=choice(np.int64(3), 7),
        melee_blocked=choice(np.bool_(True), False),
        safe_zone_radii=choice(np.array([9.0, 4.0]), [8, 3]),
    )
    assert Scenario.from_json(scenario.to_json()) == scenario


def test_deriving_goes_on_as_expected() -> None:
    assert "melee_damage" not in dict(TEAMS.replace(melee_damage=7).varied)
    assert "boxes_count" not in dict(TEAMS.without("boxes").varied)
    given = TEAMS.with_(outlast.systems.Melee(damage=50))
    assert "melee_damage" not in dict(given.varied)
    assert given["melee"].damage == 50
    assert TEAMS.vary(melee_damage=integers(1, 2)).without("heals").observe_numbers().observed == tuple(
        name for name, _ in TEAMS.without("heals").varied
    )
    assert "melee_damage=integers(5, 20)" in TEAMS.about
    large = integers(999_999_937, 10**9)  # float32 has the even ones of 64 only
    assert [each in large for each in (999_999_937, 999_999_936, np.int64(10**9))] == [True, False, True]


@pytest.mark.skipif(not COMPILED, reason="about machine code")
def test_systems_that_read_no_varied_number_are_compiled_as_they_were() -> None:
    sources = [
        {unit.label: unit.source for segment in scenario.worlds(1).segments for unit in segment.units}
        for scenario in (outlast.variant("teams_4"), outlast.variant("teams_4").vary(melee_damage=integers(5, 20)))
    ]
    changed = {label for label in sources[0] if sources[0][label] != sources[1][label]}
    assert changed == {"melee.strike"}
    assert sources[1].keys() - sources[0].keys() == {"numbers"}


@pytest.mark.parametrize("mode", ["masked", "revealed", "omniscient"])
def test_the_absent_are_observed_by_nobody(mode: str) -> None:
    varied = outlast.variant("teams_3").replace(cameras_mode=mode, n_agents=4, ending_limit=3)
    env = make(varied.vary(n_agents=integers(2, 4)), 30)
    for _ in range(9):
        observations, _, _, _, info = env.step(np.tile(env.noop, (30, 4, 1)))
        assert env.observation_space.contains(observations)
        for i in range(4):
            others = np.delete(np.arange(4), i)
            gone = ~info["present"][:, others] | ~info["present"][:, [i]]
            assert not observations["others"][:, i][gone].any()
        assert (~info["present"]).any()

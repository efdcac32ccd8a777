"""Scenarios with roles and unequal teams: the games that they make, what is told of them, and what files keep."""

import json
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast import make_vec, variant
from outlast.ecs import AgentRoles, NumberError
from outlast.envs.core.spaces import side
from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.errors import StateError
from outlast.envs.scenarios.fingerprint import classes, difference, fingerprint, is_fingerprint, rebuilt
from outlast.envs.scenarios.parse import with_roles
from outlast.envs.scenarios.scenario_json import plain_roles, roles_of
from outlast.systems import DropLast, Melee, Teams
from tests.conftest import COMPILED, draw_actions, run, scaled

WORLDS, TICKS = scaled(32, least=3), scaled(300, least=15)
QUICK: dict[str, Any] = {"agents_health": 40, "room_size": 14.0, "safe_zone_radii": (6.0, 3.0), "safe_zone_stand": 30}
ONE_THREE = variant("teams_4").replace(teams_sizes=(1, 3), rewards_kill=5, **QUICK)
HUNT = ONE_THREE.roles(
    hunter=outlast.role(1, melee_damage=20, agents_health=200, agents_radius=0.7, cameras_depth=12, motors_ahead=0.4),
    prey=outlast.role(3, melee_damage=outlast.distributions.integers(0, 2), inventory_capacity=2),
)
DRAWN = variant("ffa_3").replace(n_agents=3, **QUICK).roles(
    strong=outlast.role(1, agents_health=90, cameras_fov=2.0, mortality_limit=90, rewards_alive=2),
    weak=outlast.role(mortality_limit=60, motors_left=outlast.distributions.uniform(0.1, 0.2)),
    drawn="anyone",
)  # fmt: skip
# A value for each number that roles can differ in, unlike that of the variants.
OTHERS: dict[str, Any] = {
    "agents_radius": 0.6, "agents_density": 1.5, "agents_health": 45, "boxes_offset": 1.0, "cameras_fov": 1.0,
    "cameras_depth": 7.0, "death_drop_radius": 0.8, "drop_last_offset": 1.5, "give_last_reach": 3.0,
    "inventory_capacity": 2, "melee_reach": 2.5, "melee_damage": 7, "melee_cooldown": 1, "mortality_limit": 90,
    "motors_ahead": 0.4, "motors_left": 0.3, "motors_turn": 0.02, "pickup_reach": 0.8, "rewards_alive": 2.0,
    "rewards_dead": -2.0, "rewards_kill": 9.0, "rewards_death": -3.0, "rewards_outlive": 1.5, "safe_zone_damage": 2,
}  # fmt: skip


def steps(env: SurvivalVectorEnv, ticks: int = TICKS) -> Iterable[Any]:
    rng = np.random.default_rng(4)
    yield env.reset(seed=3)
    for _ in range(ticks):
        yield env.step(draw_actions(env, rng))


def flat(outcome: Any) -> list[Any]:
    return [*(value for _, value in sorted(outcome[0].items())), *outcome[1:-1]]


def alike(one: Any, other: Any) -> None:
    """AssertionError unless two scenarios play the same game, bit for bit."""
    for first, second in zip(*(steps(make_vec(scenario, WORLDS)) for scenario in (one, other)), strict=True):
        for a, b in zip(flat(first), flat(second), strict=True):
            assert a.dtype == b.dtype
            assert np.array_equal(a, b)


def test_all_numbers_that_can_differ_are_tried_here() -> None:
    scenario = ONE_THREE.with_(DropLast())
    able = {f"{m.name}_{item.name}" for m in scenario.modules for item in fields(m) if item.metadata.get("per_agent")}
    assert able == OTHERS.keys()


def test_a_role_that_all_have_is_the_game_with_its_numbers() -> None:
    """Kernels read the same values from arrays, and so compute the same bits."""
    steering = {"steering_speed": 3.0, "steering_spin": 2.0}
    for scenario, other in (
        (ONE_THREE.with_(DropLast()), OTHERS),
        (variant("ffa_2+steering").replace(**QUICK), steering),
    ):
        alike(scenario.roles(all=outlast.role(**other), observed=False), scenario.replace(**other))


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"teams_sizes": (1, 1, 2)}, r"\(1, 1, 2\) are 3 teams, but teams.count is 2: set both, as in replace"),
        ({"teams_sizes": (1.5, 2.5)}, "1.5 is not a number of agents; take integers"),
        ({"teams_sizes": (0, 4)}, "must be >= 1"),
        ({"teams_sizes": (1, 4)}, r"\(1, 4\) are 5 agents, but n_agents is 4: take replace\(n_agents=5\)"),
    ],
)
def test_impossible_sizes_are_refused(numbers: dict[str, Any], message: str) -> None:
    with pytest.raises(NumberError, match=message):
        make_vec("teams_3", 1, **numbers)


def test_worlds_with_fewer_agents_lack_the_last_ones_of_teams_with_sizes() -> None:
    scenario = variant("teams_3").replace(teams_count=3, teams_sizes=(1, 2, 1))
    scenario = scenario.roles(one=outlast.role(1), other=outlast.role())
    env = make_vec(scenario.vary(n_agents=outlast.distributions.integers(3, 4)), 8, seed=0)
    _, info = env.reset()
    full = info["numbers"]["agents_count"] == 4
    assert 0 < full.sum() < 8
    assert (side(env.worlds) == np.where(full[:, None], [0, 1, 1, 2], [0, 1, 1, -1])).all()
    assert (info["roles"][full] == [0, 1, 1, 1]).all()


SPLIT = variant("teams_3").replace(**QUICK)
STRONG = {"strong": outlast.role(1, melee_damage=20, agents_health=90)}
WEAK = {"weak": outlast.role(motors_left=outlast.distributions.uniform(0.1, 0.2))}
FEWER = {
    "drawn": variant("ffa_3").replace(**QUICK).roles(**STRONG, **WEAK, drawn="anyone"),
    "those left over first": SPLIT.roles(**WEAK, **STRONG),
    "drawn by side": SPLIT.roles(**WEAK, **STRONG, drawn="side"),
}


@pytest.mark.parametrize("name", FEWER)
def test_worlds_with_fewer_agents_have_the_roles_of_a_game_of_their_count(name: str) -> None:
    scenario, rng = FEWER[name].vary(n_agents=outlast.distributions.integers(2, 5)), np.random.default_rng(0)
    env = make_vec(scenario, 8, seed=3)
    _, first = env.reset()
    played = [(actions := draw_actions(env, rng), env.step(actions)) for _ in range(TICKS // 10)]
    for w, count in enumerate(first["numbers"]["agents_count"].tolist()):
        one = make_vec(FEWER[name].replace(n_agents=count), 1, seed=3, first_world=w)
        _, info = one.reset()
        assert first["roles"][w].tolist() == info["roles"][0].tolist() + [-1] * (first["roles"].shape[1] - count)
        for actions, outcome in played:
            own = one.step(actions[w : w + 1, :count])
            for mine, its in zip(flat(own), flat(outcome), strict=True):
                np.testing.assert_array_equal(mine[0], its[w][tuple(map(slice, mine[0].shape))])
            if own[2][0] or own[3][0]:
                break
        one.close()
    env.close()


def test_sides_are_called_by_roles_that_are_theirs_in_all_worlds() -> None:
    scenario = SPLIT.roles(hunter=outlast.role(2), prey=outlast.role())
    assert make_vec(scenario, 1).sides == ("hunter", "prey")
    assert make_vec(scenario.vary(n_agents=outlast.distributions.integers(3, 4)), 1).sides == ("team 0", "team 1")
    sizes = outlast.distributions.choice((1, 3), (2, 2))
    assert make_vec(scenario.vary(teams_sizes=sizes), 1).sides == ("team 0", "team 1")
    with pytest.raises(NumberError, match='drawn = "side", but the sizes of teams vary'):
        make_vec(SPLIT.roles(**STRONG, **WEAK, drawn="side").vary(teams_sizes=sizes), 1)


def test_agents_observe_roles() -> None:
    """In spaces of the widest range of all roles: each of them may use heals up to a limit of its own."""
    env = make_vec(DRAWN, WORLDS, seed=1)
    role, health = (env.fields["own"][name].columns for name in ("role", "health"))
    assert (env.single_observation_space["own"].high[:, health] == 90).all()
    for observations, *_, info in steps(env):
        assert (observations["own"][..., role].argmax(-1) == info["roles"]).all()
        assert (observations["own"][..., role].sum(-1) == 1).all()
        own, others = observations["own"][0], observations["others"][0]
        for i in range(3):
            for k, o in enumerate(o for o in range(3) if o != i):
                assert (others[i, k, role] == own[o, role] * (observations["others_mask"][0, i, k])).all()
        assert env.observation_space.contains(observations)
    assert env.roles == ("strong", "weak")
    assert {tuple(row) for row in info["roles"].tolist()} <= {(0, 1, 1), (1, 0, 1), (1, 1, 0)}


def test_roles_and_sides_are_named() -> None:
    env = make_vec(HUNT, 2, seed=0)
    assert env.sides == env.roles == ("hunter", "prey")
    _, info = env.reset()
    assert info["roles"].tolist() == [[0, 1, 1, 1]] * 2
    assert env.numbers()["agents_health"].tolist() == [[200, 40, 40, 40]] * 2
    assert env.numbers()["melee_reach"] == 2.0
    assert make_vec("ffa_1", 1).sides == ("agent 0", "agent 1")
    assert make_vec("ffa_1", 1).roles == ()
    mixed = variant("teams_3").roles(a=outlast.role(1), b=outlast.role(3), observed=False)
    assert make_vec(mixed, 1).sides == ("team 0", "team 1")


@pytest.mark.parametrize("scenario", [HUNT, DRAWN], ids=["hunt", "drawn"])
def test_a_scenario_is_rebuilt_with_its_roles(scenario: Any) -> None:
    kept = json.loads(json.dumps(fingerprint(scenario)))
    assert is_fingerprint(kept)
    assert not difference(kept, fingerprint(scenario))
    again = rebuilt(kept, classes(scenario))
    assert again.by_role == scenario.by_role
    assert not difference(kept, fingerprint(again))
    other = fingerprint(scenario.roles(all=outlast.role()))
    assert "who has which role" in difference(kept | {"numbers": other["numbers"]}, other)
    with pytest.raises(StateError, match="who has which role is"):
        make_vec(scenario.roles(strong=outlast.role(1), weak=outlast.role()), 1).set_state(
            make_vec(scenario, 1).get_state()
        )


def test_unknown_numbers_get_a_hint() -> None:
    with pytest.raises(NumberError, match="has no number 'melee_damge'; did you mean melee_damage"):
        variant("ffa_1").roles(a=outlast.role(melee_damge=3))
    with pytest.raises(NumberError, match=r"a = 3: a role is needed, as in a=outlast\.role\(1\)"):
        variant("ffa_1").roles(a=3)
    for option in ("observed", "drawn"):
        with pytest.raises(NumberError, match=f"'{option}' is not a name of a role, but an option"):
            variant("ffa_1").roles(**{"a": outlast.role(1), option: outlast.role()})
    roles = {"a": outlast.role(1), "b": outlast.role(agents_health=80)}
    with pytest.raises(NumberError, match=r"role b: mortality\.limit = 50: agents begin with 80"):
        make_vec(variant("ffa_1").replace(mortality_limit=50, agents_health=10).roles(**roles), 1)


def test_a_number_that_every_role_sets_is_changed_there() -> None:
    hunter, prey = outlast.role(1, melee_damage=20), outlast.role(melee_damage=3, melee_reach=1.0)
    both = variant("ffa_3").roles(a=hunter, b=prey)
    with pytest.raises(NumberError, match=r"melee_damage: every role sets it here, .* change the roles"):
        both.replace(melee_damage=50)
    with pytest.raises(NumberError, match=r"melee_damage: every role sets it here"):
        both.with_(Melee(damage=50))
    assert both.with_(Melee(cooldown=7)).numbers()["melee_cooldown"] == 7
    assert both.replace(melee_reach=3.0).numbers()["melee_reach"] == 3.0  # that of role a


@pytest.mark.parametrize("change", [{"count": 1.5}, {"agents": [-1]}, {"agents": [1, 1]}, {"name": "a b"}])
def test_data_of_no_role_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(NumberError, match=r"integer|a role's name"):
        roles_of({"drawn": "never", "roles": [{"name": "a", "numbers": {}} | change]})


def test_commands_take_roles_from_a_file(tmp_path: Path, capsys: Any) -> None:
    file = tmp_path / "hunt.json"
    file.write_text(json.dumps(plain_roles(HUNT.by_role)))
    game = ("teams_3", "--set", "teams_sizes=1,3", "--roles")
    assert with_roles(variant("teams_3"), file).by_role == HUNT.by_role
    status, out, _ = run(capsys, "schedule", *game, file)
    assert status == 0
    assert "observe_roles" in out
    for roles, message in (
        ([{"name": "a", "count": 1, "agents": [0], "numbers": {}}], "is not {"),
        ([{"name": "a", "count": 4, "numbers": {"melee_damage": -1}}], "role a: melee.dam"),
        ([{"name": "a", "count": 9, "numbers": {}}], "9 a are 9 agents, but n_agents is 4"),
        ("{", "does not hold roles: Expecting property"),
        ('{"drawn": "never", "drawn": "anyone", "roles": []}', "does not hold roles: "),
    ):
        text = roles if isinstance(roles, str) else json.dumps({"drawn": "never", "roles": roles})
        file.write_text(text)
        status, _, error = run(capsys, "schedule", *game, file)
        assert status == 2
        assert message in error
    status, _, error = run(capsys, "schedule", *game, tmp_path / "nothing.json")
    assert status == 2
    assert "nothing.json cannot be read: No such file" in error


LIMITS: dict[str, Any] = {"hunter": ("boxes", "use"), "prey": ("attack", "others")}


@pytest.mark.parametrize("drawn", ["never", "anyone"])
def test_what_a_role_is_without_is_nothing(drawn: str) -> None:
    """The game is the one in which these actions are noop; observations and masks are the same, but for what is 0."""
    game = outlast.variant("teams_3").with_(Teams(sizes=(1, 3)))
    free = game.roles(hunter=outlast.role(1), prey=outlast.role(3), drawn=drawn)
    limited = game.roles(
        drawn=drawn, **{n: outlast.role(k, without=LIMITS[n]) for n, k in (("hunter", 1), ("prey", 3))}
    )
    envs = [outlast.make_vec(each, 8, seed=0) for each in (free, limited)]
    rng, names = np.random.default_rng(0), [name for name, _ in envs[0].action_columns]
    for env in envs:
        env.reset()
    for _ in range(60):
        lacks = [{"use"} if role == 0 else {"attack"} for role in envs[0].worlds[AgentRoles].role.ravel()]
        lacking = np.array([[name in lack for name in names] for lack in lacks]).reshape(8, 4, -1)
        plain, masks = (env.action_masks() for env in envs)
        values = np.repeat(lacking, envs[0].action_sizes, axis=2)
        idle = np.concatenate([np.arange(n) == z for n, z in zip(envs[0].action_sizes, envs[0].noop, strict=True)])
        assert (masks == np.where(values, idle, plain)).all()
        actions = rng.integers(0, envs[0].action_sizes, (8, 4, len(names)))
        wanted, *_ = envs[0].step(np.where(lacking, envs[0].noop, actions))
        found, *_ = envs[1].step(actions)
        role = envs[0].worlds[AgentRoles].role
        for key, value in wanted.items():
            hidden = role == 0 if key.startswith("boxes") else role == 1 if key.startswith("others") else role < 0
            assert (found[key] == np.where(hidden.reshape(8, 4, *[1] * (value.ndim - 2)), 0, value)).all()
    assert not COMPILED or outlast.check(limited) == []  # uncompiled, it takes minutes


def test_limits_are_kept_in_files_and_slips_are_refused(tmp_path: Path) -> None:
    game = outlast.variant("teams_3").roles(**{name: outlast.role(2, without=names) for name, names in LIMITS.items()})
    game.save(tmp_path / "limited.json")
    assert outlast.Scenario.load(tmp_path / "limited.json").by_role == game.by_role
    for name, words in (("atack", "did you mean attack"), ("own", "others see it, too")):
        with pytest.raises(NumberError, match=f"role a is without '{name}': .*{words}"):
            outlast.make_vec(game.roles(a=outlast.role(without=[name])), 1)
    with pytest.raises(NumberError, match="a list of names is needed"):
        outlast.role(without="attack")

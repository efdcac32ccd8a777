"""The paper's four flaws, each removed by an ablation that does what it says; the variants stay as they are."""

import math

import numpy as np
import pytest

from outlast import ABLATIONS, make_vec, variant
from outlast.components import Body
from outlast.ecs import NumberError
from outlast.errors import ScenarioError
from tests.helpers.scenario_builder import ScenarioBuilder


def test_every_flaw_of_the_paper_has_an_ablation() -> None:
    assert {ablation.flaw for ablation in ABLATIONS.values()} == {1, 2, 3, 4}
    for name in ABLATIONS:
        ablated = variant(f"teams_4+{name}")
        assert ablated.name == f"teams_4+{name}"
        assert ablated.numbers() != variant("teams_4").numbers()
    bounty = variant("ffa_1+bounty").numbers()
    assert [bounty[name] for name in ("rewards_kill", "rewards_death", "ending_rule")] == [100, -100, "last alive"]


def test_names_are_put_together_in_any_order() -> None:
    assert variant("2v2_heals_mid+steering+health_cap").name == "teams_2+health_cap+steering"
    assert variant("teams_2+steering+health_cap") == variant("teams_2+health_cap+steering")
    assert variant("ffa_2+health_cap").replace(mortality_limit=0).numbers() == variant("ffa_2").numbers()


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("ffa_2+armour", r"there is no ablation 'armour'; known: health_cap, team_share"),
        ("ffa_2+", "there is no ablation ''"),
        ("ffa_2+bounty+bounty", "name each ablation once"),
        ("ffa_2+bounty+rivalry", "contradict each other"),
        ("ffa_2+team_share", "ffa_2 has no Teams, so team_share would change nothing"),
        ("fa_2+bounty", "there is no variant 'fa_2'; did you mean ffa_2"),
    ],
)
def test_names_that_mean_nothing_are_refused(name: str, reason: str) -> None:
    with pytest.raises(ScenarioError, match=reason):
        variant(name)


def health(name: str) -> list[float]:
    """Of two agents that use a heal, one of them wounded."""
    game = ScenarioBuilder(name)
    game.wound(0, 20)
    game.hand(0, "heal", 0)
    game.hand(1, "heal", 1)
    return game.step({0: "use", 1: "use"}).observation["own"][0, :, -7].tolist()


def test_a_capped_health_loses_what_is_above() -> None:
    assert health("ffa_4") == [95, 175]
    assert health("ffa_4+health_cap") == [95, 100]


def test_a_limit_of_one_hit_point_is_a_limit() -> None:
    game = ScenarioBuilder("ffa_1", agents_health=1, mortality_limit=1, safe_zone_damage=0)
    game.hand(0, "heal", 0)
    assert game.step({0: "use"}).health(0) == 1
    assert game.bag(0) == []


def test_a_cap_below_the_initial_health_is_refused() -> None:
    with pytest.raises(NumberError, match="agents begin with 100"):
        make_vec(variant("ffa_1").replace(mortality_limit=99), 1)


def paid(name: str, *dead: int) -> list[float]:
    """Rewards of the tick in which those agents die without a blow."""
    game = ScenarioBuilder(name)
    for agent in dead:
        game.wound(agent, 0)
    return game.step().rewards


@pytest.mark.parametrize(
    ("name", "dead", "rewards"),
    [
        ("teams_2", (), [1, 1, 1, 1]),
        ("teams_2", (0,), [1, 1, 1, 1]),
        ("teams_2+team_share", (), [1, 1, 1, 1]),
        ("teams_2+team_share", (0,), [0, 0, 1, 1]),
        ("teams_2+team_share", (0, 2), [0, 0, 0, 0]),
        ("teams_2+team_share", (2, 3), [1, 1, -1, -1]),
        ("teams_2+bounty", (), [0, 0, 0, 0]),
        ("teams_2+bounty", (2,), [0, 0, -100, -100]),
        ("teams_2+rivalry", (2,), [0, 0, 0, 0]),
        ("teams_2+rivalry", (2, 3), [100, 100, 0, 0]),
        ("teams_2+rivalry", (0, 1, 2, 3), [0, 0, 0, 0]),
        ("ffa_4+rivalry", (0,), [0, 100]),
    ],
)
def test_rewards(name: str, dead: tuple[int, ...], rewards: list[float]) -> None:
    assert paid(name, *dead) == rewards


def test_velocity_follows_the_action_at_once() -> None:
    """In the agent's own frame; what is left of it after a tick is up to damping."""
    env, rng = make_vec("ffa_1+steering", 32, seed=0), np.random.default_rng(0)
    env.reset()
    body, n = env.worlds[Body], slice(0, 2)
    body.x[:, n], body.y[:, n] = [-3, 3], 0
    body.angle[:, n] = rng.uniform(-3, 3, (32, 2))
    body.cosine[:, n], body.sine[:, n] = np.cos(body.angle[:, n]), np.sin(body.angle[:, n])
    frame = np.exp(1j * body.angle[:, n].astype(float))
    body.vx[:, n], body.omega[:, n] = 7.0, -2.0  # overwritten
    actions = rng.integers(0, env.action_sizes, (32, 2, 6))
    actions[..., 3:] = 0
    env.step(actions)
    ahead, left, turn = np.moveaxis((actions[..., :3] - 3) / 3, -1, 0)
    left_over = (1 - 0.8 / 60) ** 2
    want = 5 * (ahead + 1j * left) * frame * left_over
    np.testing.assert_allclose(body.vx[:, n] + 1j * body.vy[:, n], want, atol=1e-5)
    np.testing.assert_allclose(body.omega[:, n], math.pi * turn * left_over, atol=1e-5)

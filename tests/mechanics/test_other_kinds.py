"""Kinds of entities that are no agents, but have components of agents."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Bag, Body, Died, Gift, Guard, Health, Item, Return, Shape, Side, Weapon
from outlast.ecs import Archetype, DeclarationError, Module, number, ref
from outlast.systems import DeathDrop, DropLast, Preparation, Respawn
from tests.conftest import draw_actions
from tests.helpers.execution_modes import assert_stand_ins_change_nothing

STEPS, WORLDS = 60, 3
GAME = (
    outlast.variant("teams_2")
    .with_(DropLast(), DeathDrop(), Preparation(ticks=5), Respawn(ticks=5))
    .replace(ending_rule="never", ending_limit=40, melee_damage=40, mortality_limit=120)
)
ROLES = {
    "strong": outlast.role(1, melee_reach=9.0, melee_damage=90, give_last_reach=9.0, mortality_limit=200),
    "rest": outlast.role(inventory_capacity=2, respawn_ticks=3, pickup_reach=2.0),
}


@dataclass(frozen=True)
class Crates(Module):
    """They are far from all that happens, and have everything that agents have and others can."""

    count: int = number(3, low=1)
    order: int = number(60, low=0)

    def archetypes(self) -> Any:
        here = Body(x=500.0, y=500.0), Shape(radius=0.5, bound=0.5)
        parts = (*here, Health(points=150), Guard(), Died(), Return(), Bag(), Gift(), Weapon())
        return [Archetype("crate", parts, ref("count"), order=self.order)]


def play(scenario: Any) -> tuple[Any, list[Any]]:
    """The environment after some steps of random actions, and the numbers that it gave."""
    env, rng = outlast.make_vec(scenario, WORLDS, seed=5), np.random.default_rng(0)
    observations, _ = env.reset()
    found = [*observations.values()]
    for _ in range(STEPS):
        observations, *results, _ = env.step(draw_actions(env, rng))
        found += [*observations.values(), *results]
    return env, found


@pytest.mark.parametrize("order", [0, 60])  # their rows come before those of agents, or after
@pytest.mark.parametrize("roles", [{}, ROLES])
def test_agents_play_as_if_others_were_not_there(roles: dict[str, Any], order: int) -> None:
    games = [scenario.roles(**roles) if roles else scenario for scenario in (GAME, GAME.with_(Crates(order=order)))]
    (alone, expected), (env, found) = map(play, games)
    assert all(map(np.array_equal, expected, found))
    for component, name in ((Health, "points"), (Bag, "count"), (Weapon, "cooldown"), (Return, "tick")):
        one, other = (getattr(each.worlds[component], name)[:, each.worlds.span("agent")] for each in (alone, env))
        assert (one == other).all()
    crates = env.worlds.span("crate")
    assert not env.worlds[Bag].count[:, crates].any()
    assert (env.worlds[Weapon].target[:, crates] == -1).all()
    assert (env.worlds[Health].points[:, crates] == 120).all()


def test_a_crate_picks_up_and_leaves_it_when_it_dies() -> None:
    env = outlast.make_vec(outlast.variant("teams_2").with_(Crates()), 1, seed=0)
    env.reset()
    crate, heal = (env.worlds.span(name).start for name in ("crate", "heal"))
    bag, item, body, idle = env.worlds[Bag], env.worlds[Item], env.worlds[Body], np.tile(env.noop, (1, 4, 1))
    body.x[0, heal] = body.y[0, heal] = 500.3
    env.step(idle)
    assert (bag.count[0, crate], item.holder[0, heal]) == (1, crate)
    env.worlds[Health].points[0, crate] = 0
    env.step(idle)
    assert (bag.count[0, crate], item.holder[0, heal]) == (0, -1)
    assert np.hypot(body.x[0, heal] - 500, body.y[0, heal] - 500) == pytest.approx(0.5, abs=1e-3)


def test_no_system_takes_a_row_for_an_index() -> None:
    """Nor does more than it declares: on stand-ins, all give what they give on plain arrays."""
    assert_stand_ins_change_nothing(GAME.with_(Crates(order=0)), 8)


@dataclass(frozen=True)
class More(Module):
    """Two agents more."""

    def archetypes(self) -> Any:
        return [Archetype("agent", (), 2)]

    def dims(self) -> Any:
        return {"agents": 2}


@pytest.mark.parametrize("name", ["ffa_2", "teams_3"])
def test_a_mechanic_may_bring_more_agents(name: str) -> None:
    scenario = outlast.variant(name)
    _, expected = play(scenario.replace(agents_count=6))
    _, found = play(scenario.replace(agents_count=4).with_(More()))
    assert all(map(np.array_equal, expected, found))


def test_a_kind_with_a_side_is_refused() -> None:
    class Rivals(More):
        def archetypes(self) -> Any:
            return [Archetype("rival", (Side(),), 2)]

    with pytest.raises(DeclarationError, match=r"^the kind .rival. has Side, which makes agents"):
        outlast.make_vec(outlast.variant("ffa_2").with_(Rivals()), 1)

"""Rows of observations that are declared as a mapping of columns hold what these columns hold, for who sees them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

import outlast
from outlast import systems
from outlast.components import Body, SelfView, Shape, Side, Solid, Spawned
from outlast.ecs import Archetype, Array, Component, Entity, Module, Read, Rows, Singleton, column, kernel, number, ref
from outlast.envs.web.observation_text import observation_text
from outlast.systems.observation_rows import more_fields, rows
from tests.conftest import scaled

WORLDS = scaled(16, least=3)


class Crate(Component):
    kind: Array = column("i4", low=0, high=3, unit="kinds")


@dataclass(frozen=True)
class Crates(Module):
    count: int = number(3, low=0, high=9)

    def archetypes(self) -> list[Archetype]:
        parts = Body(vx=1.0), Shape(half_width=0.4, half_height=0.3), Solid(dynamic=1), Spawned(), Crate(kind=2)
        return [Archetype("crate", parts, ref("count"))]

    def dims(self) -> dict[str, int | str]:
        return {"crates": ref("count")}

    def singletons(self) -> list[Singleton]:
        return [CratesView()]

    def fields(self) -> Any:
        return {"own": ODD}


@kernel
def ahead(i: int, e: int, body: Read[Body], agents: Rows[Side]) -> Any:
    """How far the crate is to the right of agent number i."""
    return body.x[e] - body.x[agents[i]]


@kernel
def odd(i: int, e: int, entities: Read[Entity]) -> int:
    return i % 2 if entities.alive[e] else 0


CratesView = rows(
    Crates, "crates", Crate, x=Body.x, y=Body.y, angle=Body.angle, vx=Body.vx, kind=Crate.kind, ahead=ahead
)
ODD = more_fields(Crates, SelfView, "own", Side, odd=odd)


def test_rows_hold_their_columns_where_they_are_seen() -> None:
    scenario = (
        outlast.variant("teams_3")
        .with_(Crates(), systems.Pillars())
        .replace(cameras_fov=3.0, cameras_depth=20.0)
        .vary(crates_count=outlast.distributions.integers(0, 3))
    )
    env = outlast.make_vec(scenario, WORLDS, seed=0)
    observations, _ = env.reset()
    body, span, rng = env.worlds[Body], env.worlds.span("crate"), np.random.default_rng(0)
    seen = 0
    for _ in range(40):
        mask, there = observations["crates_mask"] != 0, env.worlds[Entity].alive[:, None, span] != 0
        assert not (mask & ~there).any()
        columns = body.x, body.y, body.angle, body.vx
        values = [np.broadcast_to(column[:, None, span], mask.shape) for column in columns]
        values += [np.full(mask.shape, 2), body.x[:, None, span] - body.x[:, : env.num_agents, None]]
        wanted = np.where(mask[..., None], np.stack(values, -1), 0)
        np.testing.assert_array_equal(observations["crates"], wanted.astype(np.float32))
        alive = env.worlds[Entity].alive[:, : env.num_agents]
        assert (observations["own"][..., env.fields["own"]["odd"].start] == alive * [0, 1, 0, 1]).all()
        seen += mask.sum()
        actions = rng.integers(0, env.action_sizes, (WORLDS, env.num_agents, len(env.action_sizes)))
        observations, *_ = env.step(actions)
    assert seen > WORLDS


def test_fields_have_units_scales_and_ranges_of_their_columns() -> None:
    env = outlast.make_vec(outlast.variant("teams_3").with_(Crates()), 1)
    fields = env.fields["crates"]
    assert [*fields] == ["x", "y", "angle", "vx", "kind", "ahead"]
    assert (fields["x"].unit, fields["x"].scale, fields["vx"].unit) == ("m", 12.5, "m/s")
    assert (fields["kind"].low, fields["kind"].high, fields["kind"].scale) == (0, 3, 3)
    assert outlast.check(env.scenario) == []


def test_the_text_shows_the_fields_of_a_game_without_hit_points() -> None:
    """Agents see everything here, as there are no cameras."""
    agents = systems.Agents(count=2), systems.FreeForAll(), systems.Room(size=8.0), systems.SpawnGrid()
    rest = systems.Steering(), systems.Physics(), systems.Rewards(), systems.Ending("never", 9), Crates()
    game = outlast.Scenario("walk", (*agents, *rest))
    env = outlast.make_vec(game, 1, seed=0)
    observations, _ = env.reset()
    assert [*env.fields["own"]] == ["id", "x", "y", "angle", "vx", "vy", "omega", "odd"]
    text = observation_text({key: rows[0, 1] for key, rows in observations.items()}, env.fields)
    assert text.keys() == {"Odd", "Enemies", "Crates"}
    assert text["Odd"] == ["1"]
    assert text["Enemies"][0].endswith(", odd 0")
    assert text["Crates"][0].startswith("3 in sight, nearest ")

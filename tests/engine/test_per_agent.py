"""Roles: who has which, what numbers agents then have, and what is refused."""

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.components import Health, Phase, Side
from outlast.ecs import (
    RESET,
    AgentRoles,
    Array,
    Component,
    DeclarationError,
    Module,
    NumberError,
    Roles,
    Rows,
    Worlds,
    Write,
    column,
    differs,
    kernel,
    number,
    of,
)
from outlast.ecs.declarations.archetype import Archetype
from outlast.systems import Agents, Ending, FreeForAll, Rewards, Room, SpawnGrid, Teams
from tests.conftest import scaled

WORLDS = scaled(2000, least=200)


class Pace(Component):
    step: Array = column("f4")
    count: Array = column("i4")


@dataclass(frozen=True)
class Walk(Module):
    """Notes what kernels get for every agent."""

    step: float = number(0.5, low=0, per_agent=True)
    count: int = number(3, per_agent=True)
    alike: float = number(1.0)

    def archetypes(self) -> Any:
        return [Archetype("agent", (Pace(),))]


@kernel
def scaled_step(step: Any, e: int, alike: float) -> float:
    return of(step, e) * alike


@Walk.system(Phase.SPAWN)
def note(pace: Write[Pace], agents: Rows[Side], step: float, count: int, alike: float) -> None:
    for e in agents:
        pace.step[e], pace.count[e] = scaled_step(step, e, alike), of(count, e) * 2
        if differs(step):
            pace.count[e] += 1000


MODULES = (Agents(count=5), Room(), SpawnGrid(), FreeForAll(), Rewards(), Ending(), Walk())


def roles(drawn: str = "never", **given: outlast.ecs.Role) -> Roles:
    return Roles(tuple(dataclasses.replace(each, name=name) for name, each in given.items()), drawn)


def started(worlds: Worlds) -> Worlds:
    """In the first tick of their second episodes."""
    worlds.seed(7, np.arange(worlds.count))
    for _ in range(2):
        worlds.run(np.full(worlds.count, RESET, np.int8))
    return worlds


def made(given: Roles | None, count: int = 3, modules: Any = MODULES, **options: Any) -> Worlds:
    return started(Worlds(modules, count, roles=given, **options))


def test_kernels_get_one_number_or_one_for_each_agent() -> None:
    pace = made(None)[Pace]
    assert pace.step[:, :5].tolist() == [[0.5] * 5] * 3
    assert pace.count[:, :5].tolist() == [[6] * 5] * 3
    given = roles(a=outlast.role(2, walk_step=1.25), b=outlast.role(walk_count=-4))
    worlds, interpreted = made(given), made(given, interpret=["walk.note"])
    assert (worlds.block == interpreted.block).all()
    assert worlds[Pace].step[:, :5].tolist() == [[1.25, 1.25, 0.5, 0.5, 0.5]] * 3
    assert worlds[Pace].count[:, :5].tolist() == [[1006, 1006, 992, 992, 992]] * 3
    assert worlds.number("walk_step").tolist() == [[1.25, 1.25, 0.5, 0.5, 0.5]] * 3
    assert worlds.number("walk_count").dtype == np.int32
    assert worlds.number("walk_alike") == 1.0
    assert worlds.agent_numbers().keys() == {"walk_step", "walk_count"}
    with pytest.raises(NumberError, match="no number 'walk_pace'"):
        worlds.number("walk_pace")


def test_values_are_drawn_for_each_agent_of_each_world_and_episode() -> None:
    draw = outlast.distributions.uniform(2.0, 3.0)
    given = roles(a=outlast.role(3, walk_step=draw, walk_count=outlast.distributions.integers(-2, 5)), b=outlast.role())
    worlds = Worlds(MODULES, WORLDS, roles=given)
    worlds.seed(7, np.arange(WORLDS))
    seen = []
    for _ in range(2):
        worlds.run(np.full(WORLDS, RESET, np.int8))
        seen.append(worlds.number("walk_step"))
        counts = worlds.number("walk_count")[:, :3]
    steps = np.concatenate([each[:, :3].ravel() for each in seen])
    assert np.unique(steps).size > 0.99 * steps.size
    assert steps.min() >= 2
    assert steps.max() <= 3
    assert steps.mean() == pytest.approx(2.5, abs=5 * 0.29 / steps.size**0.5)
    assert {*np.unique(counts)} == {*range(-2, 6)}
    assert (seen[0][:, 3:] == 0.5).all()
    part = Worlds(MODULES, 1, roles=given)
    part.seed(7, [WORLDS - 1])
    part.run(np.full(1, RESET, np.int8))
    assert (part.number("walk_step") == seen[0][-1:]).all()  # a function of seed, world and episode


@pytest.mark.parametrize(("drawn", "sizes"), [("never", ()), ("anyone", ()), ("side", (2, 3))])
def test_who_has_which_role_is_drawn(drawn: str, sizes: tuple[int, ...]) -> None:
    modules = [*(m for m in MODULES if not isinstance(m, FreeForAll)), Teams(sizes=sizes) if sizes else FreeForAll()]
    given = roles(drawn, one=outlast.role(1), two=outlast.role(2), rest=outlast.role(walk_step=7.0))
    worlds = made(given, WORLDS, modules)
    found, counts = np.unique(worlds[AgentRoles].role, axis=0, return_counts=True)
    possible = {"never": 1, "anyone": 30, "side": 2 * 3}[drawn]  # side: [0 1] [1 2 2]
    assert len(found) == possible
    expected = WORLDS / possible
    assert ((counts - expected) ** 2 / expected).sum() < possible - 1 + 6 * (2 * possible) ** 0.5
    assert ((worlds[Pace].step[:, :5] == 7) == (worlds[AgentRoles].role == 2)).all()


def test_a_world_with_other_numbers_varied_has_roles_too() -> None:
    given = roles("anyone", a=outlast.role(1, walk_step=2.0), b=outlast.role(agents_health=7))
    worlds = made(given, 50, varied={"walk_alike": outlast.distributions.uniform(1, 2)})
    steps = np.where(worlds[AgentRoles].role == 0, np.float32(2), np.float32(0.5))
    assert (worlds[Pace].step[:, :5] == steps * worlds.number("walk_alike")[:, None]).all()
    assert ((worlds[Health].points[:, :5] == 7) == (worlds[AgentRoles].role == 1)).all()


def test_roles_without_numbers_are_names() -> None:
    worlds = made(roles(a=outlast.role(2), b=outlast.role()))
    assert worlds[AgentRoles].role.tolist() == [[0, 0, 1, 1, 1]] * 3
    assert not worlds.agent_numbers()
    given = roles(
        "side",
        a=outlast.role(2, walk_step=1.0, walk_count=outlast.distributions.choice(1, 5)),
        b=outlast.role(agents=(4, 0)),
        c=outlast.role(walk_step=outlast.distributions.log_uniform(0.1, 2)),
    )
    assert str(given) == "2 a and 2 b and other c drawn by side"


role, DRAWN = outlast.role, outlast.distributions.integers(1, 5)
BOTH = "is varied from world to world and differs by role"
REFUSED: list[tuple[Any, str]] = [
    ({"a": role(1), "b": role(2)}, "1 a + 2 b are 3 agents, but n_agents is 5: take replace"),
    ({"a": role(5), "b": role()}, r"5 a \+ at least 1 b are 6 agents"),
    ({"a": role(agents=(5,)), "b": role()}, "role a: agent 5 does not exist, only 0 to 4"),
    ({"a": role(agents=(1,)), "b": role(agents=(1, 2))}, "agent 1 is in two roles"),
    ({"a": role(), "b": role()}, "only one role can leave out its count"),
    ({"a": role(walk_stride=1)}, "role a: the number walk_stride does not exist; a role can have: .*"),
    ({"a": role(walk_alike=1.0)}, "walk_alike is the same for all agents, by its declaration"),
    ({"a": role(walk_step=-1)}, "role a: walk.step = -1: must be >= 0"),
    ({"a": role(walk_step=outlast.distributions.uniform(-1, 1))}, "role a: walk.step = -1"),
    ({"a": role(walk_step=float("nan"))}, "role a: walk.step = nan: a finite number"),
    ({"a": role(walk_count=1.5)}, "role a: walk.count = 1.5: an integer"),
    ({"a": role(walk_count=outlast.distributions.uniform(1, 2))}, "it has type int, so take integers or cho"),
    ({"drawn": "side", "a": role()}, 'drawn = "side", but agents are not in teams; add Teams'),
    ({"drawn": "daily", "a": role()}, "drawn = 'daily'; allowed are 'never', 'anyone', 'side'"),
    ({"a b": role()}, "is not a role's name"),
    (lambda: role(0), "the count must be an integer >= 1"),
    (lambda: role(True), "the count must be an integer >= 1"),
    (lambda: role(1, agents=(0,)), "give a count or ids, not both"),
    (lambda: role(agents=(0, 0)), "distinct ids"),
    (lambda: role(agents=(0.5,)), "integers >= 0"),
    (lambda: Roles(()), "at least one is needed"),
    (lambda: Roles((5,)), "5 is not a role"),
    (lambda: Worlds(MODULES, 1, roles=roles(a=role(walk_step=1.0)), varied={"walk_step": DRAWN}), BOTH),
    (lambda: outlast.variant("ffa_1").vary(melee_damage=DRAWN).roles(hunter=role(melee_damage=9)), BOTH),
    (lambda: outlast.variant("ffa_1").roles(hunter=role(melee_damage=9)).vary(melee_damage=DRAWN), BOTH),
]


@pytest.mark.parametrize(("given", "message"), REFUSED)
def test_impossible_roles_are_refused(given: Any, message: str) -> None:
    with pytest.raises(NumberError, match=message.replace(" + 2", r" \+ 2")):
        given() if callable(given) else Worlds(MODULES, 1, roles=roles(**given))


def test_only_an_int_or_a_float_can_be_of_an_agent() -> None:
    @dataclass(frozen=True)
    class Odd(Module):
        switch: bool = number(False, per_agent=True)

    with pytest.raises(DeclarationError, match=r"odd\.switch is bool and per_agent: roles can differ in an int or"):
        Odd()


def test_a_number_of_roles_does_not_change_while_worlds_run() -> None:
    worlds = made(roles(a=outlast.role(1, walk_step=2.0), b=outlast.role()))
    with pytest.raises(NumberError, match="walk_step cannot change while worlds run: roles differ in it"):
        worlds.set_numbers(walk_step=3.0)
    worlds.set_numbers(walk_count=4)
    assert worlds.number("walk_count") == 4
    started(worlds)
    assert (worlds[Pace].count[:, :5] == 1008).all()

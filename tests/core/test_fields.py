"""Observations with named fields: mechanics add to rows of others, and nobody but the declaration knows a position."""

from typing import Any

import numpy as np
import pytest

from outlast import Scenario, make_vec, variant
from outlast.components import Phase, SelfView, Side
from outlast.distributions import choice

from outlast.ecs import (  # isort: skip
    Component, DeclarationError, Entity, Field, MemoryLayout, Module, Observation, Offset, Read, Rows, ScheduleError,
    Worlds, Write, column, columns_of,
)  # fmt: skip
from outlast.ecs.checks.code_hash import code_digest
from outlast.envs.rollout.policies import random_policy, scripted_policy
from outlast.envs.web.observation_text import observation_text
from tests.helpers.added_fields import Age, Breath, Freshness, Stamina
from tests.helpers.mechanics import DUEL, duel, kind, mechanic, taking, written

OWN = ["id", "health", "x", "y", "angle", "vx", "vy", "omega"]


def played(scenario: Scenario, steps: int = 60) -> tuple[Any, Any]:
    """An environment of 4 worlds after some steps of random play, in which the zone kills some, and what is seen."""
    env = make_vec(scenario.replace(agents_health=30), 4, seed=5)
    observations, _ = env.reset()
    policy = random_policy(env, 0)
    for _ in range(steps):
        observations, *_ = env.step(policy(observations))
    return env, observations


def test_without_additions_the_fields_are_those_of_the_paper() -> None:
    env = make_vec("teams_3", 1)
    assert [*env.fields["own"]] == [*env.fields["others"]] == ["id", "team", *OWN[1:]]
    assert [*make_vec("ffa_1", 1).fields["own"]] == OWN
    assert [(name, field.start, field.size) for name, field in env.fields["boxes"].items()] == [
        ("vertices", 0, 8), ("x", 8, 1), ("y", 9, 1), ("angle", 10, 1)
    ]  # fmt: skip
    own = env.fields["own"]
    assert {name: field.unit for name, field in own.items()}["omega"] == "rad/s"
    assert columns_of(own, "x", "y") == slice(3, 5)
    assert columns_of(own, "y", "health") == [4, 2]
    assert (columns_of(own, "team"), columns_of(env.fields["boxes"], "vertices")) == (1, slice(0, 8))


@pytest.mark.parametrize("name", ["ffa_1", "teams_1"])
def test_a_field_in_the_agents_own_row(name: str) -> None:
    """All others are as without it, bit for bit, and those who see an agent see its new field."""
    plain, before = played(variant(name))
    env, seen = played(variant(name).with_(Stamina()))
    agents = env.worlds.span("agent")
    assert [*env.fields["own"]] == [*plain.fields["own"], "stamina"]
    living = env.worlds[Entity].alive[:, agents] != 0
    assert not living.all()
    own, others = seen["own"], seen["others"]
    left = np.where(living, env.worlds[Breath].left[:, agents], 0)
    assert left.max() > 30
    np.testing.assert_array_equal(own[..., env.fields["own"]["stamina"].start], left)
    np.testing.assert_array_equal(own[..., :-1], before["own"])
    np.testing.assert_array_equal(others[..., :-1], before["others"])
    for i in range(env.num_agents):
        shown = (others[:, i] != 0).any(-1)
        rest = np.delete(own, i, axis=1)
        np.testing.assert_array_equal(others[:, i][shown], rest[shown])
    if name == "teams_1":
        np.testing.assert_array_equal(own[..., 1], env.worlds[Side].side[:, agents])
    single: Any = env.single_observation_space
    assert (single["own"].low[0, -1], single["own"].high[0, -1]) == (0, 100)
    assert (single["others"].low[..., -1] == 0).all()
    assert (single["others"].high[..., -1] == 100).all()


def test_a_field_in_the_rows_of_heals_moves_the_others_of_that_row() -> None:
    scenario = DUEL.replace(cameras_mode="revealed")
    plain, before = played(scenario)
    env, seen = played(scenario.with_(Freshness()))
    assert [*env.fields["heals"]] == ["age", "x", "y"]
    heals, fields = seen["heals"], env.fields["heals"]
    np.testing.assert_array_equal(heals[..., columns_of(fields, "x", "y")], before["heals"])
    here = env.worlds[Entity].alive[:, env.worlds.span("heal")] != 0
    ages = np.where(here, env.worlds[Age].ticks[:, env.worlds.span("heal")], 0)
    np.testing.assert_array_equal(heals[:, 0, :, fields["age"].start], ages)
    np.testing.assert_array_equal(scripted_policy(env)(seen), scripted_policy(plain)(before))
    one = [{key: array[0, 0] for key, array in each.items()} for each in (before, seen)]
    assert observation_text(one[1], env.fields) == observation_text(one[0], plain.fields)
    box: Any = env.single_observation_space["heals"]
    assert (box.low[0, 0, 0], box.high[0, 0, 0]) == (0, np.inf)


def test_a_game_with_other_fields_is_another_game() -> None:
    added = [(Field("a"),), (Field("b"),), (Field("a", size=2),), (Field("a", order=-1),), (Field("a"), Field("b"))]
    assert len({code_digest(adding("own", *fields)["adding"]) for fields in added}) == len(added)
    shown = [column("f4", "agents", fields=fields) for fields in added]
    assert len({code_digest(showing(mine=each)["showing"]) for each in shown}) == len(shown)


def test_the_range_of_a_field_is_the_widest_of_all_worlds() -> None:
    # The range is in the declaration of the field.
    own = lambda self: {"own": (Field("stamina", low=10 - self.most, high=self.most),)}  # noqa: E731
    limited = kind("Limited", Stamina, fields=own, bounds=lambda self, layout: {})

    def ends(scenario: Scenario) -> list[float]:
        env = make_vec(scenario, 1)
        box = env.observation_space["own"]
        where = env.fields["own"]["stamina"].columns
        return [box.low[..., where].min(), box.high[..., where].max()]

    scenario = variant("teams_1").with_(limited())
    assert ends(scenario) == [-90, 100]
    assert ends(scenario.vary(limited_most=choice(30, 80))) == [-70, 80]


def test_a_field_is_as_long_as_a_dimension() -> None:
    one, two = (MemoryLayout(adding("own", Field("a", size=size), Field("b")).modules).fields for size in (2, "agents"))
    assert one == two


def adding(key: str, *fields: Field) -> Scenario:
    return DUEL.with_(mechanic("Adding", fields={key: fields}))


def showing(**columns: Any) -> Scenario:
    return DUEL.with_(mechanic("Showing", singletons=[type("View", (Observation,), columns)()]))


def asking(**hints: Any) -> Scenario:
    made = kind("Asking")
    made.system(Phase.OBSERVE, compiled=False)(taking("look", **hints))
    return DUEL.with_(made())


def with_slot(**hints: Any) -> Scenario:
    slot = showing(own_slot=column("f4", "agents", fields=(Field("x"),)))["showing"]
    return asking(**hints).with_(slot, adding("own", Field("slot_x"))["adding"])


Behind = kind("Behind", fields={"own": (Field("lost"), Field("kept"))})  # an Offset writes nothing ahead of it


@Behind.system(Phase.OBSERVE)
def show_kept(view: Write[SelfView], agents: Rows[Side], own_kept: Offset) -> None:
    for i in range(agents.size):
        view.own[i, own_kept] = 1


REFUSED = {
    "offset": (lambda: asking(own_heath=Offset), "look: the Offset 'own_heath' does not name a field .*own_health"),
    "offset of nothing": (lambda: asking(nothing=Offset), "Known: .*zone_x"),
    "two fields": (lambda: with_slot(own_slot_x=Offset), "could be the field 'slot_x' of 'own' and 'x' of 'own_slot'"),
    "two of a name": (lambda: adding("own", Field("health")), "'health' .* 'own' of both .*mortality.*; rename"),
    "two mechanics": (
        lambda: adding("own", Field("stamina")).with_(Stamina()),
        "'stamina' is a field of 'own' of both adding and stamina; rename one",
    ),
    "unknown key": (lambda: adding("onw", Field("a")), "adding adds .* 'onw', which no mechanic .* mean own[?]$"),
    "no tuple": (
        lambda: DUEL.with_(mechanic("Returning", fields={"own": Field("a")})),
        r"returning.fields\(\) returned .*: a tuple of Field by key",
    ),
    "a copy": (lambda: adding("others", Field("a")), "'others', whose rows have the fields of 'own': add them to that"),
    "a mask": (lambda: adding("heals_mask", Field("a")), "'heals_mask', which heals declares without any: declare"),
    "scale": (lambda: adding("own", Field("a", scale=0)), r"'a' of 'own' \(adding\) has the scale 0: a number of at"),
    "function": (lambda: adding("own", Field("a", scale=lambda _: np.inf)), "has the scale inf"),
    "name": (lambda: adding("own", Field("Stamina left")), "a field is called 'Stamina left': lower-case letters"),
    "size": (lambda: adding("own", Field("a", size=0)), "the field 'a' has size 0 and the range -inf to inf: a"),
    "size of no dimension": (
        lambda: adding("own", Field("a", size="leaves")),
        r"'a' of 'own' \(adding\) is as long as the dimension 'leaves', which is 0 or not defined; known: agents, ",
    ),
    "range": (lambda: adding("own", Field("a", low=1, high=0)), "has size 1 and the range 1 to 0"),
    "copies of nothing": (
        lambda: showing(mine=column("f4", "agents", fields="nothing")),
        r"the rows of 'mine' \(showing\) have the fields of 'nothing', which declares none here",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_fields_that_cannot_be_are_refused(case: str) -> None:
    make, words = REFUSED[case]
    with pytest.raises(DeclarationError, match=words):
        Worlds(make().modules, 1)


def test_columns_of_an_unknown_field_are_refused() -> None:
    fields = MemoryLayout(DUEL.modules).fields["own"]
    with pytest.raises(KeyError, match="unknown field 'team'; known: id, health, x, y, angle"):
        columns_of(fields, "id", "team")


def test_only_observations_have_fields() -> None:
    with pytest.raises(DeclarationError, match=r"Odd.x has fields, which only columns of an Observation have"):

        class Odd(Component):
            x: Any = column("f4", fields=(Field("x"),))


def test_order_is_asked_for_where_two_touch_one_field() -> None:
    for annotations in ({"view": Write[SelfView]}, {"view": Write[SelfView], "own_x": Offset}):
        with pytest.raises(ScheduleError, match=r"order of agents.see_own and asking.look in phase OBSERVE"):
            Worlds(asking(**annotations).modules, 1)
    read = asking(view=Read[SelfView], own_stamina=Offset).with_(Stamina())
    with pytest.raises(ScheduleError, match=r"order of asking.look and stamina.see_own"):
        Worlds(read.modules, 1)


def sneaking(line: str) -> Module:
    """A mechanic with a system that writes rows that others write, too, by this line."""
    sneaky, parameters = kind("Sneaky"), "view: Write[SelfView], agents: Rows[Side], own_stamina: Offset"
    source = f"def sneaky({parameters}) -> None:\n    for i in range(agents.size):\n        {line}\n"
    sneaky.system(Phase.OBSERVE, after="stamina")(written(source, globals(), f"mine {hash(line)}.py"))
    return sneaky()


@pytest.mark.parametrize(
    "line",
    [
        "view.own[i, own_stamina] = 1; view.own[i, 0] = 7",
        "row = view.own[i]; row[own_stamina] = 1; row[0] = 7",
        "view.own[i, own_stamina + 1] = 1",
        "view.own[i] = 0",
        "view.own[:] = 7",
        "view.own.fill(7)",
        "rows = view.own; rows += 1",
        "np.copyto(view.own, np.zeros_like(view.own))",
    ],
)
def test_a_system_writes_the_fields_of_its_offsets_only(line: str) -> None:
    scenario = DUEL.with_(Stamina(), sneaking(line))
    words = r"sneaky.sneaky.*(SelfView\.own: index| beside the fields of its Offsets \(own_stamina\))"
    with pytest.raises((DeclarationError, IndexError), match=words):
        Worlds(scenario.modules, 1)


Purse = kind("Purse", fields={"own": (Field("gold"), Field("silver"))})
Closed = kind("Closed", Purse, systems=lambda self: [])


@Purse.system(Phase.OBSERVE)
def show(view: Write[SelfView], agents: Rows[Side], own_gold: Offset) -> None:
    for i in range(agents.size):
        view.own[i, own_gold], view.own[i, own_gold + 1] = 1, 2


@pytest.mark.parametrize(("purse", "seen"), [(Purse, [1, 2]), (Closed, [0, 0])])
def test_fields_are_written_by_one_offset_or_by_no_system_at_all(purse: Any, seen: list[int]) -> None:
    env = duel(purse())
    start = env.fields["own"]["gold"].start
    assert env.observe()["own"][0, 0, start : start + 2].tolist() == seen


def test_a_field_that_no_system_writes_is_refused() -> None:
    for game, field in (
        (adding("own", Field("mood")), "'mood' that adding"),
        (DUEL.with_(Behind()), "'lost' that behind"),
    ):
        with pytest.raises(DeclarationError, match=f"no system writes the field {field} adds"):
            make_vec(game, 1)

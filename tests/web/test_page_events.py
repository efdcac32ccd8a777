"""Events of single ticks, as pages and games show them."""

from typing import Any

from outlast import make_vec, variant
from outlast.components import Body, Item
from outlast.ecs import Archetype, Array, Component, Module, column
from outlast.envs.web.world_json import describe, events, snapshot
from tests.helpers.goal import TICK, won_at_the_limit
from tests.helpers.scenario_builder import ScenarioBuilder, duel


def happened(game: ScenarioBuilder) -> list[dict[str, Any]]:
    """Events of the last tick without what they leave open."""
    return [{k: v for k, v in event.items() if v not in (-1, "")} for event in events(game.env.worlds, 0)]


def test_where_all_are_left_nobody_is_said_to_be() -> None:
    env = make_vec(won_at_the_limit(), 1, seed=0)
    env.reset()
    for _ in range(TICK):
        env.step(env.noop[None, None].repeat(2, 1))
    assert [(event["kind"], event["side"], event["cause"]) for event in events(env.worlds, 0)] == [("end", -1, "rule")]


def test_boxes_break_are_picked_up_and_placed() -> None:
    game = ScenarioBuilder()
    game.put("agent", 0, 0, 0)
    game.put("box", 1, 1.2, 0)
    game.step({0: "attack"})
    assert happened(game) == [{"kind": "break", "agent": 0, "side": 0, "object": 1}]
    game.step(times=2)
    assert happened(game) == []
    game.hand(0, "box_item", 1)
    game.step({0: "use"})
    boxes = describe(game.env.worlds, 0)["objects"]
    assert happened(game) == [{"kind": "place", "agent": 0, "object": 3}]
    assert boxes[3]["role"] == "box_item"
    assert boxes[3]["of"] == 1
    assert snapshot(game.env.worlds, 0)["objects"][1]["owner"] == 0


def test_strikes_say_whether_they_met_something() -> None:
    game = duel(ScenarioBuilder())
    strikes = lambda: [agent["strike"] for agent in snapshot(game.env.worlds, 0)["agents"]]  # noqa: E731
    assert strikes() == [0, 0]
    game.step({0: "attack"})
    assert strikes() == [2, 0]
    game.put("agent", 1, 0, 8)
    game.step({0: "attack"})
    assert strikes() == [1, 0]


class Mark(Component):
    """A kind that has no shape, on the floor or in a bag."""

    worth: Array = column("i4")


class Marks(Module):
    """A place without a shape, and an item without one."""

    def archetypes(self) -> list[Archetype]:
        return [Archetype("base", (Body(x=1, y=2), Mark()), 1), Archetype("coin", (Body(x=3), Item(), Mark()), 1)]


def test_what_has_no_shape_is_shown_as_in_pictures() -> None:
    env = make_vec(variant("ffa_4").with_(Marks()), 1, seed=0)
    env.reset()
    pairs = zip(describe(env.worlds, 0)["objects"], snapshot(env.worlds, 0)["objects"], strict=True)
    found = {kind["kind"]: kind | place for kind, place in pairs}
    for name, role, x, y in (("base", "other", 1, 2), ("coin", "item", 3, 0)):
        shown = {key: found[name][key] for key in ("role", "radius", "hides", "here", "x", "y")}
        assert shown == {"role": role, "radius": 0.2, "hides": False, "here": True, "x": x, "y": y}

"""Events of single ticks, as pages and games show them."""

from typing import Any

from outlast.envs.inspect.events import events
from outlast.envs.inspect.trace import describe, snapshot
from tests.helpers.scenario_builder import ScenarioBuilder, duel, mates


def happened(stage: ScenarioBuilder) -> list[dict[str, Any]]:
    """Events of the last tick without what they leave open."""
    return [{k: v for k, v in event.items() if v not in (-1, "")} for event in events(stage.env.worlds, 0)]


def test_a_kill_names_who_died_and_by_whose_hand() -> None:
    stage = duel(ScenarioBuilder())
    stage.wound(1, 5)
    stage.step({0: "attack"})
    assert happened(stage) == [
        {"kind": "kill", "agent": 1, "by": 0, "side": 0, "cause": "melee"},
        {"kind": "end", "side": 0, "cause": "terminated"},
    ]


def test_in_a_team_it_was_the_one_that_struck() -> None:
    stage = mates(ScenarioBuilder("teams_3"))
    stage.wound(2, 5)
    stage.step({0: "attack", 1: "attack"})
    assert happened(stage) == [{"kind": "kill", "agent": 2, "by": 0, "side": 0, "cause": "melee"}]


def test_a_death_in_the_zone_is_nobodys() -> None:
    stage = ScenarioBuilder("teams_3")
    stage.put("agent", 3, 12, 12)
    stage.wound(3, 1)
    stage.step(times=2)
    assert happened(stage) == [{"kind": "death", "agent": 3, "cause": "zone"}]


def test_boxes_break_are_picked_up_and_placed() -> None:
    stage = ScenarioBuilder()
    stage.put("agent", 0, 0, 0)
    stage.put("box", 1, 1.2, 0)
    stage.step({0: "attack"})
    assert happened(stage) == [{"kind": "break", "agent": 0, "side": 0, "object": 1}]
    stage.step(times=2)
    assert happened(stage) == []
    stage.hand(0, "box_item", 1)
    stage.step({0: "use"})
    boxes = describe(stage.env.worlds, 0)["objects"]
    assert happened(stage) == [{"kind": "place", "agent": 0, "object": 3}]
    assert boxes[3]["role"] == "box_item"
    assert boxes[3]["of"] == 1
    assert snapshot(stage.env.worlds, 0)["objects"][1]["owner"] == 0


def test_a_heal_is_used() -> None:
    stage = ScenarioBuilder()
    stage.hand(1, "heal", 4)
    assert snapshot(stage.env.worlds, 0)["agents"][1]["bag"] == [8]
    stage.step({1: "use"})
    assert happened(stage) == [{"kind": "heal", "agent": 1, "object": 8}]
    assert snapshot(stage.env.worlds, 0)["agents"][1]["health"] == 175


def test_strikes_say_whether_they_met_something() -> None:
    stage = duel(ScenarioBuilder())
    strikes = lambda: [agent["strike"] for agent in snapshot(stage.env.worlds, 0)["agents"]]  # noqa: E731
    assert strikes() == [0, 0]
    stage.step({0: "attack"})
    assert strikes() == [2, 0]
    stage.put("agent", 1, 0, 8)
    stage.step({0: "attack"})
    assert strikes() == [1, 0]

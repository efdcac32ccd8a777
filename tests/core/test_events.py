"""Events of the game: they say all that changed, and nothing else."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from outlast import make_vec, systems, variant
from outlast.components import Bag, Box, BoxItem, End, Heal, Health, Phase, Side
from outlast.ecs import Array, Clock, Entity, Event, Rows, Write, column, emit
from outlast.envs.web.world_json import events as in_words
from outlast.errors import StateError
from tests.conftest import scaled
from tests.helpers.beasts import Beasts
from tests.helpers.mechanics import duel as make_duel
from tests.helpers.mechanics import idle, kind
from tests.helpers.scenario_builder import ScenarioBuilder, duel

CLOSE = {"room_size": 9.0, "pickup_reach": 1.0, "give_last_reach": 6.0, "n_boxes": 3, "melee_reach": 4.0}
CLOSE |= {"safe_zone_radii": (3.0, 2.0), "safe_zone_stand": 20, "safe_zone_shrink": 20}
CROWD = variant("teams_4").replace(**CLOSE, agents_health=12, ending_limit=90)
GAMES = {
    "teams": CROWD,
    "alone": variant("ffa_4").replace(**CLOSE, n_agents=5, agents_health=12),
    "dropping": CROWD.with_(systems.DropLast()).replace(melee_cooldown=3),
    "without a zone": CROWD.without("safe_zone").replace(agents_health=6),
}
WORLDS = 4


class Model:
    """A world as it is, then changed by nothing but events: who is there, bags and hit points. Rows are Python's."""

    def __init__(self, env: Any, w: int) -> None:
        worlds, layout = env.worlds, env.worlds.layout
        self.boxes, self.items = layout.rows(Box).tolist(), layout.rows(BoxItem).tolist()
        self.heals, self.numbers = layout.rows(Heal).tolist(), env.scenario.numbers()
        self.broken = [e for e in self.boxes if worlds[Box].broken[w, e]]
        self.there = worlds[Entity].alive[w].astype(bool).tolist()
        items, counts = worlds[Bag].items[w], worlds[Bag].count[w]
        self.bags = {e: items[e, : counts[e]].tolist() for e in layout.rows(Bag).tolist()}
        self.points = worlds[Health].points[w].tolist()

    def apply(self, events: dict[str, list[Any]]) -> None:
        """In the order of the phases: a box that broke before, items, hits, boxes, deaths, pickup."""
        used = [(event["agent"], event["item"]) for event in events["item_used"]]
        for box in self.broken:
            self.there[self.items[self.boxes.index(box)]] = True
        for agent, item in used:
            assert self.bags[agent].pop() == item
            self.points[agent] += self.numbers["heals_amount"] if item in self.heals else 0
        for event in events["box_placed"]:
            assert (event["agent"], self.items[self.boxes.index(event["box"])]) in used
            self.there[event["box"]] = True
        for event in events["item_given"]:
            assert self.bags[event["giver"]].pop() == event["item"]
            self.bags[event["taker"]].append(event["item"])
        for event in events["item_dropped"]:
            assert self.bags[event["agent"]].pop() == event["item"]
            self.there[event["item"]] = True
        for event in events["hit"]:
            self.points[event["target"]] -= event["amount"]
        for event in events["box_placed"]:
            self.points[event["box"]] = self.numbers["boxes_toughness"]
        for event in events["box_broken"]:
            assert self.points[event["box"]] <= 0
            self.there[event["box"]], self.points[event["box"]] = False, self.numbers["boxes_toughness"]
        for event in events["death"]:
            self.there[event["agent"]] = False
        for event in events["item_picked"]:
            self.bags[event["agent"]].append(event["item"])
            self.there[event["item"]] = False


def played(game: str, ticks: int, seed: int = 3) -> Iterator[tuple[Any, Any]]:
    """An environment, and random actions for its next step; worlds that have ended are reset."""
    env, rng = make_vec(GAMES[game], WORLDS, seed=seed, autoreset_mode="Disabled"), np.random.default_rng(seed)
    env.reset()
    for _ in range(ticks):
        yield env, rng.integers(0, env.action_sizes, (WORLDS, env.num_agents, len(env.action_sizes)))
        end = env.worlds[End]
        if (done := (end.terminated | end.truncated)[:, 0]).any():
            env.reset(options={"reset_mask": done})
            assert not any(done[rows["world"]].any() for rows in env.events().values())


@pytest.mark.parametrize("game", GAMES)
@pytest.mark.by_day(2)
def test_what_changes_is_what_the_events_say(game: str) -> None:
    seen: dict[str, int] = {}
    for env, actions in played(game, scaled(250, least=60)):
        before = [Model(env, w) for w in range(WORLDS)]
        env.step(actions)
        events = env.events()
        for w, model in enumerate(before):
            model.apply({name: [row for row in rows if row["world"] == w] for name, rows in events.items()})
            after = Model(env, w)
            assert (model.there, model.bags, model.points) == (after.there, after.bags, after.points)
        for name, rows in events.items():
            seen[name] = seen.get(name, 0) + len(rows)
            assert (rows["tick"] == env.worlds[Clock].tick[rows["world"], 0]).all()
    assert {name for name, count in seen.items() if not count} <= {"item_given", "item_dropped", "death"}


class Meeting(Event, capacity="agents"):
    agent: Array = column("i4", unit="entity")
    amount: Array = column("f4", 2)


Meetings = kind("Meetings", singletons=[Meeting()])


@Meetings.system(Phase.LOOK)
def meet(meetings: Write[Meeting], agents: Rows[Side]) -> None:
    for i in range(agents.size):
        k = emit(meetings)
        meetings.agent[k], meetings.amount[k, 1] = agents[i], 2.5


def test_events_may_have_several_amounts_and_be_of_others_than_agents(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", "outlast.deaths")
    env, found = make_duel(Meetings(), Beasts(), game=variant("ffa_2")), []
    for _ in range(10):
        env.step(idle(env))
        found += [(each["kind"], each["agent"], each["cause"]) for each in in_words(env.worlds, 0)]
    assert [each for each in found if "beast" in each[2]] == [("other", -1, f"death beast {k} melee") for k in (0, 1)]
    assert sum("meeting" in cause and "2.5" in cause for *_, cause in found) >= 18  # of both agents
    assert caplog.messages == [f"world 0, tick 5: beast {k} died of melee" for k in range(2)]


def short(mode: str, worlds: int = 3) -> Any:
    """Worlds that end, each at a time of its own, as everybody dies outside of the zone."""
    scenario = variant("ffa_2").replace(safe_zone_damage=35, safe_zone_stand=1, safe_zone_shrink=5)
    return make_vec(scenario, worlds, seed=1, autoreset_mode=mode)


def test_the_last_events_of_an_episode_are_there_after_a_reset_in_the_same_step() -> None:
    one, other = short("SameStep"), short("Disabled")
    one.reset(), other.reset()
    ends = 0
    for _ in range(60):
        idle = np.tile(one.noop, (3, one.num_agents, 1))
        one.step(idle)
        _, _, terminated, _, _ = other.step(idle)
        for name, rows in other.events().items():
            assert one.events()[name].tolist() == rows.tolist()
        ends += int(terminated.sum())
        if terminated.any():
            other.reset(options={"reset_mask": terminated})
            dead = one.events()["death"]
            assert set(np.flatnonzero(terminated)) <= set(dead["world"].tolist())
            assert (dead["tick"] > 0).all()
            one.reset(options={"reset_mask": terminated})
            other.reset(options={"reset_mask": terminated})
            assert not terminated[one.events()["death"]["world"]].any()
    assert ends > 6


@pytest.mark.parametrize(
    ("event", "column", "value", "words"),
    [
        ("Hit", "count", 99, "Hit.count is not between 0 and 4"),
        ("Hit", "target", 10**6, "Hit.target is not between -1 and"),
        ("Hit", "agent", -2, "Hit.agent is not between -1 and"),
        ("Hit", "damage_type", 2, "Hit.damage_type is not between -1 and 1"),
    ],
)
def test_states_with_impossible_events_are_refused(event: str, column: str, value: int, words: str) -> None:
    game = duel(ScenarioBuilder())
    game.step({0: "attack"})
    kind = next(kind for kind in game.env.worlds.layout.events if kind.__name__ == event)
    getattr(game.env.worlds[kind], column)[0, 0] = value
    state = game.env.get_state()
    game.env.worlds.event_memory.counts[:] = 0
    with pytest.raises(StateError, match=words):
        game.env.set_state(state)
    assert len(game.env.events()["hit"]) == 0

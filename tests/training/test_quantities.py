"""What a run logs of episodes and behaviour, counted again in plain Python in worlds that do the same."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast import Scenario, choice, integers, make_vec, variant
from outlast.components import Item
from outlast.ecs import Entity
from tests.conftest import draw_actions
from tests.helpers.beasts import Beasts

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast.training.base.config import TrainingConfig  # noqa: E402
from outlast.training.base.curves import Curves  # noqa: E402
from outlast.training.base.metrics import AgentMetrics  # noqa: E402
from outlast.training.base.run_summary import headline  # noqa: E402
from outlast.training.plots.panels import chosen, drawn  # noqa: E402
from outlast.training.plots.runs import Run  # noqa: E402
from outlast.training.ppo.trainer import Trainer  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")
WORLDS, STEPS = 8, 200
SHORT = {
    "agents_health": 60,
    "heals_amount": 10,
    "safe_zone_radii": (4.0,),
    "safe_zone_stand": 30,
    "safe_zone_shrink": 20,
}
GIVING = {"give_last_reach": 4.0, "give_last_nearest": "suitable"}
CLOSE = {"room_size": 8.0, "pickup_reach": 1.5, "n_boxes": 1, "rewards_death": -3.0, **GIVING}
CROWD = variant("teams_3").replace(**SHORT, **CLOSE)  # they meet, fight and give


def make(scenario: Scenario = CROWD) -> Trainer:
    return Trainer(TrainingConfig(scenario, worlds=WORLDS, rollout=WORLDS * STEPS, seed=12))


def collected(trainer: Trainer) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Rows about each living agent before each step of a rollout, and the statistics of episodes that ended."""
    rows, episodes = [], []
    env = make_vec(trainer.env.scenario, WORLDS, autoreset_mode="Disabled")
    observations = env.set_state(trainer.env.get_state())
    rollout = trainer.collect()
    agents, heals = env.worlds.span("agent"), env.worlds.span("heal")
    for actions in rollout.actions.reshape(STEPS, WORLDS, 4, -1):
        alive = env.worlds[Entity].alive[:, agents] != 0
        seen = {key: observations[key].copy() for key in ("own", "zone")}
        reaches = np.broadcast_to(env.worlds.number("melee_reach"), WORLDS)
        observations, _, terminated, truncated, info = env.step(actions)
        after, lives, given = env.worlds[Item].holder[:, heals], env.worlds[Entity].alive, env.events()["item_given"]
        for w in range(WORLDS):
            gifts = [
                gift
                for gift in given
                if gift["world"] == w and lives[w, gift["giver"]] and heals.start <= gift["item"] < heals.stop
            ]
            rows += [agent(seen, alive, actions, w, i, reaches[w]) for i in range(4) if alive[w, i]]
            episodes += [{key: values[w] for key, values in info["statistics"].items()}] if terminated[w] else []
            rows.append({"given": len(gifts), "held": int((after[w] >= 0).sum())})
        if terminated.any():
            observations, _ = env.reset(options={"reset_mask": terminated})
    assert not truncated.any()
    return rows, episodes


def agent(seen: dict[str, Any], alive: Any, actions: Any, w: int, i: int, reach: float) -> dict[str, Any]:
    places = seen["own"][w, :, 3:5]
    apart = [np.hypot(*(places[i] - places[j])) for j in range(4) if (j < 2) != (i < 2) and alive[w, j]]
    distance = np.hypot(*(places[i] - seen["zone"][w, i, :2]))
    return {"attack": actions[w, i, 3], "near": bool(apart) and min(apart) <= reach + 0.5, "distance": distance}


@pytest.mark.parametrize("scenario", [CROWD, CROWD.vary(melee_reach=choice(0.5, 5.0))], ids=["one reach", "varied"])
def test_behaviour_is_as_counted_in_plain_python(scenario: Scenario) -> None:
    trainer = make(scenario)
    rows, _ = collected(trainer)
    report = {tag: value for tag, value in trainer.report().items() if tag.startswith("behaviour/")}
    living = [row for row in rows if "near" in row]
    near, far = ([row["attack"] for row in living if row["near"] == which] for which in (True, False))
    assert min(len(near), len(far)) > 100
    given, held = (sum(row[key] for row in rows if key in row) for key in ("given", "held"))
    assert min(given, held) > 0
    expected = {
        "alive": len(living) / (WORLDS * STEPS * 4),
        "near": len(near) / len(living),
        "attack_near": np.mean(near),
        "attack_far": np.mean(far),
        "zone_distance": np.mean([row["distance"] for row in living]),
        "heals_held": held / len(living),
        "heals_given": 1000 * given / len(living),
    }
    assert report == pytest.approx({f"behaviour/{key}": value for key, value in expected.items()}, rel=1e-4)


def test_heals_of_opponents_do_not_count() -> None:
    """Hoarders have most of them."""
    numbers = {"worlds": WORLDS, "rollout": WORLDS * STEPS, "seed": 12}
    trainer = Trainer(TrainingConfig(CROWD, opponents={"hoarder": 1.0}, **numbers))
    env = make_vec(trainer.env.scenario, WORLDS, autoreset_mode="Disabled")
    env.set_state(trainer.env.get_state())
    rollout = trainer.collect()
    agents, heals = env.worlds.span("agent"), env.worlds.span("heal")
    held, given, count = np.zeros(2), np.zeros(2), np.zeros(2)  # of opponents, of learners
    learners = rollout.learner.reshape(STEPS, WORLDS, 4) >= 0
    for actions, learns in zip(rollout.actions.reshape(STEPS, WORLDS, 4, -1), learners, strict=True):
        alive = env.worlds[Entity].alive[:, agents] != 0
        for own in (0, 1):
            count[own] += (alive & (learns == own)).sum()
        _, _, terminated, truncated, _ = env.step(actions)
        for w, who in zip(*np.nonzero((holder := env.worlds[Item].holder[:, heals]) >= 0), strict=True):
            held[int(learns[w, holder[w, who] - agents.start])] += 1
        for gift in env.events()["item_given"]:
            if heals.start <= gift["item"] < heals.stop and env.worlds[Entity].alive[gift["world"], gift["giver"]]:
                given[int(learns[gift["world"], gift["giver"] - agents.start])] += 1
        if (ended := terminated | truncated).any():
            env.reset(options={"reset_mask": ended})
    report = trainer.report()
    assert report["behaviour/heals_held"] == pytest.approx(held[1] / count[1])
    assert report["behaviour/heals_given"] == pytest.approx(1000 * given[1] / count[1])
    assert held[0] / count[0] > 1.5 * held[1] / count[1] > 0


def test_one_world_is_judged_by_the_reach_of_each_episode_too() -> None:
    trainer = Trainer(TrainingConfig(CROWD.vary(melee_reach=choice(0.5, 5.0)), worlds=1, rollout=STEPS, seed=1))
    trainer.collect()
    behaviour = trainer.lane.behaviour
    assert len(behaviour._reaches) == STEPS
    assert len({float(reach.item()) for reach in behaviour._reaches}) == 2


def test_episodes_are_those_that_ended() -> None:
    trainer = make()
    _, episodes = collected(trainer)
    report = trainer.report()
    assert len(episodes) == report["rollout/episodes"] > 3

    def mean(key: str, index: Any = ()) -> float:
        return float(np.mean([episode[key][index] for episode in episodes]))

    assert "rollout/reward2" not in report
    expected = {
        "steps": mean("length"),
        "reward0": mean("return", 0),
        "reward1": mean("return", 2),  # of the first agent of the second team
        "kills0": mean("kills", 0),
        "kills1": mean("kills", 1),
        "heals_used": mean("heals_used"),
        "boxes_placed": mean("boxes_placed"),
        "deaths_melee": mean("deaths_melee"),
    }
    assert {key: report[f"rollout/{key}"] for key in expected} == pytest.approx(expected)
    assert expected["heals_used"] > 0
    assert expected["reward0"] != expected["reward1"]
    assert trainer.lane.episodes.tallies() == {"rollout/episodes": (0.0, 1.0)}


def test_kills_of_all_sides_where_not_all_episodes_have_all() -> None:
    """Means of sides are over the episodes that have them, and would add up to too many."""
    trainer = make(variant("ffa_2").replace(**SHORT, room_size=8.0, melee_damage=30).vary(n_agents=integers(2, 4)))
    _, episodes = collected(trainer)
    report = trainer.report()
    kills = [np.sum(episode["kills"]) for episode in episodes]
    assert report["rollout/kills"] == np.mean(kills) > 0
    assert sum(report[f"rollout/kills{k}"] for k in range(4)) > np.mean(kills)
    assert next(figure.value for figure in headline(report) if figure.name == "kills") == np.mean(kills)
    run = Run(Path("a"), "", {}, {}, Curves(np.array([1]), {tag: np.array([value]) for tag, value in report.items()}))
    assert drawn(run, chosen([run], ["kills"])).values["kills"].tolist() == [np.mean(kills)]
    assert list(drawn(run, chosen([run], ["rollout/kills3"])).values) == ["rollout/kills3"]


def test_an_evaluation_counts_gifts_by_giver() -> None:
    env = make_vec(CROWD, WORLDS, seed=4, autoreset_mode="Disabled")
    env.reset()
    metrics, rng = AgentMetrics(env), np.random.default_rng(4)
    agents, heals = env.worlds.span("agent"), env.worlds.span("heal")
    expected = np.zeros((WORLDS, 4))
    for _ in range(STEPS):
        actions = draw_actions(env, rng)
        metrics.before_step(actions)
        _, _, terminated, _, _ = env.step(actions)
        metrics.after_step()
        for gift in env.events()["item_given"]:
            w, giver, item = gift["world"], gift["giver"], gift["item"]
            expected[w, giver - agents.start] += env.worlds[Entity].alive[w, giver] and heals.start <= item < heals.stop
        if terminated.any():
            env.reset(options={"reset_mask": terminated})
            metrics.reset(terminated)
            expected[terminated] = 0
    env.close()
    assert (metrics.totals["heals_given"] == expected).all()
    assert (expected > 0).any(1).sum() > 1


@pytest.mark.parametrize("order", [0, 60])  # their rows come before those of agents, or after
def test_an_evaluation_counts_no_deaths_of_animals(order: int) -> None:
    env = make_vec(variant("ffa_1").with_(Beasts(order=order)), 1, seed=0)
    env.reset()
    metrics, actions = AgentMetrics(env), np.tile(env.noop, (1, 2, 1))
    for _ in range(6):
        metrics.before_step(actions)
        env.step(actions)
        metrics.after_step()
    assert not env.worlds[Entity].alive[:, env.worlds.span("beast")].any()
    assert not any(metrics.totals[name].any() for name in metrics.totals if name.startswith("deaths_"))

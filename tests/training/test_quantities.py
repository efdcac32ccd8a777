"""What is logged of episodes and behaviour, counted again in plain Python; and games of one's own."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

import outlast
from outlast import Scenario, make_vec, variant
from outlast.components import Item, Phase, Side
from outlast.distributions import choice, integers
from outlast.ecs import Array, Entity, Module, Read, Rows, Statistic, Write, column
from outlast.training.base.config import TrainingConfig
from outlast.training.base.curves import Curves
from outlast.training.base.metrics import AgentMetrics
from outlast.training.base.quantities import headline
from outlast.training.plots.comparison import chosen, drawn
from outlast.training.plots.runs import Run
from outlast.training.ppo.trainer import Trainer
from tests.helpers.beasts import Beasts

WORLDS, STEPS = 8, 200
SHORT = {"safe_zone_radii": (4.0,), "safe_zone_stand": 30, "safe_zone_shrink": 20, "agents_health": 60}
SHORT |= {"heals_amount": 10}
SOON = {"safe_zone_damage": 50, "safe_zone_stand": 10, "safe_zone_shrink": 5}
GIVING = {"give_last_reach": 4.0, "give_last_nearest": "suitable"}
CLOSE = {"room_size": 8.0, "pickup_reach": 1.5, "n_boxes": 1, "rewards_death": -3.0, **GIVING}
CROWD = variant("teams_3").replace(**SHORT, **CLOSE)  # they meet, fight and give


def make(scenario: Scenario = CROWD, **changes: Any) -> Trainer:
    return Trainer(TrainingConfig(scenario, worlds=WORLDS, rollout=WORLDS * STEPS, seed=12, **changes))


def collected(trainer: Trainer) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Rows about each living agent that learns, before each step of a rollout; statistics of episodes that ended."""
    rows, episodes = [], []
    env = make_vec(trainer.env.scenario, WORLDS, autoreset_mode="Disabled")
    observations = env.set_state(trainer.env.get_state())
    rollout = trainer.collect()
    agents, heals = env.worlds.span("agent"), env.worlds.span("heal")
    every = rollout.learner.reshape(STEPS, WORLDS, 4) >= 0
    for actions, learns in zip(rollout.actions.reshape(STEPS, WORLDS, 4, -1), every, strict=True):
        alive = env.worlds[Entity].alive[:, agents] != 0
        seen = {key: observations[key].copy() for key in ("own", "zone")}
        reaches = np.broadcast_to(env.worlds.number("melee_reach"), WORLDS)
        observations, _, terminated, truncated, info = env.step(actions)
        after, lives, given = env.worlds[Item].holder[:, heals], env.worlds[Entity].alive, env.events()["item_given"]
        for w in range(WORLDS):
            own = [gift for gift in given if gift["world"] == w and lives[w, gift["giver"]]]
            gifts = [gift for gift in own if heals.start <= gift["item"] < heals.stop]
            gifts = [gift for gift in gifts if learns[w, gift["giver"] - agents.start]]
            rows += [agent(seen, alive, actions, w, i, reaches[w]) for i in range(4) if alive[w, i] and learns[w, i]]
            episodes += [{key: values[w] for key, values in info["statistics"].items()}] if terminated[w] else []
            held = sum(learns[w, holder - agents.start] for holder in after[w] if holder >= 0)
            rows.append({"given": len(gifts), "held": int(held)})
        if terminated.any():
            observations, _ = env.reset(options={"reset_mask": terminated})
    assert not truncated.any()
    return rows, episodes


def agent(seen: dict[str, Any], alive: Any, actions: Any, w: int, i: int, reach: float) -> dict[str, Any]:
    places = seen["own"][w, :, 3:5]
    apart = [np.hypot(*(places[i] - places[j])) for j in range(4) if (j < 2) != (i < 2) and alive[w, j]]
    distance = np.hypot(*(places[i] - seen["zone"][w, i, :2]))
    return {"attack": actions[w, i, 3], "near": bool(apart) and min(apart) <= reach + 0.5, "distance": distance}


@pytest.mark.parametrize(
    ("scenario", "changes"),
    [(CROWD, {}), (CROWD.vary(melee_reach=choice(0.5, 5.0)), {}), (CROWD, {"opponents": {"hoarder": 1.0}})],
    ids=["one reach", "varied", "opponents"],
)
def test_behaviour_and_episodes_are_as_counted_in_plain_python(scenario: Scenario, changes: dict[str, Any]) -> None:
    """Opponents that hoard have most of the heals, and are not learners."""
    trainer = make(scenario, **changes)
    rows, episodes = collected(trainer)
    report = trainer.report()
    living = [row for row in rows if "near" in row]
    near, far = ([row["attack"] for row in living if row["near"] == which] for which in (True, False))
    assert min(len(near), len(far)) > 100
    given, held = (sum(row[key] for row in rows if key in row) for key in ("given", "held"))
    assert min(given, held) > 0
    count = len(living)
    expected = {"near": len(near) / count, "attack_near": np.mean(near), "attack_far": np.mean(far)}
    expected |= {"zone_distance": np.mean([row["distance"] for row in living])}
    expected |= {"heals_held": held / count, "heals_given": 1000 * given / count}
    if not changes:
        expected |= {"alive": count / (WORLDS * STEPS * 4)}
    assert {key: report[f"behaviour/{key}"] for key in expected} == pytest.approx(expected, rel=1e-4)

    def mean(key: str, index: Any = ()) -> float:
        return float(np.mean([episode[key][index] for episode in episodes]))

    assert len(episodes) == report["rollout/episodes"] > 3
    assert "rollout/reward2" not in report
    ended = {key: mean(key) for key in ("heals_used", "boxes_placed", "deaths_melee")} | {"steps": mean("length")}
    ended |= {f"kills{side}": mean("kills", side) for side in (0, 1)}
    if not changes:  # otherwise rewards are those of learners; the first agent of the second team has number 2
        ended |= {"reward0": mean("return", 0), "reward1": mean("return", 2)}
        assert ended["reward0"] != ended["reward1"]
    assert {key: report[f"rollout/{key}"] for key in ended} == pytest.approx(ended)
    assert ended["heals_used"] > 0
    assert trainer.lane.episodes.tallies() == {"rollout/episodes": (0.0, 1.0)}


def test_kills_of_all_sides_where_not_all_episodes_have_all() -> None:
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


@dataclass(frozen=True)
class Steps(Module):
    name: ClassVar[str] = "steps_lived"

    def singletons(self) -> list[Any]:
        return [Lived()]


class Lived(Statistic):
    lived: Array = column("i4", "agents")
    team_lived: Array = column("i4", "sides")


@Steps.system(Phase.RECORD)
def count_steps(entities: Read[Entity], agents: Rows[Side], side: Read[Side], counts: Write[Lived]) -> None:
    for i in range(agents.size):
        if entities.alive[agents[i]]:
            counts.lived[i] += 1
            counts.team_lived[side.side[agents[i]]] += 1


def test_statistics_of_ones_own_are_columns() -> None:
    """Of agents the mean over them, of sides the sum, as of the game's own return and kills."""
    game = variant("teams_2").replace(**SOON).with_(Steps())
    found = outlast.evaluate(game, ["noop", "random"], episodes=8, worlds=4, quiet=True)
    for pair in (("noop", "random"), ("random", "noop")):
        of = found.estimates(*pair)
        assert of["team_lived"][0] == pytest.approx(2 * of["lived"][0])
        assert 0 < of["lived"][0] <= of["life"][0]


def test_games_with_another_melee_or_without_melee() -> None:
    game = variant("ffa_1").replace(**SOON)
    found = outlast.evaluate(game.without("melee"), ["noop"], episodes=2, worlds=2, quiet=True)
    assert "near" not in found.estimates("noop", "noop")
    shares = []
    for reach in (1.0, 24.0):
        found = outlast.evaluate(game.with_(Strong(reach=reach)), ["noop"], episodes=2, worlds=2, quiet=True)
        shares.append(found.estimates("noop", "noop")["near"][0])
    assert shares[0] < 0.1 < shares[1]


ITEMS = ("inventory", "pickup", "give_last", "death_drop", "heals")


@pytest.mark.parametrize(
    ("without", "words"),
    [
        (("record",), r"ffa_1\S* has no statistic 'length': add the mechanic Record"),
        (("agents",), "'agent', but none declares how many there are; add Agents"),
        (("motors", "melee", *ITEMS), "agents have no actions here: add a mechanic with some, such as Motors"),
    ],
)
def test_games_that_cannot_be_trained_are_refused(without: tuple[str, ...], words: str, tmp_path: Path) -> None:
    with pytest.raises(outlast.errors.OutlastError, match=words):
        outlast.train(variant("ffa_1").without(*without), tmp_path / "run", worlds=2, rollout=64, quiet=True)
    assert not (tmp_path / "run").exists()


def test_a_game_without_melee_is_trained_and_its_plot_says_what_numbers_are_of(tmp_path: Path) -> None:
    game = variant("teams_2").replace(**SOON).without("melee")
    small: dict[str, Any] = {"steps": 1, "worlds": 8, "rollout": 512, "threads": 1, "quiet": True}
    run = outlast.train(game.with_(Steps()), tmp_path / "run", **small)
    assert "behaviour/near" not in run.logged
    assert run.logged["rollout/lived0"] > 0
    found = outlast.plot(run.folder, tmp_path / "out", curves=("lived", "team_lived", "return"))
    titles = ["lived, mean over agents", "team lived, mean over sides", "return, mean over sides"]
    assert [panel.title for panel in found.panels] == titles


def test_figures_of_agents_are_means_over_episodes_however_many_agents_they_have() -> None:
    game = variant("teams_2").vary(n_agents=outlast.distributions.integers(2, 4)).replace(ending_limit=60)
    found = outlast.evaluate(game.with_(Steps()), ["scripted", "noop"], episodes=24, worlds=8, quiet=True)
    (match,) = (pairing.results for pairing in found.pairings if pairing.pair == (0, 1))
    lived = match.figures["lived"][:, :, 0]
    assert (lived[..., 1] == 1).all()
    assert (lived[..., 0] <= 60).all()  # ticks of one agent
    assert found.estimates("scripted", "noop")["lived"][0] == pytest.approx(lived[..., 0].mean())


class Strong(outlast.systems.Melee):
    name = "strong"

"""Groups of runs that differ by seeds: which they are, their ratings and wins by hand, and what the report says."""

import json
import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast import variant
from outlast.training.arena import evaluation as report
from outlast.training.arena.evaluation import Evaluation
from outlast.training.arena.groups import PolicyGroup, group_policies, rate_groups
from outlast.training.arena.players import Contender, contenders
from outlast.training.base.config import TrainingConfig
from outlast.training.base.errors import TrainingError
from outlast.training.policies import checkpoint
from outlast.training.ppo.trainer import Trainer
from outlast.training.runs import resume

pytestmark = pytest.mark.usefixtures("one_torch_thread")

PLAN = {"preset": "fast", "seed": 0, "worlds": 64, "rollout": 1024, "settings": {}}


def policy(label: str, plan: dict[str, Any] | None = None, steps: int = 100, **numbers: float) -> Any:
    """A contender as far as groups ask for it."""
    header = {"plan": plan or {}, "steps": steps, "scenario": {"name": "ffa_2", "numbers": numbers}}
    return SimpleNamespace(label=label, text=f"{label}.zip", player=SimpleNamespace(header=header))


def seeds(label: str, plan: dict[str, Any], count: int, **options: Any) -> list[Any]:
    return [policy(f"{label}{seed}", plan | {"seed": seed}, **options) for seed in range(count)]


def test_groups_are_runs_that_differ_by_seeds() -> None:
    fast, scaled = seeds("f", PLAN, 3), seeds("s", PLAN | {"preset": "scaled"}, 2)
    chosen = [Contender("random", "random"), *fast[:2], *scaled, policy("kept"), fast[2]]
    assert group_policies(chosen) == [
        PolicyGroup("random", (0,), False),
        PolicyGroup("fast", (1, 2, 6), True),
        PolicyGroup("scaled", (3, 4), True),
        PolicyGroup("kept", (5,), False),  # it does not say how it was trained
    ]
    assert group_policies(fast) == [PolicyGroup("ffa_2", (0, 1, 2), True)]
    games = [*fast[:2], *seeds("other", PLAN | {"preset": "paper"}, 2)]
    for each in games[2:]:
        each.player.header["scenario"]["name"] = "ffa_1"
    assert [group.label for group in group_policies(games)] == ["ffa_2, fast", "ffa_1, paper"]
    other = [*fast, *seeds("o", PLAN, 1, melee_damage=20), *seeds("older", PLAN, 1, steps=200)]
    assert [group.members for group in group_policies(other)] == [(0, 1, 2), (3,), (4,)]
    with pytest.raises(TrainingError, match=r"f0.zip and again.zip are the same run, or both of seed 0"):
        group_policies([*fast, policy("again", PLAN)])


def test_ratings_and_wins_of_groups_by_hand() -> None:
    groups = [PolicyGroup("a", (0, 2), True), PolicyGroup("b", (1,), True)]
    wins, draws = np.zeros((2, 3, 3))
    wins[0, 1], wins[1, 0] = 800, 200
    wins[2, 1], wins[1, 2], draws[1, 2], draws[2, 1] = 300, 500, 200, 200
    wins[0, 2] = 1000  # games within a group do not count
    found = rate_groups(groups, wins, draws, seed=0)
    assert found.wins.value[0, 1] == pytest.approx((0.8 + 0.4) / 2)
    assert found.wins.value[1, 0] == pytest.approx(0.4)
    assert np.isnan(np.diag(found.wins.value)).all()
    assert found.ratings.value[0] - found.ratings.value[1] == pytest.approx(400 * math.log10(600.5 / 400.5))
    low, high = found.wins.low[0, 1], found.wins.high[0, 1]  # all resampled runs may be the one or the other
    assert (low, high) == pytest.approx((0.4, 0.8), abs=0.05)
    assert found.wins.low[1, 0] == pytest.approx(1 - high)
    again = rate_groups(groups, wins, draws, seed=0)
    assert np.array_equal(again.ratings.low, found.ratings.low)


def test_the_interval_of_single_runs_is_of_games_alone() -> None:
    wins = np.array([[0.0, 300], [100, 0]])
    found = rate_groups([PolicyGroup("a", (0,), True), PolicyGroup("b", (1,), False)], wins, np.zeros((2, 2)), 0, 4000)
    half = 1.96 * math.sqrt(0.75 * 0.25 / 400)
    assert (found.wins.low[0, 1], found.wins.high[0, 1]) == pytest.approx((0.75 - half, 0.75 + half), abs=0.006)


def pair(wins: float, losses: float, seed: int = 0, reps: int = 2000) -> Any:
    """Ratings of two single runs, of which the first has won and lost so many games against the second."""
    groups = [PolicyGroup("a", (0,), True), PolicyGroup("b", (1,), False)]
    return rate_groups(groups, np.array([[0, wins], [losses, 0]]), np.zeros((2, 2)), seed, reps)


def test_who_wins_every_game_may_lose_others_and_may_be_any_better() -> None:
    found = pair(20, 0)
    assert found.wins.value[0, 1] == found.wins.high[0, 1] == 1
    assert found.wins.value[1, 0] == found.wins.low[1, 0] == 0
    assert 0.8 < found.wins.low[0, 1] < 0.95
    found = pair(1000, 0)
    chance = 5.0239 / 2 / 1001  # of a loss, by Jeffreys: of a beta (1/2, 1000.5), as good as a chi square of 1 degree
    assert found.ratings.low[0] == pytest.approx(1000 + 200 * math.log10((1 - chance) / chance), abs=10)
    assert found.ratings.low[0] + 100 < found.ratings.value[0] == pytest.approx(1000 + 200 * math.log10(1000.5 / 0.5))
    assert found.ratings.high[0] == np.inf
    assert found.ratings.low[1] == -np.inf


def test_a_chain_of_losses_bounds_a_rating_and_who_is_between_is_bounded_on_no_side() -> None:
    groups = [PolicyGroup(name, (k,), True) for k, name in enumerate("abc")]
    wins = np.array([[0.0, 50, 40], [0, 0, 30], [10, 20, 0]])  # a loses to c, who loses to b
    found = rate_groups(groups, wins, np.zeros((3, 3)), 0)
    assert np.isfinite(found.ratings).all()
    assert ((found.ratings.low < found.ratings.value) & (found.ratings.value < found.ratings.high)).all()
    found = rate_groups(groups, np.triu(np.full((3, 3), 50.0), 1), np.zeros((3, 3)), 0)
    assert np.isinf(found.ratings.low).tolist() == [False, True, True]
    assert np.isinf(found.ratings.high).tolist() == [True, True, False]


def test_intervals_cover_what_is_true_where_losses_are_rare() -> None:
    chance, rng = 0.9995, np.random.default_rng(0)
    truth, inside = 1000 + 200 * math.log10(chance / (1 - chance)), 0
    for seed in range(60):
        lost = rng.binomial(300, 1 - chance)
        _, (low, _), (high, _) = pair(300 - lost, lost, seed, 200).ratings
        inside += low <= truth <= high
    assert inside >= 56


def test_intervals_cover_what_other_seeds_achieve() -> None:
    """Of 8 runs whose chances against one opponent scatter: 95 % intervals hold the mean in most of cases."""
    rng, inside, tables = np.random.default_rng(0), 0, 100
    groups = [PolicyGroup("a", tuple(range(8)), True), PolicyGroup("b", (8,), False)]
    for table in range(tables):
        wins = np.zeros((9, 9))
        wins[:8, 8] = rng.binomial(300, rng.uniform(0.3, 0.7, 8))
        wins[8, :8] = 300 - wins[:8, 8]
        found = rate_groups(groups, wins, np.zeros((9, 9)), table, 100)
        inside += found.wins.low[0, 1] <= 0.5 <= found.wins.high[0, 1]
    assert 85 <= inside <= 99


def test_the_report_has_tables_of_groups_and_says_what_errors_are_of(tmp_path: Path) -> None:
    for name, worlds, seed in (("a", 4, 0), ("b", 4, 1), ("c", 8, 0)):
        config = TrainingConfig(variant("ffa_2"), "fast", worlds=worlds, rollout=256, seed=seed)
        checkpoint.write_checkpoint(tmp_path / f"{name}.zip", resume.capture(Trainer(config), config.header()))
    quick = variant("ffa_2").replace(safe_zone_damage=50, safe_zone_stand=5)
    chosen = contenders([*(tmp_path / f"{name}.zip" for name in "abc"), "noop"])
    evaluation = Evaluation(quick, chosen, episodes=8, worlds=8)
    evaluation.play_pair(evaluation.pairs[0])
    assert evaluation.groups() is None
    evaluation.pairings.clear()
    evaluation.play()
    evaluation.close()
    text = str(evaluation)
    assert "over games of these very policies" in text
    assert "\nworlds=4: a, b\n95 % intervals over training seeds and games" in text
    assert text.index("Elo of groups") < text.index("wins of group, against") < text.index("\nc: one run: its error is")
    assert "its error is of games alone, and says nothing of other seeds" in text
    narrow = report.text(evaluation, 80)
    tables = [line for line in narrow.split("\n") if "  " in line]
    assert max(map(len, tables)) <= 80 < max(map(len, text.split("\n")))
    assert sorted({*narrow.split()}) == sorted({*text.split()})
    report.write_tables(evaluation, tmp_path)
    rows = (tmp_path / "groups.csv").read_text().splitlines()
    assert rows[0] == "group,runs,against,figure,value,low,high"
    assert [row.split(",")[:4] for row in rows[1:5]] == [
        ["worlds=4", "2", "", "elo"],
        ["worlds=4", "2", "c", "wins"],
        ["worlds=4", "2", "noop", "wins"],
        ["c", "1", "", "elo"],
    ]
    kept = json.loads((tmp_path / "evaluation.json").read_text())["groups"]
    assert (len(kept), kept[0]["group"], kept[0]["figure"]) == (9, "worlds=4", "elo")


def test_without_seeds_there_are_no_groups_and_of_one_run_twice_the_report_says_why() -> None:
    played = SimpleNamespace(chosen=[policy("a", PLAN), policy("b", PLAN)], groups=lambda: None)
    (reason,) = report._groups(played, None)  # type: ignore[arg-type]
    assert reason.startswith("no groups of training seeds: a.zip and b.zip are the same run, or both of seed 0")
    played.chosen = [Contender("random", "random"), Contender("noop", "noop")]
    assert list(report._groups(played, None)) == []  # type: ignore[arg-type]


def test_the_report_says_what_no_bound_is_and_json_has_none() -> None:
    played = SimpleNamespace(chosen=[policy("a", PLAN), policy("b", PLAN)], groups=lambda: pair(20, 0))
    text = report._group_ratings(played, pair(20, 0))  # type: ignore[arg-type]
    assert re.search(r"a  .* \[\d+, inf\]\nb  .* \[-inf, \d+\]\n.*; inf: no game bounds the rating on that side", text)
    assert "inf:" not in report._group_ratings(played, pair(15, 5))  # type: ignore[arg-type]
    (row, *_) = report._json(report._group_rows(played))  # type: ignore[arg-type]
    assert row[-1] is None
    assert 1000 < row[-2] < row[-3]

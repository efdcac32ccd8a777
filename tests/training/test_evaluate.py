"""Cross-play, counted again in plain Python; ratings; groups of runs; outlast evaluate; saved policies in commands."""

import json
import math
import re
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import torch

import outlast
from outlast import load_policy, make_vec, variant
from outlast.ecs.kernels.errors import OutlastError
from outlast.envs.cli import main as cli
from outlast.envs.errors import UsageError
from outlast.envs.rendering.canvas import Canvas
from outlast.envs.rollout.lineup import entries_of, parse_lineup
from outlast.envs.rollout.policies import POLICIES
from outlast.envs.scenarios.scenario import Scenario
from outlast.training.arena import evaluation as report
from outlast.training.arena.evaluation import Evaluation, film_players
from outlast.training.arena.match import Match, ratio
from outlast.training.arena.players import Contender, contenders, labels
from outlast.training.arena.ratings import PolicyGroup, anchored, elo, group_policies, rate_groups
from outlast.training.base.config import TrainingConfig
from outlast.training.base.errors import TrainingError
from outlast.training.base.presets import PRESETS
from outlast.training.base.quantities import COLUMNS, explained
from outlast.training.cli import evaluate as evaluate_command
from outlast.training.policies import checkpoint
from outlast.training.policies.player import Player
from outlast.training.ppo.trainer import Trainer, capture
from tests.conftest import call, interrupted_after
from tests.helpers.checkpoints import KEPT
from tests.helpers.outputs import rows_of
from tests.training.test_player import saved

QUICK = {"safe_zone_damage": 20, "safe_zone_stand": 20, "safe_zone_shrink": 10, "melee_damage": 20}  # 100 steps


def quick(name: str) -> Scenario:
    return variant(name).replace(**QUICK)


def evaluated(name: str, *texts: object, **options: Any) -> Evaluation:
    evaluation = Evaluation(quick(name), contenders([str(text) for text in texts]), **options)
    evaluation.play()
    evaluation.close()
    return evaluation


def counted(scenario: Scenario, names: tuple[str, str], worlds: int, each: int, seed: int) -> dict[str, Any]:
    """Figures of a match of named policies, (worlds, each, roles), by one agent of one world after the other."""
    env = make_vec(scenario, worlds, seed=seed, autoreset_mode="Disabled")
    policies = [POLICIES[name](env, seed) for name in names]
    observations, _ = env.reset(seed=seed)
    agents, size = range(env.num_agents), max(1, env.num_agents // 2)  # of a team; or each on its own
    figures = {name: np.zeros((worlds, each, 2)) for name in ("wins", "length", "life", "return", "kills", "dead")}
    figures |= {name: np.zeros((worlds, each, 2)) for name in ("attacks", "chances")}
    count, ticks, last = [0] * worlds, [0] * worlds, np.zeros((worlds, 2), int)

    def add(name: str, w: int, i: int, value: float) -> None:
        figures[name][w, count[w], (i // size + w + count[w]) % 2] += value

    while min(count) < each:
        seen = observations["own"][..., -7:].copy()
        choices = [policy(observations) for policy in policies]
        actions = np.zeros_like(choices[0])
        for w, i in np.ndindex(worlds, env.num_agents):
            actions[w, i] = choices[(i // size + w + count[w]) % 2][w, i]
        going = [(w, i) for w in range(worlds) for i in agents if count[w] < each]
        for w, i in going:
            enemies = [seen[w, j] for j in agents if j // size != i // size and seen[w, i].any()]
            near = any(row.any() and np.hypot(*(row[1:3] - seen[w, i, 1:3])) <= 2.5 for row in enemies)
            add("chances", w, i, near)
            add("attacks", w, i, near and actions[w, i, 3])
        observations, rewards, done, _, info = env.step(actions)
        living = observations["own"][..., -7:].any(-1)
        for w, i in going:
            ticks[w] += i == 0
            last[w, i // size] = ticks[w] if living[w, i] else last[w, i // size]
            add("return", w, i, rewards[w, i] / size)
            add("dead", w, i, done[w] and not living[w, i])
        for w in {w for w, _ in going if done[w]}:
            here, sides = (w, count[w]), [(role + w + count[w]) % 2 for role in (0, 1)]
            lives = last[w, sides]
            figures["life"][here], figures["length"][here] = lives, ticks[w]
            figures["wins"][here] = 0.5 + 0.5 * np.sign(lives - lives[::-1])
            figures["kills"][here] = info["statistics"]["kills"][w, sides]
            count[w], ticks[w], last[w] = count[w] + 1, 0, 0
        if done.any():
            observations, _ = env.reset(options={"reset_mask": done})
    env.close()
    return figures


@pytest.mark.parametrize("name", ["ffa_1", "teams_3"])
def test_a_match_is_as_counted_in_a_plain_loop(name: str) -> None:
    names, worlds, each, seed = ("scripted", "random"), 3, 2, 5
    scenario = quick(name).replace(safe_zone_stand=100, safe_zone_shrink=100, motors_ahead=1.0)  # in which agents meet
    expected = counted(scenario, names, worlds, each, seed)
    env = make_vec(scenario, worlds, seed=seed, autoreset_mode="Disabled")
    acts = [contender.act(env, seed) for contender in contenders(names)]
    match, ended = Match(env, acts, each, seed), list[int]()
    figures = match.play(ended.append).figures
    assert sum(ended) == worlds * each
    values = {key: figure[..., 0] / figure[..., 1].clip(1) for key, figure in figures.items()}
    for key in ("wins", "length", "life", "return", "kills"):
        assert values[key] == pytest.approx(expected[key]), key
    assert sum(values[key] for key in values if key.startswith("deaths_")) == pytest.approx(expected["dead"])
    assert figures["attack_near"] == pytest.approx(np.stack([expected["attacks"], expected["chances"]], -1))
    assert expected["chances"].sum() > 0
    assert set(expected["wins"].ravel()) >= {0, 1}
    for key, first in (("wins_first", 0), ("wins_second", 1)):  # side 0 is role 0's in even worlds and episodes
        shown = np.add.outer(range(worlds), range(each))[..., None] % 2 == [first, 1 - first]
        assert np.array_equal(figures[key], np.stack([expected["wins"] * shown, shown], -1)), key
    first, last = match.results.spans[0, 0]
    assert (first, last >= values["length"][0, 0, 0]) == (0, True)


def test_the_report_says_where_wins_depend_on_the_side() -> None:
    unequal = Evaluation(quick("teams_1").replace(teams_sizes=(1, 3)), contenders(["random"]), episodes=64)
    unequal.play()
    unequal.close()
    words = r"\nthe side matters in 1 of 1 .*: random against random wins 0\.\d+ ± \S+ on the first side, 0\."
    assert re.search(words, str(unequal))
    assert "the side matters" not in str(evaluated("ffa_1", "random", episodes=64))


MASKED = [preset.name for preset in PRESETS.values() if preset.cameras == "masked"]


@pytest.mark.parametrize("chosen", ["scripted", "random", *MASKED])
def test_cameras_mode_is_nothing_to_those_who_do_not_read_hidden_rows(tmp_path: Path, chosen: str) -> None:
    if chosen in PRESETS:
        saved(tmp_path / "a.zip", chosen)
    envs = [make_vec(quick("teams_3").replace(cameras_mode=mode), 8, seed=3) for mode in ("masked", "revealed")]
    players = [Player(tmp_path / "a.zip", seed=4) if chosen in PRESETS else POLICIES[chosen](env, 0) for env in envs]
    seen, differ = [env.reset()[0] for env in envs], 0
    for _ in range(150):
        actions = [player(observations) for player, observations in zip(players, seen, strict=True)]
        assert np.array_equal(*actions)
        assert np.array_equal(*(observations["own"] for observations in seen))
        differ += (seen[0]["others"] != seen[1]["others"]).any()
        seen = [env.step(choice)[0] for env, choice in zip(envs, actions, strict=True)]
    assert differ > 100


def test_the_numbers_depend_on_the_seed_and_not_on_threads(tmp_path: Path) -> None:
    saved(tmp_path / "a.zip", "original")
    saved(tmp_path / "b.zip", "paper")
    texts = (tmp_path / "a.zip", tmp_path / "b.zip", "random")
    runs = [evaluated("teams_3", *texts, episodes=6, worlds=4, seed=s, threads=t) for s, t in ((1, 1), (1, 2), (2, 1))]
    tables = [[pairing.estimates(0) | pairing.estimates(1) for pairing in run.pairings] for run in runs]
    np.testing.assert_equal(tables[0], tables[1])
    assert tables[0] != tables[2]
    np.testing.assert_equal(runs[0].ratings(), runs[1].ratings())
    assert runs[0].scenario.numbers()["cameras_mode"] == "revealed"
    assert runs[0].pairs == [(0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2)]
    assert runs[0].episodes == 8  # as many in every world
    alone = evaluated("teams_3", *texts[:2], episodes=6, worlds=4, seed=1)  # whatever else is rated
    np.testing.assert_equal([alone.pairings[1].estimates(0)], [runs[0].pairings[1].estimates(0)])


@pytest.mark.parametrize("memory", [0, 4])
@pytest.mark.parametrize("keyed", [True, False])
def test_keyed_policies_play_each_world_for_itself(tmp_path: Path, memory: int, keyed: bool) -> None:
    """A generator serves all worlds: what happens in one changes all others, except where it draws for all agents."""
    trainer = Trainer(TrainingConfig(quick("ffa_2"), "fast", worlds=4, rollout=256, memory=memory))
    torch.nn.init.zeros_(trainer.policies[0].actor.last.weight)  # all actions are equally likely, to the last bit
    checkpoint.write_checkpoint(tmp_path / "a.zip", capture(trainer, {}))

    def figures(moves: bool) -> list[bytes]:
        env = make_vec(quick("ffa_2"), 4, seed=0, autoreset_mode="Disabled")
        act = Contender("a", str(tmp_path / "a.zip")).act(env, 7, keyed=keyed)
        still: Any = lambda seen, where: act(seen, where) * ((where[0] > 0) | moves)[:, None]  # noqa: E731
        found = Match(env, [still], 1, 5).play().figures.values()
        return [np.stack([figure[w] for figure in found]).tobytes() for w in range(4)]

    same = [one == other for one, other in zip(figures(True), figures(False), strict=True)]
    assert not same[0]
    assert all(same[1:]) == (keyed or memory > 0)


def test_what_cannot_meet_is_refused(tmp_path: Path) -> None:
    saved(tmp_path / "a.zip")
    chosen = contenders([str(tmp_path / "a.zip"), "random"])
    with pytest.raises(TrainingError, match="trained on teams_3 and does not fit here"):
        Evaluation(variant("ffa_1"), chosen, worlds=2)
    with pytest.raises(UsageError, match="cameras_mode is omniscient"):
        Evaluation(variant("teams_3").replace(cameras_mode="omniscient"), chosen, worlds=2)
    assert chosen[0].player is not None
    chosen[0].player.header["actions"] = [3, 3]
    with pytest.raises(TrainingError, match=r"actions have \[3, 3\] values, but here they have \[3, 3, 3"):
        Evaluation(variant("teams_3"), chosen, worlds=2)
    with pytest.raises(TrainingError, match="one side"):
        Evaluation(variant("teams_3").replace(teams_count=1), chosen[1:], worlds=2)


@pytest.mark.parametrize(("won", "drawn", "lost"), [(300, 0, 100), (10, 80, 30), (50, 0, 0), (0, 5, 0), (0, 0, 50)])
def test_two_players_have_the_ratings_of_the_closed_form(won: int, drawn: int, lost: int) -> None:
    count = won + drawn + lost + 1  # and half a game for each
    share = (won + 0.5 + drawn / 2) / count
    variance = (won + 0.5 + drawn / 4) / count - share**2
    apart = 400 * math.log10(share / (1 - share))
    error = 400 / math.log(10) * math.sqrt(variance / count) / (share * (1 - share))  # of the difference
    ratings, errors = elo(np.array([[0, won], [lost, 0]]), np.array([[0, drawn], [drawn, 0]]))
    assert ratings == pytest.approx([1000 + apart / 2, 1000 - apart / 2])
    assert errors == pytest.approx([error / 2, error / 2])
    ratings, errors = anchored(*(np.array([[each]]) for each in (won, drawn, lost)), np.array([1234.0]))
    assert (ratings[0], errors[0]) == pytest.approx((1234 + apart, error))


def test_expected_scores_give_back_the_ratings() -> None:
    true, count = np.array([1500.0, 1100, 1000, 400]), 10_000_000
    expected = count / (1 + 10 ** ((true[None] - true[:, None]) / 400))
    ratings, _ = elo(expected, np.zeros((4, 4)))
    assert ratings == pytest.approx(true, abs=0.01)
    chain = np.abs(np.subtract.outer(range(4), range(4))) == 1  # not all met all
    assert elo(expected * chain, np.zeros((4, 4)))[0] == pytest.approx(true, abs=0.1)


def test_ratings_of_several_tables_are_those_of_each() -> None:
    wins, draws = np.random.default_rng(0).integers(0, 50, (2, 6, 4, 4)).astype(float)
    wins[3, 0, 1:] = wins[3, 1:, 0] = draws[3, 0] = draws[3, :, 0] = 0
    wins[3, 0, 1] = 40  # always wins, and met one only
    draws += draws.swapaxes(1, 2)
    expected = [elo(*tables) for tables in zip(wins, draws, strict=True)]
    assert np.stack(elo(wins, draws), 1) == pytest.approx(np.array(expected), abs=1e-6)
    wins = np.zeros((4, 4))
    wins[0, 1] = wins[2, 3] = 10
    with pytest.raises(ValueError, match="no chain of games joins all players"):
        elo(wins, np.zeros((4, 4)))


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        (([[1, 0]], [[0, 0]], [[1, 0]], [1000]), r"expected three tables .*, not \(1, 2\), \(1, 2\), \(1, 2\), \(1,\)"),
        (([[1]], [[0]], [[1]], [math.nan]), "fixed ratings must be finite"),
        (([[1]], [[-1]], [[1]], [1000]), "must be 0 or more"),
        (([[1], [0]], [[0], [0]], [[1], [0]], [1000]), r"player 1 \(from 0 on\) has met no opponent"),
    ],
)
def test_tables_that_rate_nobody_are_refused(tables: tuple[Any, ...], message: str) -> None:
    with pytest.raises(TrainingError, match=message):
        anchored(*map(np.array, tables))


def test_a_ratio_is_a_mean_with_its_error() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(3, 2, 50)
    mean, error = ratio(np.stack([values, np.ones(50)], 1))
    assert (mean, error) == pytest.approx((values.mean(), values.std(ddof=1) / math.sqrt(50)))
    assert all(math.isnan(value) for value in ratio(np.zeros((5, 2))))
    mean, error = ratio(np.array([[3.0, 4.0], [0.0, 0.0]]))  # of one case nobody knows how far others are
    assert (mean, math.isnan(error)) == (0.75, True)
    few = np.zeros((200, 2))  # a column that three episodes have
    few[[5, 70, 150]] = [[1, 1], [2, 1], [5.5, 1]]
    assert ratio(few) == pytest.approx((8.5 / 3, np.std([1, 2, 5.5], ddof=1) / math.sqrt(3)))


def test_labels_and_titles_are_as_short_as_can_be() -> None:
    assert labels(["random", "runs/a/steps_1.zip", "scripted"]) == ["random", "steps_1", "scripted"]
    assert labels(["runs/a b/steps_1.zip", "runs/c/steps_1.zip"]) == ["a-b-steps_1", "c-steps_1"]
    assert labels(["random", "runs/random.zip"]) == ["random", "runs-random"]
    with pytest.raises(TrainingError, match="named twice"):
        labels(["runs/a.zip", "runs/../runs/a.zip"])
    with pytest.raises(TrainingError, match="lr 1e-3, lr=1e-3: two get the name lr-1e-3 in files"):
        contenders({"lr 1e-3": "noop", "lr=1e-3": "scripted"})
    assert film_players(("scripted", "random"), ("side 0", "side 1")) == "scripted (side 0) against random (side 1)"
    names, strip = [f"runs-a-folder-of-many-ffa_2-fast-{seed}" for seed in (0, 17)], Canvas(512, 256, 22)
    text = film_players(names, ("side 0", "side 1"))
    assert strip.length(text, 11) + strip.length("tick 1234", 11) < 512 - 4 * 11  # pixels, with the margins
    assert re.fullmatch(r"runs\S*\.\.\S*-0 \(side 0\) against runs\S*\.\.\S*-17 \(side 1\)", text)


PLAN = {"preset": "fast", "seed": 0, "worlds": 64, "rollout": 1024, "settings": {}}


def policy_of(label: str, plan: dict[str, Any] | None = None, steps: int = 100, **numbers: float) -> Any:
    header = {"plan": plan or {}, "steps": steps, "scenario": {"name": "ffa_2", "numbers": numbers}}
    return SimpleNamespace(label=label, text=f"{label}.zip", player=SimpleNamespace(header=header))


def seeds(label: str, plan: dict[str, Any], count: int, **options: Any) -> list[Any]:
    return [policy_of(f"{label}{seed}", plan | {"seed": seed}, **options) for seed in range(count)]


def test_groups_are_runs_that_differ_by_seeds() -> None:
    fast, scaled = seeds("f", PLAN, 3), seeds("s", PLAN | {"preset": "scaled"}, 2)
    chosen = [Contender("random", "random"), *fast[:2], *scaled, policy_of("kept"), fast[2]]
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
        group_policies([*fast, policy_of("again", PLAN)])


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


def pair(wins: float, losses: float, seed: int = 0, reps: int = 2000) -> Any:
    """Ratings of two single runs, of which the first has won and lost so many games against the second."""
    groups = [PolicyGroup("a", (0,), True), PolicyGroup("b", (1,), False)]
    return rate_groups(groups, np.array([[0, wins], [losses, 0]]), np.zeros((2, 2)), seed, reps)


def test_losses_bound_ratings_and_who_wins_every_game_may_be_any_better() -> None:
    found = pair(20, 0)
    assert found.wins.value[0, 1] == found.wins.high[0, 1] == 1
    assert 0.8 < found.wins.low[0, 1] < 0.95
    found = pair(1000, 0)
    chance = 5.0239 / 2 / 1001  # of a loss, by Jeffreys: of a beta (1/2, 1000.5), as good as a chi square of 1 degree
    assert found.ratings.low[0] == pytest.approx(1000 + 200 * math.log10((1 - chance) / chance), abs=10)
    assert found.ratings.low[0] + 100 < found.ratings.value[0] == pytest.approx(1000 + 200 * math.log10(1000.5 / 0.5))
    assert (found.ratings.low[1], found.ratings.high[0]) == (-np.inf, np.inf)
    groups = [PolicyGroup(name, (k,), True) for k, name in enumerate("abc")]
    wins = np.array([[0.0, 50, 40], [0, 0, 30], [10, 20, 0]])  # a loses to c, who loses to b
    found = rate_groups(groups, wins, np.zeros((3, 3)), 0)
    assert ((found.ratings.low < found.ratings.value) & (found.ratings.value < found.ratings.high)).all()
    assert np.isfinite([found.ratings.low, found.ratings.high]).all()
    found = rate_groups(groups, np.triu(np.full((3, 3), 50.0), 1), np.zeros((3, 3)), 0)
    assert np.isinf(found.ratings.low).tolist() == [False, True, True]
    assert np.isinf(found.ratings.high).tolist() == [True, True, False]


def test_the_report_has_tables_of_groups_and_says_what_errors_are_of(tmp_path: Path) -> None:
    for name, worlds, seed in (("a", 4, 0), ("b", 4, 1), ("c", 8, 0)):
        config = TrainingConfig(variant("ffa_2"), "fast", worlds=worlds, rollout=256, seed=seed)
        checkpoint.write_checkpoint(tmp_path / f"{name}.zip", capture(Trainer(config), config.header()))
    quick = variant("ffa_2").replace(safe_zone_damage=50, safe_zone_stand=5)
    chosen = contenders([*(tmp_path / f"{name}.zip" for name in "abc"), "noop"])
    evaluation = Evaluation(quick, chosen, episodes=8, worlds=8)
    evaluation.play_pair(evaluation.pairs[0])
    assert evaluation.groups() is None
    evaluation.pairings.clear()
    evaluation.play()
    evaluation.close()
    text = str(evaluation)
    assert "\nworlds=4: a, b\n95 % intervals over training seeds and games" in text
    assert text.index("Elo of groups") < text.index("wins of group, against") < text.index("\nc: one run: its error is")
    narrow = report.text(evaluation, 80)
    tables = [line for line in narrow.split("\n") if "  " in line]
    assert max(map(len, tables)) <= 80 < max(map(len, text.split("\n")))
    assert sorted({*narrow.split()}) == sorted({*text.split()})
    report.write_tables(evaluation, tmp_path)
    rows = [tuple(row.values()) for row in rows_of(tmp_path / "groups.csv")]
    assert [row[:4] for row in rows[:4]] == [
        ("worlds=4", "2", "", "elo"),
        ("worlds=4", "2", "c", "wins"),
        ("worlds=4", "2", "noop", "wins"),
        ("c", "1", "", "elo"),
    ]
    kept = json.loads((tmp_path / "evaluation.json").read_text())["groups"]
    assert (len(kept), kept[0]["group"], kept[0]["figure"]) == (9, "worlds=4", "elo")


def test_a_policy_that_takes_the_likeliest_actions_does_so_in_evaluations() -> None:
    policy_file = KEPT / "ffa_2/original-0.safetensors"
    policy, options = outlast.load_policy(policy_file, seed=None), {"episodes": 8, "worlds": 8, "quiet": True}
    options |= {"ending_limit": 60, "cameras_mode": "revealed"}
    found = outlast.evaluate("ffa_2", {"p": policy, "r": "random"}, **options)
    assert policy.generator is None
    plain = outlast.evaluate("ffa_2", {"p": lambda observed: policy(observed), "r": "random"}, **options)
    sampled = outlast.evaluate("ffa_2", {"p": outlast.load_policy(policy_file), "r": "random"}, **options)
    told = [str(each.estimates("p", "r")) for each in (found, plain, sampled)]
    assert told[0] == told[1] != told[2]


evaluate = partial(call, evaluate_command)
SOON = {"safe_zone_damage": 50, "safe_zone_stand": 10, "safe_zone_shrink": 5}
EARLY = tuple(f"--set={name}={value}" for name, value in SOON.items())


def test_evaluate_prints_tables_and_writes_them(capsys, tmp_path: Path) -> None:
    saved(tmp_path / "a.zip", "paper")
    out = tmp_path / "out" / "deep"
    small = ("--episodes", 8, "--worlds", 4, *EARLY, "--out", out)
    assert evaluate("teams_3", tmp_path / "a.zip", "noop", "scripted", *small) == 0
    printed = capsys.readouterr()
    assert "48 of 48 episodes" in printed.err  # the progress bar
    assert "6 pairings of 8 episodes; fewer (--episodes) take less time\n" in printed.err
    assert "6 pairings of 8 episodes, 2 in each of 4 worlds" in printed.out
    found = json.loads((out / "evaluation.json").read_text())
    assert (found["complete"], found["episodes"], found["scenario"]["name"]) == (True, 8, "teams_3")
    assert [entry["label"] for entry in found["policies"]] == ["a", "noop", "scripted"]
    ratings = rows_of(out / "ratings.csv")
    assert np.mean([float(row["elo"]) for row in ratings]) == pytest.approx(1000)
    assert f"{float(ratings[2]['elo']):.0f}" in printed.out.split("wins of")[0]
    rows = {(row["policy"], row["against"], row["figure"]): row for row in rows_of(out / "figures.csv")}
    assert sum(float(rows[(*pair, "wins")]["mean"]) for pair in (("a", "noop"), ("noop", "a"))) == pytest.approx(1)
    figures = {"length", "return", "kills", "deaths_zone", "attack_far", "zone_distance", "heals_held", "heals_used"}
    assert figures <= {figure for _, _, figure in rows}
    assert not [path for path in out.iterdir() if path.suffix not in (".json", ".csv")]


def test_columns_of_many_policies_are_written_rather_than_printed(capsys, tmp_path: Path) -> None:
    policies, small = ("noop", "random", "camper", "healer", "hoarder"), ("--episodes", 2, "--worlds", 2, *EARLY)
    assert evaluate("ffa_2", *policies, *small, "--out", tmp_path / "out") == 0
    printed = capsys.readouterr().out
    assert "wins of, against" in printed
    assert "deaths_zone" not in printed
    assert {"hoarder"} <= {row["policy"] for row in rows_of(tmp_path / "out/figures.csv")}


@pytest.mark.nightly
def test_films_show_a_typical_episode_of_each_pairing(capsys, tmp_path: Path) -> None:
    small = ("--episodes", 6, "--worlds", 2, *EARLY, "--quiet")
    assert evaluate("ffa_1", "scripted", "noop", *small, "--out", tmp_path / "plain") == 0
    assert evaluate("ffa_1", "scripted", "noop", *small, "--out", tmp_path / "film", "--film") == 0
    plain, film = (rows_of(tmp_path / name / "figures.csv") for name in ("plain", "film"))
    assert plain == film  # recording changes nothing
    names = ["scripted-scripted", "scripted-noop", "noop-noop"]
    endings = {path.name for path in (tmp_path / "film").iterdir() if path.suffix in (".webm", ".html")}
    assert endings == {name + ending for name in names for ending in (".webm", ".html")}
    found = {(row["policy"], row["against"], row["figure"]): float(row["mean"]) for row in film}
    video = cv2.VideoCapture(str(tmp_path / "film" / "scripted-noop.webm"))
    ticks, mean = video.get(cv2.CAP_PROP_FRAME_COUNT) - 1, found["scripted", "noop", "length"]
    assert 0.5 * mean < ticks < 2 * mean
    page = (tmp_path / "film" / "scripted-noop.html").read_text()
    assert re.search(r"ffa_1\S*: scripted \(side (0\) against noop \(side 1|1\) against noop \(side 0)\)", page)
    assert "scripted-noop.webm" in capsys.readouterr().out


def test_ctrl_c_prints_the_pairings_that_are_complete(capsys, caplog, monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setitem(POLICIES, "random", interrupted_after(20))
    small = ("--episodes", 2, "--worlds", 2, *EARLY, "--quiet", "--out", tmp_path / "out")
    assert evaluate("ffa_1", "noop", "scripted", "random", *small) == 130
    printed = capsys.readouterr()
    assert (caplog.messages, printed.err) == (["stopped; 3 of 6 pairings are complete"], "")
    assert "3 pairings of 2 episodes" in printed.out
    found = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert (found["complete"], len(found["pairings"]), found["ratings"]) == (False, 3, [])
    monkeypatch.setitem(POLICIES, "random", interrupted_after(3))
    assert evaluate("ffa_1", "random", *small[:-1], tmp_path / "none") == 130
    assert "none of the pairings is complete" in capsys.readouterr().out
    assert not (tmp_path / "none").exists()


def run_folder(place: Path, *steps: int) -> Path:
    place.mkdir(parents=True)
    for count in steps:
        saved(place / f"steps_{count:010d}.zip", "paper")
    return place


def test_the_folder_of_a_run_is_its_newest_policy_everywhere(tmp_path: Path, monkeypatch) -> None:
    folder = run_folder(tmp_path / "a", 100, 2000)
    newest = str(folder / "steps_0000002000.zip")
    assert parse_lineup(f"{folder}:0.5,noop") == {newest: 0.5, "noop": 1.0}
    assert entries_of({folder: 1}) == [(newest, 1.0)]
    weights = [load_policy(path).policies[0].state_dict() for path in (folder, newest)]
    assert all(torch.equal(weights[0][name], weights[1][name]) for name in weights[1])
    assert TrainingConfig(variant("teams_3"), warm_start=f"{folder}:3e6").warm_start == f"{newest}:3e6"
    assert TrainingConfig(variant("teams_3"), preset="paper", warm_start=str(folder)).warm_start == newest
    run_folder(tmp_path / "b", 100)
    assert [each.text for each in contenders([tmp_path])] == [newest, str(tmp_path / "b/steps_0000000100.zip")]
    for act in (load_policy, parse_lineup):
        with pytest.raises(UsageError, match=rf"{tmp_path} holds 2 runs: name one of them, such as .*/a$"):
            act(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "noop").mkdir()  # names come first
    assert parse_lineup("noop,a") == {"noop": 1.0, "a/steps_0000002000.zip": 1.0}


def test_evaluations_in_one_call(tmp_path: Path) -> None:
    def idle(seen: dict[str, np.ndarray]) -> np.ndarray:
        return np.broadcast_to(np.array([1, 1, 1, 0, 0, 0]), (*seen["own"].shape[:2], 6))

    small = {"episodes": 8, "worlds": 4, "quiet": True}
    found = outlast.evaluate("teams_3", {"mine": idle, "theirs": "noop"}, **small, **SOON, out=tmp_path)
    other = outlast.evaluate(variant("teams_3"), ["noop", idle], **small, **SOON)
    assert found.estimates("mine", "theirs")["wins"][0] + found.estimates("theirs", "mine")["wins"][0] == 1
    assert [contender.label for contender in other.chosen] == ["noop", "idle"]
    np.testing.assert_equal(found.estimates("mine", "theirs")["length"], other.estimates("noop", "idle")["length"])
    assert re.search(r"\nmine +theirs +\d", str(found))
    assert (tmp_path / "figures.csv").exists()
    with pytest.raises(TrainingError, match="nobody against mine is not complete; the policies are mine, theirs"):
        found.estimates("nobody", "mine")


def test_figures_of_the_episodes_in_which_a_policy_plays_one_side() -> None:
    options: dict[str, Any] = {"episodes": 24, "worlds": 4, "quiet": True, "ending_limit": 150}
    found = outlast.evaluate("hide_door", ["scripted", "noop"], **options)
    both = found.estimates("scripted", "noop")
    by_side = [found.estimates("scripted", "noop", side) for side in (0, 1)]
    assert [each["wins"] for each in by_side] == [both["wins_first"], both["wins_second"]]
    assert by_side[0]["ticks_seen"][0] < by_side[1]["ticks_seen"][0]  # as hiders; as seekers
    for name in ("ticks_seen", "held", "crates_moved1", "doors_closed0"):
        assert by_side[0][name][0] + by_side[1][name][0] == pytest.approx(2 * both[name][0])
    itself = [found.estimates("scripted", "scripted", side)["ticks_seen"] for side in (None, 0, 1)]
    np.testing.assert_allclose(itself, [itself[0]] * 3)


def test_tables_of_another_evaluation_are_not_replaced(tmp_path: Path, capsys) -> None:
    """The same one again, with more episodes, takes their place."""
    small = {"worlds": 4, "quiet": True, "out": tmp_path}
    outlast.evaluate("ffa_2", ["noop", "random"], episodes=4, **small, **SOON)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    for policies, more in ((["noop", "scripted"], {}), (["noop", "random"], {"melee_damage": 20})):
        with pytest.raises(TrainingError, match=r"holds another evaluation, of ffa_2 with noop, random: choose anothe"):
            outlast.evaluate("ffa_2", policies, episodes=4, **small, **SOON, **more)
    assert cli.main(["evaluate", "ffa_3", "noop", "random", "--episodes", "4", "--out", str(tmp_path)]) == 2
    assert "holds another evaluation, of ffa_2 with noop, random" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    outlast.evaluate("ffa_2", ["noop", "random"], episodes=8, **small, **SOON)
    assert json.loads((tmp_path / "evaluation.json").read_text())["episodes"] == 8
    (tmp_path / "evaluation.json").write_text("[]")
    with pytest.raises(TrainingError, match=r"evaluation\.json is not an evaluation, and would be replaced: choose"):
        outlast.evaluate("ffa_2", ["noop", "random"], episodes=4, **small, **SOON)


@pytest.mark.parametrize(
    ("policies", "options", "words"),
    [
        (["noop"], {"episodes": 0}, "episodes = 0: an integer >= 1"),
        (["noop"], {"worlds": 1.5}, "worlds = 1.5: an integer >= 1"),
        (["noop"], {"episode": 3}, "did you mean episodes"),
        (["noop"], {"film": True}, "films need a folder"),
        ([lambda seen: np.zeros(3)], {}, r"the actions that lambda returned have shape \(3,\)"),
        ([3], {}, "3 is not a policy"),
        ({"a": "."}, {}, "there is no checkpoint in . yet"),
    ],
)
def test_mistakes_of_evaluations_in_one_call(policies, options: dict, words: str, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises((OutlastError, ValueError), match=words):
        outlast.evaluate("ffa_1", policies, quiet=True, **options)


def test_every_column_is_explained() -> None:
    small = {"episodes": 2, "worlds": 2, "quiet": True, "safe_zone_damage": 50, "safe_zone_stand": 5}
    found = outlast.evaluate("teams_4", ["random"], **small)
    columns = {re.sub("^deaths_.*", "deaths_TYPE", name) for name in found.estimates("random", "random")}
    assert columns == COLUMNS.keys()
    assert all(any(line.startswith(f"  {name} ") for line in explained()) for name in COLUMNS)

"""Cross-play, counted again in plain Python."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast import make_vec, variant
from outlast.envs.errors import UsageError
from outlast.envs.rendering.canvas import Canvas
from outlast.envs.rollout.policies import POLICIES
from outlast.envs.scenarios.scenario import Scenario
from outlast.training.base.errors import TrainingError

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")

from outlast.training.arena.evaluation import Evaluation  # noqa: E402
from outlast.training.arena.films import film_players  # noqa: E402
from outlast.training.arena.match import Match, ratio  # noqa: E402
from outlast.training.arena.players import Contender, contenders, labels  # noqa: E402
from outlast.training.arena.ratings import anchored, elo  # noqa: E402
from outlast.training.base.config import TrainingConfig  # noqa: E402
from outlast.training.base.presets import PRESETS  # noqa: E402
from outlast.training.policies import checkpoint  # noqa: E402
from outlast.training.policies.player import Player  # noqa: E402
from outlast.training.ppo.trainer import Trainer  # noqa: E402
from outlast.training.runs import resume  # noqa: E402
from tests.training.test_player import saved  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")

QUICK = {
    "safe_zone_damage": 20,
    "safe_zone_stand": 20,
    "safe_zone_shrink": 10,
    "melee_damage": 20,
}  # episodes of a hundred steps


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
    attacks, chances = np.zeros((worlds, each, 2)), np.zeros((worlds, each, 2))
    count, ticks = [0] * worlds, [0] * worlds
    last = np.zeros((worlds, 2), int)
    while min(count) < each:
        seen = {key: value.copy() for key, value in observations.items()}
        choices = [policy(observations) for policy in policies]
        actions = np.zeros_like(choices[0])
        for w in range(worlds):
            for i in agents:
                role = (i // size + w + count[w]) % 2
                actions[w, i] = choices[role][w, i]
                me = seen["own"][w, i, -7:]
                if count[w] < each and me.any():
                    enemies = [seen["own"][w, j, -7:] for j in agents if j // size != i // size]
                    near = any(row.any() and np.hypot(*(row[1:3] - me[1:3])) <= 2.5 for row in enemies)
                    chances[w, count[w], role] += near
                    attacks[w, count[w], role] += near and actions[w, i, 3]
        observations, rewards, done, _, info = env.step(actions)
        for w in range(worlds):
            ticks[w] += 1
            for i in agents:
                role = (i // size + w + count[w]) % 2
                if observations["own"][w, i, -7:].any():
                    last[w, i // size] = ticks[w]
                if count[w] < each:
                    figures["return"][w, count[w], role] += rewards[w, i] / size
            if done[w] and count[w] < each:
                lives = [last[w, (role + w + count[w]) % 2] for role in (0, 1)]
                here = (w, count[w])
                figures["life"][here], figures["length"][here] = lives, ticks[w]
                figures["wins"][here] = [0.5 + 0.5 * np.sign(lives[k] - lives[1 - k]) for k in (0, 1)]
                figures["kills"][here] = [info["statistics"]["kills"][w, (k + w + count[w]) % 2] for k in (0, 1)]
                alive = [
                    [observations["own"][w, i, -7:].any() for i in agents if (i // size + w + count[w]) % 2 == k]
                    for k in (0, 1)
                ]
                figures["dead"][here] = [len(living) - sum(living) for living in alive]
            if done[w]:
                count[w], ticks[w], last[w] = count[w] + 1, 0, 0
        if done.any():
            observations, _ = env.reset(options={"reset_mask": done})
    env.close()
    return figures | {"attacks": attacks, "chances": chances}


@pytest.mark.parametrize("name", ["ffa_1", "teams_3"])
def test_a_match_is_as_counted_in_a_plain_loop(name: str) -> None:
    names, worlds, each, seed = ("scripted", "random"), 3, 2, 5
    scenario = quick(name).replace(safe_zone_stand=100, safe_zone_shrink=100, motors_ahead=1.0)  # in which agents meet
    expected = counted(scenario, names, worlds, each, seed)
    env = make_vec(scenario, worlds, seed=seed, autoreset_mode="Disabled")
    acts = [contender.act(env, seed) for contender in contenders(names)]
    match = Match(env, acts, each, seed)
    ended: list[int] = []
    figures = match.play(ended.append).figures
    assert sum(ended) == worlds * each
    values = {key: figure[..., 0] / figure[..., 1].clip(1) for key, figure in figures.items()}
    for key in ("wins", "length", "life", "return", "kills"):
        assert values[key] == pytest.approx(expected[key]), key
    assert sum(values[key] for key in values if key.startswith("deaths_")) == pytest.approx(expected["dead"])
    assert figures["attack_near"][..., 0] == pytest.approx(expected["attacks"])
    assert figures["attack_near"][..., 1] == pytest.approx(expected["chances"])
    assert expected["chances"].sum() > 0
    assert set(expected["wins"].ravel()) >= {0, 1}
    for key, first in (("wins_first", 0), ("wins_second", 1)):  # side 0 is role 0's in even worlds and episodes
        shown = np.add.outer(range(worlds), range(each))[..., None] % 2 == [first, 1 - first]
        assert np.array_equal(figures[key], np.stack([expected["wins"] * shown, shown], -1)), key
    first, last = match.results.spans[0, 0]
    assert (first, last >= values["length"][0, 0, 0]) == (0, True)


def test_the_report_says_where_wins_depend_on_the_side() -> None:
    """Of a team of one against a team of three, and not of two agents that play alike."""
    unequal = Evaluation(quick("teams_1").replace(teams_sizes=(1, 3)), contenders(["random"]), episodes=64)
    unequal.play()
    unequal.close()
    assert re.search(
        r"\nthe side matters in 1 of 1 pairings, .*: random against random wins 0\.\d+ ± \S+ on the first side, 0\.",
        str(unequal),
    )
    assert "the side matters" not in str(evaluated("ffa_1", "random", episodes=64))


@pytest.mark.parametrize("chosen", [preset.name for preset in PRESETS.values() if preset.cameras == "masked"])
def test_cameras_mode_is_nothing_to_a_player_trained_on_masked_rows(tmp_path: Path, chosen: str) -> None:
    saved(tmp_path / "a.zip", chosen)
    envs = [make_vec(quick("teams_3").replace(cameras_mode=mode), 8, seed=3) for mode in ("masked", "revealed")]
    players = [Player(tmp_path / "a.zip", seed=4) for _ in envs]
    seen = [env.reset()[0] for env in envs]
    differ = 0
    for _ in range(150):
        actions = [player(observations) for player, observations in zip(players, seen, strict=True)]
        assert np.array_equal(*actions)
        assert np.array_equal(*(observations["own"] for observations in seen))
        differ += (seen[0]["others"] != seen[1]["others"]).any()
        seen = [env.step(choice)[0] for env, choice in zip(envs, actions, strict=True)]
    assert differ > 100


@pytest.mark.parametrize("name", ["scripted", "random"])
def test_cameras_mode_is_nothing_to_policies_by_name(name: str) -> None:
    envs = [make_vec(quick("teams_3").replace(cameras_mode=mode), 8, seed=3) for mode in ("masked", "revealed")]
    policies = [POLICIES[name](env, 0) for env in envs]
    seen = [env.reset()[0] for env in envs]
    for _ in range(150):
        actions = [policy(observations) for policy, observations in zip(policies, seen, strict=True)]
        assert np.array_equal(*actions)
        seen = [env.step(choice)[0] for env, choice in zip(envs, actions, strict=True)]


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
    checkpoint.write_checkpoint(tmp_path / "a.zip", resume.capture(trainer, {}))

    def figures(moves: bool) -> list[bytes]:
        env = make_vec(quick("ffa_2"), 4, seed=0, autoreset_mode="Disabled")
        act = Contender("a", str(tmp_path / "a.zip")).act(env, 7, keyed=keyed)
        still: Any = lambda seen, where: act(seen, where) * ((where[0] > 0) | moves)[:, None]  # noqa: E731
        found = Match(env, [still], 1, 5).play().figures.values()
        return [np.stack([figure[w] for figure in found]).tobytes() for w in range(4)]

    same = [one == other for one, other in zip(figures(True), figures(False), strict=True)]
    assert not same[0]
    assert all(same[1:]) == (keyed or memory > 0)


def test_a_policy_against_itself_wins_half() -> None:
    evaluation = evaluated("ffa_1", "scripted", episodes=400, worlds=100)
    mean, error = evaluation.pairings[0].estimates(0)["wins"]
    assert 0.015 < error < 0.026
    assert abs(mean - 0.5) < 4 * error
    assert evaluation.ratings() is None
    won, drawn, lost = evaluation.pairings[0].won_drawn_lost()
    assert (won + drawn + lost, (won + drawn / 2) / 400) == (400, mean)


def test_sides_are_even_also_where_worlds_are_odd() -> None:
    evaluation = Evaluation(quick("ffa_1"), contenders(["noop", "random"]), episodes=3, worlds=3)
    assert (evaluation.each, evaluation.episodes) == (2, 6)
    evaluation.close()


def test_what_cannot_meet_is_refused(tmp_path: Path) -> None:
    saved(tmp_path / "a.zip")
    chosen = contenders([str(tmp_path / "a.zip"), "random"])
    with pytest.raises(TrainingError, match="trained on teams_3 and does not fit here"):
        Evaluation(variant("ffa_1"), chosen, worlds=2)
    with pytest.raises(UsageError, match="cameras_mode is omniscient"):
        Evaluation(variant("teams_3").replace(cameras_mode="omniscient"), chosen, worlds=2)
    assert chosen[0].player is not None
    chosen[0].player.header["actions"] = [3, 3]
    with pytest.raises(
        TrainingError, match=r"trained where actions have \[3, 3\] values, and here they have \[3, 3, 3, 2, 2, 2\]"
    ):
        Evaluation(variant("teams_3"), chosen, worlds=2)
    with pytest.raises(TrainingError, match="one side"):
        Evaluation(variant("teams_3").replace(teams_count=1), chosen[1:], worlds=2)


# ---- Elo ratings and standard errors, against closed forms and against random games


@pytest.mark.parametrize(("won", "drawn", "lost"), [(300, 0, 100), (10, 80, 30), (50, 0, 0), (0, 5, 0)])
def test_two_players_have_the_ratings_of_the_closed_form(won: int, drawn: int, lost: int) -> None:
    wins, draws = np.array([[0, won], [lost, 0]]), np.array([[0, drawn], [drawn, 0]])
    ratings, errors = elo(wins, draws)
    count = won + drawn + lost + 1  # and half a game for each
    share = (won + 0.5 + drawn / 2) / count
    variance = (won + 0.5 + drawn / 4) / count - share**2
    assert ratings.mean() == pytest.approx(1000)
    assert ratings[0] - ratings[1] == pytest.approx(400 * math.log10(share / (1 - share)))
    error = 400 / math.log(10) * math.sqrt(variance / count) / (share * (1 - share))  # of the difference
    assert errors == pytest.approx([error / 2, error / 2])


def test_expected_scores_give_back_the_ratings() -> None:
    true, count = np.array([1500.0, 1100, 1000, 400]), 10_000_000
    expected = count / (1 + 10 ** ((true[None] - true[:, None]) / 400))
    ratings, _ = elo(expected, np.zeros((4, 4)))
    assert ratings == pytest.approx(true, abs=0.01)
    chain = np.abs(np.subtract.outer(range(4), range(4))) == 1  # not all met all
    assert elo(expected * chain, np.zeros((4, 4)))[0] == pytest.approx(true, abs=0.1)


def test_errors_are_the_scatter_of_ratings() -> None:
    rng, count, tables = np.random.default_rng(0), 200, 400
    found, estimated = [], []
    chances = {(0, 1): (0.5, 0.2), (0, 2): (0.6, 0.3), (1, 2): (0.45, 0.2)}  # of a win, of a draw
    for _ in range(tables):
        wins, draws = np.zeros((2, 3, 3))
        for (i, j), (win, draw) in chances.items():
            wins[i, j], draws[i, j], wins[j, i] = rng.multinomial(count, (win, draw, 1 - win - draw))
            draws[j, i] = draws[i, j]
        ratings, errors = elo(wins, draws)
        found.append(ratings)
        estimated.append(errors)
    assert np.mean(estimated, 0) == pytest.approx(np.std(found, 0), rel=4 / math.sqrt(2 * tables))


def test_ratings_of_several_tables_are_those_of_each() -> None:
    wins, draws = np.random.default_rng(0).integers(0, 50, (2, 6, 4, 4)).astype(float)
    wins[3, 0, 1:] = wins[3, 1:, 0] = draws[3, 0] = draws[3, :, 0] = 0
    wins[3, 0, 1] = 40  # always wins, and met one only
    draws += draws.swapaxes(1, 2)
    expected = [elo(*tables) for tables in zip(wins, draws, strict=True)]
    assert np.stack(elo(wins, draws), 1) == pytest.approx(np.array(expected), abs=1e-6)


def test_a_player_that_always_wins_has_a_rating_and_a_wide_error() -> None:
    wins = np.array([[0, 100, 100], [0, 0, 50], [0, 50, 0]])
    ratings, errors = elo(wins, np.zeros((3, 3)))
    assert 1500 < ratings[0] < 2500
    assert ratings[1] == pytest.approx(ratings[2])
    assert 100 < errors[0] < 200


def test_players_that_no_games_join_have_none() -> None:
    wins = np.zeros((4, 4))
    wins[0, 1] = wins[2, 3] = 10
    with pytest.raises(ValueError, match="no chain of games joins all players"):
        elo(wins, np.zeros((4, 4)))


# ---- ratings against fixed opponents


def test_expected_scores_against_fixed_opponents_give_back_the_ratings() -> None:
    true, fixed, count = np.array([700.0, 1000, 2100]), np.array([400.0, 900, 1000, 1900]), 10_000_000
    expected = count / (1 + 10 ** ((fixed - true[:, None]) / 400))
    half = 0.2 * (count - np.abs(2 * expected - count))  # of the games: drawn
    ratings, _ = anchored(expected - half / 2, half, count - expected - half / 2, fixed)
    assert ratings == pytest.approx(true, abs=0.05)
    alone, _ = anchored(*(each[:1] for each in (expected - half / 2, half, count - expected - half / 2)), fixed)
    assert alone[0] == pytest.approx(ratings[0], abs=1e-6)  # whoever else is rated


@pytest.mark.parametrize(("won", "drawn", "lost"), [(300, 0, 100), (10, 80, 30), (50, 0, 0), (0, 0, 50)])
def test_against_one_fixed_opponent_the_rating_is_the_closed_form(won: int, drawn: int, lost: int) -> None:
    ratings, errors = anchored(*(np.array([[each]]) for each in (won, drawn, lost)), np.array([1234.0]))
    count = won + drawn + lost + 1  # and half a game for each
    share = (won + 0.5 + drawn / 2) / count
    variance = (won + 0.5 + drawn / 4) / count - share**2
    assert ratings[0] == pytest.approx(1234 + 400 * math.log10(share / (1 - share)))
    assert errors[0] == pytest.approx(400 / math.log(10) * math.sqrt(variance / count) / (share * (1 - share)))


def test_who_wins_or_loses_everything_has_a_bound_with_a_wide_error() -> None:
    fixed, none, all_ = np.array([600.0, 1000, 1400]), np.zeros((1, 3)), np.full((1, 3), 320)
    (best,), (above,) = anchored(all_, none, none, fixed)
    (worst,), (below,) = anchored(none, none, all_, fixed)
    assert best - 1000 == pytest.approx(1000 - worst)
    assert 2000 < best < 2600
    assert above == pytest.approx(below)
    assert 100 < above < 400


def test_errors_against_fixed_opponents_are_the_scatter_of_ratings() -> None:
    rng, fixed, tables = np.random.default_rng(0), np.array([800.0, 1000, 1300]), 2000
    chances = [(0.7, 0.1, 0.2), (0.45, 0.1, 0.45), (0.1, 0.2, 0.7)]
    wins, draws, losses = np.stack([rng.multinomial(200, each, tables) for each in chances], 1).transpose(2, 0, 1)
    ratings, errors = anchored(wins, draws, losses, fixed)
    assert errors.mean() == pytest.approx(ratings.std(), rel=4 / math.sqrt(2 * tables))


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        (([[1, 0]], [[0, 0]], [[1, 0]], [1000]), r"expected three tables .*, not \(1, 2\), \(1, 2\), \(1, 2\), \(1,\)"),
        (([[1]], [[0]], [[1]], [math.nan]), "the fixed ones must be numbers"),
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
    found = []
    for _ in range(1000):  # of numbers that go together
        counts = rng.integers(0, 10, 100)
        found.append(ratio(np.stack([rng.binomial(counts, 0.3), counts], 1)))
    means, errors = np.array(found).T
    assert means.mean() == pytest.approx(0.3, abs=4 * means.std() / math.sqrt(1000))
    assert errors.mean() == pytest.approx(means.std(), rel=0.1)


def test_the_title_of_a_film_has_both_players_and_their_sides() -> None:
    for names, sides in (
        (("scripted", "random"), ("side 0", "side 1")),
        (("ffa_2-original-0", "ffa_2-original-1"), ("side 0", "side 1")),
        (("runs-a-folder-of-many-ffa_2-fast-0", "runs-a-folder-of-many-ffa_2-fast-17"), ("side 0", "side 1")),
        (("ffa_2-original-0", "scripted"), ("sides 0 2 4", "sides 1 3")),
    ):
        text = film_players(names, sides)
        strip = Canvas(512, 256, 22)
        assert strip.length(text, 11) + strip.length("tick 1234", 11) < 512 - 4 * 11  # pixels, with the margins
        first, second = text.split(" against ")
        for shown, name, own in ((first, names[0], sides[0]), (second, names[1], sides[1])):
            start, _, ending = shown.removesuffix(f" ({own})").partition("..")
            assert shown.endswith(f" ({own})")
            assert name.startswith(start)
            assert name.endswith(ending)
            assert len(shown) - len(own) > 8
    assert film_players(("scripted", "random"), ("side 0", "side 1")) == "scripted (side 0) against random (side 1)"


def test_two_policies_are_not_given_one_label() -> None:
    with pytest.raises(TrainingError, match="lr 1e-3, lr=1e-3: two of them are called lr-1e-3 in files"):
        contenders({"lr 1e-3": "noop", "lr=1e-3": "scripted"})


@pytest.mark.parametrize("given", [{"episodes": 0}, {"worlds": 0}, {"episodes": 1.5}])
def test_numbers_of_an_evaluation_that_cannot_be_are_refused(given: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"{next(iter(given))} = .*: an integer >= 1 is needed"):
        Evaluation(quick("ffa_1"), contenders(["noop"]), **given)


def test_labels_are_as_short_as_can_be() -> None:
    assert labels(["random", "runs/a/steps_1.zip", "scripted"]) == ["random", "steps_1", "scripted"]
    assert labels(["runs/a b/steps_1.zip", "runs/c/steps_1.zip"]) == ["a-b-steps_1", "c-steps_1"]
    assert labels(["random", "runs/random.zip"]) == ["random", "runs-random"]
    with pytest.raises(TrainingError, match="named twice"):
        labels(["runs/a.zip", "runs/../runs/a.zip"])

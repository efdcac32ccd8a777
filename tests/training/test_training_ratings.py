"""Elo ratings and standard errors, against closed forms and against games that are drawn by lot."""

import math

import numpy as np
import pytest

from outlast.training.ratings import elo

pytest.importorskip("torch", reason="needs torch: outlast[train]")
pytest.importorskip("stable_baselines3", reason="needs stable_baselines3: outlast[train]")

from outlast.envs.errors import TrainingError
from outlast.training.contenders import labels
from outlast.training.evaluate import ratio


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
    chain = np.abs(np.subtract.outer(range(4), range(4))) == 1  # not everybody met everybody
    assert elo(expected * chain, np.zeros((4, 4)))[0] == pytest.approx(true, abs=0.1)


def test_errors_are_the_scatter_of_ratings() -> None:
    rng, count, tables = np.random.default_rng(0), 200, 400
    found, told = [], []
    chances = {(0, 1): (0.5, 0.2), (0, 2): (0.6, 0.3), (1, 2): (0.45, 0.2)}  # of a win, of a draw
    for _ in range(tables):
        wins, draws = np.zeros((2, 3, 3))
        for (i, j), (win, draw) in chances.items():
            wins[i, j], draws[i, j], wins[j, i] = rng.multinomial(count, (win, draw, 1 - win - draw))
            draws[j, i] = draws[i, j]
        ratings, errors = elo(wins, draws)
        found.append(ratings)
        told.append(errors)
    assert np.mean(told, 0) == pytest.approx(np.std(found, 0), rel=4 / math.sqrt(2 * tables))


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


def test_a_ratio_is_a_mean_with_its_error() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(3, 2, 50)
    mean, error = ratio(np.stack([values, np.ones(50)], 1))
    assert (mean, error) == pytest.approx((values.mean(), values.std(ddof=1) / math.sqrt(50)))
    assert all(math.isnan(value) for value in ratio(np.zeros((5, 2))))
    found = []
    for _ in range(1000):  # of numbers that go together
        counts = rng.integers(0, 10, 100)
        found.append(ratio(np.stack([rng.binomial(counts, 0.3), counts], 1)))
    means, errors = np.array(found).T
    assert means.mean() == pytest.approx(0.3, abs=4 * means.std() / math.sqrt(1000))
    assert errors.mean() == pytest.approx(means.std(), rel=0.1)


def test_labels_are_as_short_as_can_be() -> None:
    assert labels(["random", "runs/a/steps_1.zip", "scripted"]) == ["random", "steps_1", "scripted"]
    assert labels(["runs/a b/steps_1.zip", "runs/c/steps_1.zip"]) == ["a-b-steps_1", "c-steps_1"]
    assert labels(["random", "runs/random.zip"]) == ["random", "runs-random"]
    with pytest.raises(TrainingError, match="named twice"):
        labels(["runs/a.zip", "runs/../runs/a.zip"])

"""Elo ratings from a table of results: the Bradley-Terry model, by maximum likelihood."""

import math
from typing import Any

import numpy as np

from ..base.errors import TrainingError

Array = np.ndarray[Any, Any]

POINTS = 400 / math.log(10)  # Elo points of one unit of log odds: 400 more are odds of ten to one
MEAN = 1000.0  # mean of all ratings: arbitrary, since only differences matter
SURE, MOST = 1e-8, 1000  # Newton's method ends at a step shorter than this, in log odds, or after this many steps


def chained(scores: Array) -> Array:
    """Return whether a chain of scores leads from i to j: i scored against a player that scored against ... j.

    scores: (..., players, players), those of i against j. If no chain leads from i to j, the likelihood grows without
    bound as j is rated higher above i.
    """
    count = scores.shape[-1]
    chain: Array = (scores > 0) | np.eye(count, dtype=bool)
    for _ in range(count.bit_length()):  # every pass finds chains twice as long
        chain = chain @ chain
    return chain


def linked(games: Array) -> bool:
    """Return whether a chain of games links any two players; games: numbers of games, (..., players, players)."""
    return bool(chained(games).all())


def elo(wins: Array, draws: Array, added: float = 0.5) -> tuple[Array, Array]:
    """Return ratings and their standard errors, float64 (..., players) each; the ratings' mean is 1000.

    wins[i, j]: games that i won against j; draws[i, j] = draws[j, i]: half a win for both. For every pair that has met,
    `added` wins of each are added, so that ratings stay finite if one always wins. Errors are the sandwich estimate:
    the curvature of the likelihood around the scatter of the scores in each pairing; draws therefore count with their
    smaller scatter. Leading axes stand for several tables. Raises ValueError if no chain of games joins all players.
    """
    met = (wins + wins.swapaxes(-1, -2) + draws > 0) & ~np.eye(wins.shape[-1], dtype=bool)
    won, drawn = np.where(met, wins + added, 0.0), np.where(met, draws, 0.0)
    games, score = won + won.swapaxes(-1, -2) + drawn, won + drawn / 2
    if not linked(games):
        raise ValueError("ratings: no chain of games joins all players")
    odds = _fitted(games, score)
    scatter = won + drawn / 4 - np.divide(score**2, games, out=np.zeros_like(score), where=met)
    bread = np.linalg.pinv(_laplacian(games * _slope(odds)), hermitian=True)
    error = np.sqrt(np.diagonal(bread @ _laplacian(scatter) @ bread, axis1=-2, axis2=-1).clip(0))
    return MEAN + POINTS * odds, POINTS * error


def anchored(wins: Array, draws: Array, losses: Array, fixed: Array) -> tuple[Array, Array]:
    """Return ratings of players against opponents whose ratings are fixed, and their standard errors.

    A rating is the one under which a player's expected score against all of its opponents is its actual score. It
    depends on these games only, so it can be compared with ratings of other players against the same opponents. As
    in `elo`, half a game won and half a game lost are added for each pair that has met: a player that wins (or loses)
    everything has a finite rating, a lower (upper) bound, with a large error.

    Args:
        wins: Games that each player won against each opponent, (players, opponents).
        draws: Drawn games, of the same shape.
        losses: Games that the player lost, of the same shape.
        fixed: Elo ratings of the opponents, (opponents,), taken as exact.

    Returns:
        Ratings and standard errors, float64 (players,) each. Errors are over games: the sandwich estimate, see `elo`.

    Raises:
        TrainingError: Shapes do not fit, numbers are negative or not finite, or a player has met no opponent.
    """
    wins, draws, losses, fixed = (np.asarray(each, np.float64) for each in (wins, draws, losses, fixed))
    _check_anchored(wins, draws, losses, fixed)
    met = wins + draws + losses > 0
    won, lost = np.where(met, wins + 0.5, 0.0), np.where(met, losses + 0.5, 0.0)
    games, score = won + draws + lost, won + draws / 2
    scatter = won + draws / 4 - np.divide(score**2, games, out=np.zeros_like(score), where=met)
    anchors = (fixed - MEAN) / POINTS
    odds = np.full(len(wins), anchors.mean())
    for _ in range(MOST):
        chance = 1 / (1 + np.exp(anchors - odds[:, None]))
        curvature = (games * chance * (1 - chance)).sum(1)
        step = ((score - games * chance).sum(1) / curvature).clip(-1, 1)  # a longer step might overshoot
        odds = odds + step
        if np.abs(step).max() < SURE:
            break
    return MEAN + POINTS * odds, POINTS * np.sqrt(scatter.sum(1)) / curvature


def _check_anchored(wins: Array, draws: Array, losses: Array, fixed: Array) -> None:
    shapes = [each.shape for each in (wins, draws, losses)]
    if wins.ndim != 2 or not wins.size or set(shapes) != {(len(wins), *fixed.shape)}:
        given = ", ".join(map(str, (*shapes, fixed.shape)))
        raise TrainingError(f"ratings: expected three tables (players, opponents) and (opponents,), not {given}")
    if not np.isfinite(fixed).all():
        raise TrainingError(f"ratings: fixed ratings must be finite, not {fixed}")
    if not all((each >= 0).all() and np.isfinite(each).all() for each in (wins, draws, losses)):
        raise TrainingError("ratings: numbers of games won, drawn and lost must be 0 or more")
    if alone := np.flatnonzero(~(wins + draws + losses > 0).any(1)).tolist():
        raise TrainingError(f"ratings: player {alone[0]} (from 0 on) has met no opponent of fixed rating")


def _fitted(games: Array, score: Array) -> Array:
    """Return the log odds, of mean 0, under which expected scores equal actual scores, by Newton's method."""
    odds: Array = np.zeros(games.shape[:-1])
    for _ in range(MOST):
        curvature = _laplacian(games * _slope(odds))
        rest = (score - games * _expected(odds)).sum(-1)
        step = (np.linalg.pinv(curvature, hermitian=True) @ rest[..., None])[..., 0]
        step /= np.abs(step).max(-1, keepdims=True).clip(1.0)  # a longer step might overshoot
        odds = odds + step
        if np.abs(step).max() < SURE:
            break
    return odds - odds.mean(-1, keepdims=True)


def _expected(odds: Array) -> Array:
    """Return the expected score of a game of i against j: (..., players, players)."""
    return 1 / (1 + np.exp(odds[..., None, :] - odds[..., :, None]))


def _slope(odds: Array) -> Array:
    """Return the derivative of the expected score of i against j by their difference: (..., players, players)."""
    return _expected(odds) * _expected(-odds)


def _laplacian(weights: Array) -> Array:
    """Return the sum over pairs of weight * (e_i - e_j)(e_i - e_j)^T, for symmetric weights."""
    return np.eye(weights.shape[-1]) * weights.sum(-1)[..., None] - weights

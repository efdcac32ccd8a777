"""Elo ratings by maximum likelihood (the Bradley-Terry model): of policies, and of groups of training seeds."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..base.curves import Curves
from ..base.errors import TrainingError
from ..base.statistics import Estimate, percentile_interval
from ..plots.runs import group_runs, run_of
from .players import Contender

Array = np.ndarray[Any, Any]

POINTS = 400 / math.log(10)  # Elo points of one unit of log odds: 400 more are odds of ten to one
MEAN = 1000.0  # mean of all ratings: arbitrary, since only differences matter
SURE, MOST = 1e-8, 1000  # Newton's method ends at a step shorter than this, in log odds, or after this many steps
REPS = 2000  # resamplings of groups: each takes a fit of all ratings
AGE = "agent_steps"  # the only difference between checkpoints of one run


def chained(scores: Array) -> Array:
    """Return whether a chain of scores leads from i to j: i scored against a player that scored against ... j.

    scores: (..., players, players). Without a chain, the likelihood grows without bound as j is rated higher above i.
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
    odds: Array = np.zeros(games.shape[:-1])
    for _ in range(MOST):
        chance = _chances(odds)
        rest = (score - games * chance).sum(-1)
        step = (_covariance(games, chance) @ rest[..., None])[..., 0]
        step /= np.abs(step).max(-1, keepdims=True).clip(1.0)  # a longer step might overshoot
        odds = odds + step
        if np.abs(step).max() < SURE:
            break
    odds -= odds.mean(-1, keepdims=True)
    scatter = won + drawn / 4 - np.divide(score**2, games, out=np.zeros_like(score), where=met)
    bread = _covariance(games, _chances(odds))
    error = np.sqrt(np.diagonal(bread @ _laplacian(scatter) @ bread, axis1=-2, axis2=-1).clip(0))
    return MEAN + POINTS * odds, POINTS * error


def _chances(odds: Array) -> Array:
    """Return the expected score of a game of i against j: (..., players, players)."""
    return 1 / (1 + np.exp(odds[..., None, :] - odds[..., :, None]))


def _covariance(games: Array, chance: Array) -> Array:
    """Return the inverse of the curvature of the likelihood."""
    return np.linalg.pinv(_laplacian(games * (chance * chance.swapaxes(-1, -2))), hermitian=True)


def _laplacian(weights: Array) -> Array:
    """Return the sum over pairs of weight * (e_i - e_j)(e_i - e_j)^T, for symmetric weights."""
    return np.eye(weights.shape[-1]) * weights.sum(-1)[..., None] - weights


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


@dataclass(frozen=True)
class PolicyGroup:
    """Policies that differ by the seeds of their training only; or a single other policy."""

    label: str  # differences from the other groups, see plots.runs.RunGroup; of a policy that is not a run, its own
    members: tuple[int, ...]  # indices of its policies
    trained: bool  # whether they are runs


@dataclass(frozen=True)
class Groups:
    """Results of groups, each as one player that draws one of its runs for every game.

    Attributes:
        groups: In order of their first policies.
        ratings: Elo, of mean 1000 over groups: value, low and high are float64 (groups,); an end is infinite where no
            game bounds the rating, as for a group that won every game.
        wins: Share of games that the first wins against the second, a draw counting half: float64 (groups, groups)
            each; NaN for a group against itself.
    """

    groups: list[PolicyGroup]
    ratings: Estimate
    wins: Estimate


def group_policies(chosen: Sequence[Contender]) -> list[PolicyGroup]:
    """Return the groups of policies. Raises TrainingError if two are the same run, or runs of one seed."""
    runs = {}
    for k, contender in enumerate(chosen):
        header = contender.player.header if contender.player else {"plan": {}}
        if plan := header["plan"]:  # the run that it is from, up to its checkpoint
            header = {**header, "plan": {**plan, AGE: header["steps"]}}
            runs[k] = run_of(Path(contender.text), header, Curves(np.array([header["steps"]]), {}))
    found = [PolicyGroup(each.label, (k,), False) for k, each in enumerate(chosen) if k not in runs]
    for group in group_runs(list(runs.values())) if runs else []:
        members = tuple(k for k, run in runs.items() if any(run is other for other in group.runs))
        found.append(PolicyGroup(group.label if len(members) > 1 else chosen[members[0]].label, members, True))
    return sorted(found, key=lambda group: group.members)


def rate_groups(groups: Sequence[PolicyGroup], wins: Array, draws: Array, seed: int, reps: int = REPS) -> Groups:
    """Return ratings and wins of groups, with 95 % bootstrap intervals over runs and over games.

    Each resampling draws, with replacement, as many runs from a group as it has, and draws the games of each pairing
    anew. The wins between two groups are the means over the pairings of their runs, so groups with more runs do not
    weigh more. For a group of one run only games are resampled. The interval of a share that is 1 or 0 ends there, and
    a rating that no game bounds has an infinite end, see `chained`.

    groups: At least two, which hold all policies. wins, draws: Games that each policy won against each other, and that
    were drawn, (policies, policies).
    """
    generator, own = np.random.default_rng(seed), np.zeros((1, len(groups), len(wins)))
    drawn = np.zeros((reps, len(groups), len(wins)))  # weights of the policies when runs are resampled
    for g, group in enumerate(groups):
        count = len(group.members)
        own[0, g, group.members] = 1 / count
        drawn[:, g, group.members] = generator.multinomial(count, [1 / count] * count, reps) / count
    won, tied = _mixed(own, wins[None], draws[None])
    chain = chained(won[0] + tied[0])
    value, shares = elo(won, tied)[0][0], _shares(won, tied)[0]
    won, tied = _mixed(drawn, *_replayed(wins, draws, generator, reps))
    low, high = percentile_interval(elo(won, tied, added=0)[0])  # `_replayed` has added the half games
    ratings = Estimate(value, np.where(chain.all(1), low, -np.inf), np.where(chain.all(0), high, np.inf))
    low, high = percentile_interval(_shares(won, tied))
    return Groups(list(groups), ratings, Estimate(shares, np.where(shares, low, 0), np.where(shares == 1, 1, high)))


def _replayed(wins: Array, draws: Array, generator: np.random.Generator, reps: int) -> tuple[Array, Array]:
    """Return wins and draws with the games of every pairing resampled, (reps, policies, policies) each.

    A Bayesian bootstrap: each game is weighted by a draw from an exponential distribution. As in `elo`, half a game won
    and half a game lost are added: chances are drawn as with Jeffreys' prior, and none is 0 or 1.
    """
    won, drawn = np.zeros((2, reps, *wins.shape))
    for i, j in np.argwhere(np.triu(wins + wins.T + draws, 1) > 0):
        results = np.array([wins[i, j] + 0.5, draws[i, j], wins[j, i] + 0.5])
        counts = generator.standard_gamma(results, (reps, 3))
        won[:, i, j], drawn[:, i, j], won[:, j, i] = (counts * (results.sum() / counts.sum(1, keepdims=True))).T
        drawn[:, j, i] = drawn[:, i, j]
    return won, drawn


def _mixed(weights: Array, wins: Array, draws: Array) -> tuple[Array, Array]:
    """Return wins and draws, (reps, groups, groups) each, of groups that are mixtures of policies.

    weights: (reps, groups, policies), which add up to 1 for each group.
    """
    across = weights.transpose(0, 2, 1)
    return weights @ wins @ across, weights @ draws @ across


def _shares(won: Array, drawn: Array) -> Array:
    """Return the shares of games that groups win, (reps, groups, groups): a draw counts half."""
    games = won + won.transpose(0, 2, 1) + drawn
    games[:, np.eye(games.shape[1], dtype=bool)] = np.nan
    return (won + drawn / 2) / games

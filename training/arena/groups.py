"""Policies in groups of runs that differ only by their seeds: ratings and wins, with intervals over seeds and games."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..base.curves import Curves
from ..base.statistics import Estimate, percentile_interval
from ..plots.groups import group_runs
from ..plots.runs import Run, run_of
from .players import Contender
from .ratings import chained, elo

Array = np.ndarray[Any, Any]

REPS = 2000  # resamplings: each takes a fit of all ratings
AGE = "agent_steps"  # the only difference between checkpoints of one run


@dataclass(frozen=True)
class PolicyGroup:
    """Policies that differ by the seeds of their training only; or a single other policy."""

    label: str  # differences from the other groups, see plots.groups.RunGroup; of a policy that is not a run, its own
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
    runs = {k: run for k, contender in enumerate(chosen) if (run := _run(contender)) is not None}
    found = [PolicyGroup(each.label, (k,), False) for k, each in enumerate(chosen) if k not in runs]
    for group in group_runs(list(runs.values())) if runs else []:
        members = tuple(k for k, run in runs.items() if any(run is other for other in group.runs))
        found.append(PolicyGroup(group.label if len(members) > 1 else chosen[members[0]].label, members, True))
    return sorted(found, key=lambda group: group.members)


def _run(contender: Contender) -> Run | None:
    """Return the run that a policy is from, up to its checkpoint.

    None if the policy has no description of its training.
    """
    if contender.player is None or not contender.player.header["plan"]:
        return None
    header = contender.player.header
    header = {**header, "plan": {**header["plan"], AGE: header["steps"]}}
    return run_of(Path(contender.text), header, Curves(np.array([header["steps"]]), {}))


def rate_groups(groups: Sequence[PolicyGroup], wins: Array, draws: Array, seed: int, reps: int = REPS) -> Groups:
    """Return ratings and wins of groups, with 95 % bootstrap intervals over runs and over games.

    Each resampling draws, with replacement, as many runs from a group as it has, and draws the games of each pairing
    anew. The wins between two groups are the means over the pairings of their runs, so groups with more runs do not
    weigh more. For a group of one run only games are resampled: its interval does not cover other seeds.

    A group that won every game would win every resampled one, too. So the interval of a share that is 1 or 0 ends
    there, and a rating that no game bounds has an infinite end, see `ratings.chained`.

    groups: At least two, which hold all policies. wins, draws: Games that each policy won against each other, and that
    were drawn, (policies, policies). seed: The same seed gives the same intervals.
    """
    generator, own = np.random.default_rng(seed), np.zeros((1, len(groups), len(wins)))
    for g, group in enumerate(groups):
        own[0, g, group.members] = 1 / len(group.members)
    drawn = np.concatenate([_drawn(group, len(wins), generator, reps) for group in groups], 1)
    won, tied = _mixed(own, wins[None], draws[None])
    chain = chained(won[0] + tied[0])
    value, shares = elo(won, tied)[0][0], _shares(won, tied)[0]
    won, tied = _mixed(drawn, *_replayed(wins, draws, generator, reps))
    low, high = percentile_interval(elo(won, tied, added=0)[0])  # `_replayed` has added the half games
    ratings = Estimate(value, np.where(chain.all(1), low, -np.inf), np.where(chain.all(0), high, np.inf))
    low, high = percentile_interval(_shares(won, tied))
    return Groups(list(groups), ratings, Estimate(shares, np.where(shares, low, 0), np.where(shares == 1, 1, high)))


def _drawn(group: PolicyGroup, policies: int, generator: np.random.Generator, reps: int) -> Array:
    """Return the weight of each policy in a group when its runs are resampled, (reps, 1, policies)."""
    count = len(group.members)
    weights = np.zeros((reps, 1, policies))
    weights[:, 0, group.members] = generator.multinomial(count, [1 / count] * count, reps) / count
    return weights


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

"""The paper's claims, sections 4 and 5, as measurements of its own curves, and of ours.

A claim is a sentence of the paper, a number that measures it, and the range in which that number must be. Where the
paper has "close to 0" or "significantly", the range is ours; it holds for the paper's own curves, which a test checks.
"""

import csv
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.resources import files

import numpy as np

from ..base.curves import BOXES, HEALS, KILLS, LENGTH, QUANTITIES, RETURN, Array, Curves, Quantity, smooth
from ..base.quantities import markdown_table, number, spread
from .results import PaperGroup, behaviour, published_curves

TABLE = "claims.csv"  # a row for each claim about "all" or "each" of some variants, with its measure
FFA, TEAMS = tuple(f"ffa_{k}" for k in range(1, 5)), tuple(f"teams_{k}" for k in range(1, 5))
HEADS = ("claim", "of", "measured", "asked", "the paper", "outlast", "95 %", "holds")
SUMMED = (KILLS,)  # over sides; other quantities are averaged
MILLION = 1e6
Measure = Callable[..., float]  # of a run of each variant of a claim; NaN if a run lacks the data


@dataclass(frozen=True)
class Claim:
    """A claim, with a function that measures it and the range in which it holds."""

    text: str
    variants: tuple[str, ...]  # its games
    what: str  # the number that measures it, in words
    measure: Measure  # called with a run of each of these variants
    low: float = -np.inf  # the least number for which the claim holds
    high: float = np.inf

    @property
    def asked(self) -> str:
        """The required range, in words."""
        if np.isinf(self.high):
            return f"≥ {number(self.low)}"
        return f"≤ {number(self.high)}" if np.isinf(self.low) else f"{number(self.low)} to {number(self.high)}"

    def holds(self, value: float) -> bool:
        """Return whether the claim holds with that number."""
        return self.low <= value <= self.high


@dataclass(frozen=True)
class ClaimResult:
    """A claim with its number in the paper's curves, NaN if they lack it, and in the runs of each of our seeds."""

    claim: Claim
    paper: float
    ours: tuple[float, ...]

    @property
    def mean(self) -> float:
        """The mean over seeds."""
        return float(np.mean(self.ours))

    @property
    def holds(self) -> bool:
        """Return whether the claim holds for the mean over seeds."""
        return self.claim.holds(self.mean)

    @property
    def cells(self) -> list[str]:
        """The cells of its row in the table."""
        claim, seeds = self.claim, sum(map(self.claim.holds, self.ours))
        verdict = ("yes" if self.holds else "no") + f", {seeds} of {len(self.ours)} seeds" * (len(self.ours) > 1)
        theirs = "" if np.isnan(self.paper) else number(self.paper)
        within = spread(self.ours) if np.isfinite(self.ours).all() else ""  # a ratio to 0 is infinite
        variants = {(*FFA, *TEAMS): "all", FFA: "ffa", TEAMS: "teams"}.get(claim.variants, ", ".join(claim.variants))
        return [claim.text, variants, claim.what, claim.asked, theirs, number(self.mean), within, verdict]


def findings(groups: Sequence[PaperGroup]) -> Iterator[ClaimResult]:
    """Yield a finding for every claim whose variants have runs of one seed as long as the paper's.

    groups: Runs with one preset; games with ablations are left out, since the paper has none.
    """
    by_seed: dict[int, dict[str, Curves]] = {}
    for group in groups:
        for run in group.runs:
            if run not in group.unfinished and not group.ablated:
                by_seed.setdefault(run.seed, {})[group.variant] = run.curves
    published = {name: published_curves(name) for name in (*FFA, *TEAMS)}
    for claim in claims():
        seeds = [runs for _, runs in sorted(by_seed.items()) if set(claim.variants) <= runs.keys()]
        paper, *ours = (claim.measure(*(runs[name] for name in claim.variants)) for runs in (published, *seeds))
        if values := [value for value in ours if not np.isnan(value)]:
            yield ClaimResult(claim, paper, tuple(values))


def claims_table(found: Sequence[ClaimResult]) -> str:
    """Return the table of findings, in Markdown."""
    return markdown_table(HEADS, [each.cells for each in found])


def curve(run: Curves, quantity: Quantity) -> Array:
    """Return a quantity of all sides of a run, (points,): the sum of kills, the mean of others.

    NaN if the run lacks it.
    """
    own = [run.values[tag] for tag in run.tags(quantity)]
    if not own:
        return np.full(len(run.steps), np.nan)
    return np.asarray((np.sum if quantity in SUMMED else np.mean)(own, 0, dtype=np.float64))


def part(run: Curves, quantity: Quantity, first: float, last: float) -> float:
    """Return the mean of a part of a curve, from one share of its points to another; NaNs are left out."""
    values = curve(run, quantity)
    there = values[round(first * len(values)) : max(round(first * len(values)) + 1, round(last * len(values)))]
    there = there[np.isfinite(there)]
    return float(there.mean()) if len(there) else float("nan")


def end(run: Curves, quantity: Quantity) -> float:
    """Return the mean of the last tenth."""
    return part(run, quantity, 0.9, 1.0)


def peak(run: Curves, quantity: Quantity) -> float:
    """Return the maximum of the moving average."""
    return float(np.nanmax(smooth(curve(run, quantity)), initial=np.nan))


def peak_at(run: Curves, quantity: Quantity) -> float:
    """Return the position of the maximum of the moving average, in millions of agent-steps."""
    return float(run.steps[np.nanargmax(smooth(curve(run, quantity)))]) / MILLION


def at(run: Curves, quantity: Quantity, millions: float) -> float:
    """Return the moving average at a number of millions of agent-steps."""
    averages = smooth(curve(run, quantity))
    return float(averages[min(int(np.searchsorted(run.steps, millions * MILLION)), len(averages) - 1)])


def together(run: Curves, one: Quantity, other: Quantity) -> float:
    """Return the correlation of the moving averages of two quantities."""
    averages = np.stack([smooth(curve(run, each)) for each in (one, other)])
    there = averages[:, np.isfinite(averages).all(0)]
    return float(np.corrcoef(there)[0, 1]) if there.std(1).all() else float("nan")


def over(one: float, other: float) -> float:
    """Divide one by the other; infinite if the other is 0, NaN if both are."""
    return one / other if other else math.inf if one else math.nan


NEAR, FAR = behaviour("attack_near"), behaviour("attack_far")
HELD, ZONE, FIRST = behaviour("heals_held"), behaviour("zone_distance"), Quantity("first death", "rollout/first_death")
NAMED: dict[str, Measure] = {
    "late kills": lambda run: over(part(run, KILLS, 2 / 3, 1), part(run, KILLS, 1 / 3, 2 / 3)),
    "kills after the peak": lambda run: over(end(run, KILLS), part(run, KILLS, 0.2, 0.4)),
    "later peak": lambda run: max(peak_at(run, BOXES), peak_at(run, KILLS)),
    "heals and return": lambda run: together(run, HEALS, RETURN),
    "early heals": lambda run: over(at(run, HEALS, 2), end(run, HEALS)),
    "first death": lambda run: over(end(run, FIRST), end(run, LENGTH)),
    "distance to the zone": lambda run: over(end(run, ZONE), at(run, ZONE, 4)),
    "kills of the first": lambda first, *others: over(end(first, KILLS), max(end(run, KILLS) for run in others)),
    "peak of the first": lambda first, *others: over(peak(first, KILLS), max(peak(run, KILLS) for run in others)),
    "heals of the last": lambda *runs: over(end(runs[-1], HEALS), min(end(run, HEALS) for run in runs[:-1])),
    "attacks of the last": lambda first, last: over(end(last, FAR), end(first, FAR)),
    "most kills": lambda *runs: max(end(run, KILLS) for run in runs),
    "survival": lambda *runs: over(
        min(end(run, LENGTH) for run in runs[:3]), max(end(run, LENGTH) for run in runs[3:])
    ),
}
OF_QUANTITY: dict[str, Measure] = {
    "left": lambda run, quantity: over(end(run, quantity), peak(run, quantity)),
    "end": end,
    "grows": lambda run, quantity: over(part(run, quantity, 2 / 3, 1), part(run, quantity, 0, 1 / 3)),
    "peak": peak,
    "peak_at": peak_at,
}
NAMED |= {  # a measure of a quantity of one run: "left return"
    f"{name} {quantity.name}": partial(measure, quantity=quantity)
    for name, measure in OF_QUANTITY.items()
    for quantity in (*QUANTITIES, NEAR, FAR, HELD)
}


def claims() -> Iterator[Claim]:
    """Yield the claims, in order of the paper's text."""
    known = {"ffa": FFA, "teams": TEAMS}
    text = files(__package__).joinpath(TABLE).read_text(encoding="utf-8")
    for row in csv.DictReader(text.splitlines()):
        variants = tuple(name for word in row["variants"].split() for name in known.get(word, (word,)))
        ends = float(row["low"] or -np.inf), float(row["high"] or np.inf)
        for names in [variants] if row["of"] == "all" else [(name,) for name in variants]:
            yield Claim(row["text"], names, row["what"], NAMED[row["measure"]], *ends)

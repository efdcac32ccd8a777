"""The paper's claims, sections 4 and 5, as measurements of curves: of its own, and of ours.

A claim is a sentence of the paper, a number that says whether it is so, and the range in which that number has to be.
Where the paper says "close to 0" or "significantly", the range is ours; it holds for the paper's own curves, which a
test checks. What the paper saw by looking at policies has no curve of its own: there, ours are measured alone.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..base.averages import smooth
from ..base.curves import BOXES, HEALS, KILLS, LENGTH, RETURN, Array, Curves, Quantity
from ..base.tables import markdown_table, number, spread
from .results import PaperGroup, behaviour, published_curves

FFA, TEAMS = tuple(f"ffa_{k}" for k in range(1, 5)), tuple(f"teams_{k}" for k in range(1, 5))
HEADS = ("claim", "of", "measured", "asked", "the paper", "outlast", "95 %", "holds")
SUMMED = (KILLS,)  # over sides; other quantities are averaged
MILLION = 1e6
Measure = Callable[..., float]  # of a run of each variant that a claim is about; NaN if a run does not say


@dataclass(frozen=True)
class Claim:
    """A claim.

    Attributes:
        text: What the paper says.
        variants: The games that it is about.
        what: What is measured.
        measure: Called with a run of each of these variants.
        low: The least number with which the claim holds.
        high: The largest one.
    """

    text: str
    variants: tuple[str, ...]
    what: str
    measure: Measure
    low: float = -np.inf
    high: float = np.inf

    @property
    def asked(self) -> str:
        """The range, in words."""
        if np.isinf(self.high):
            return f"≥ {number(self.low)}"
        return f"≤ {number(self.high)}" if np.isinf(self.low) else f"{number(self.low)} to {number(self.high)}"

    def holds(self, value: float) -> bool:
        """Whether the claim holds with that number."""
        return self.low <= value <= self.high


@dataclass(frozen=True)
class ClaimResult:
    """A claim with its number in the paper's curves, NaN if they do not say, and in the runs of each of our seeds."""

    claim: Claim
    paper: float
    ours: tuple[float, ...]

    @property
    def mean(self) -> float:
        """The mean over seeds."""
        return float(np.mean(self.ours))

    @property
    def holds(self) -> bool:
        """Whether it holds for the mean over seeds."""
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
    """Yield a finding for every claim for whose variants there are runs of one seed as long as the paper's.

    groups: Runs with one preset; those of games with ablations say nothing about the paper's.
    """
    by_seed: dict[int, dict[str, Curves]] = {}
    for group in groups:
        for run in group.runs:
            if run.done and not group.ablated:
                by_seed.setdefault(run.seed, {})[group.variant] = run.curves
    published = {name: published_curves(name) for name in (*FFA, *TEAMS)}
    for claim in CLAIMS:
        seeds = [runs for _, runs in sorted(by_seed.items()) if set(claim.variants) <= runs.keys()]
        paper, *ours = (claim.measure(*(runs[name] for name in claim.variants)) for runs in (published, *seeds))
        if values := [value for value in ours if not np.isnan(value)]:
            yield ClaimResult(claim, paper, tuple(values))


def claims_table(found: Sequence[ClaimResult]) -> str:
    """The table of findings, in Markdown."""
    return markdown_table(HEADS, [each.cells for each in found])


def curve(run: Curves, quantity: Quantity) -> Array:
    """A quantity of all sides of a run, (points,): the sum of kills, the mean of others. NaN if the run lacks it."""
    own = [run.values[tag] for tag in run.tags(quantity)]
    if not own:
        return np.full(len(run.steps), np.nan)
    combined: Array = np.asarray((np.sum if quantity in SUMMED else np.mean)(own, 0, dtype=np.float64))
    return combined


def part(run: Curves, quantity: Quantity, first: float, last: float) -> float:
    """The mean of a part of a curve, from one share of its points to another; NaNs are left out."""
    values = curve(run, quantity)
    there = values[round(first * len(values)) : max(round(first * len(values)) + 1, round(last * len(values)))]
    there = there[np.isfinite(there)]
    return float(there.mean()) if len(there) else float("nan")


def end(run: Curves, quantity: Quantity) -> float:
    """The mean of the last tenth."""
    return part(run, quantity, 0.9, 1.0)


def peak(run: Curves, quantity: Quantity) -> float:
    """The maximum of the moving average."""
    return float(np.nanmax(smooth(curve(run, quantity)), initial=np.nan))


def peak_at(run: Curves, quantity: Quantity) -> float:
    """Where the maximum of the moving average is, in millions of agent-steps."""
    return float(run.steps[np.nanargmax(smooth(curve(run, quantity)))]) / MILLION


def left(run: Curves, quantity: Quantity) -> float:
    """What is left of the peak at the end, as a share."""
    return over(end(run, quantity), peak(run, quantity))


def at(run: Curves, quantity: Quantity, millions: float) -> float:
    """The moving average after so many millions of agent-steps."""
    averages = smooth(curve(run, quantity))
    return float(averages[min(int(np.searchsorted(run.steps, millions * MILLION)), len(averages) - 1)])


def grows(run: Curves, quantity: Quantity) -> float:
    """The mean of the last third over that of the first third."""
    return over(part(run, quantity, 2 / 3, 1), part(run, quantity, 0, 1 / 3))


def together(run: Curves, one: Quantity, other: Quantity) -> float:
    """The correlation of the moving averages of two quantities."""
    averages = np.stack([smooth(curve(run, each)) for each in (one, other)])
    there = averages[:, np.isfinite(averages).all(0)]
    return float(np.corrcoef(there)[0, 1]) if there.std(1).all() else float("nan")


def over(one: float, other: float) -> float:
    """One over the other; infinite if the other is 0, NaN if both are."""
    return one / other if other else math.inf if one else math.nan


def _of(measure: Measure, *quantities: Quantity) -> Measure:
    """A measure of one run."""
    return lambda run: measure(run, *quantities)


def _each(
    variants: Sequence[str], text: str, what: str, measure: Measure, low: float = -np.inf, high: float = np.inf
) -> list[Claim]:
    """A claim about each of several variants."""
    return [Claim(text, (name,), what, measure, low, high) for name in variants]


NEAR, FAR = behaviour("attack_near"), behaviour("attack_far")
HELD, ZONE, FIRST = behaviour("heals_held"), behaviour("zone_distance"), Quantity("first death", "rollout/first_death")
LEFT = "what is left of the peak at the end"

CLAIMS: tuple[Claim, ...] = (
    *_each(
        FFA,
        "The reward steadily increases for the whole training.",
        "what is left of the return's peak at the end",
        _of(left, RETURN),
        low=0.9,
    ),
    *_each(FFA, "So does the number of heals used.", "what is left of its peak at the end", _of(left, HEALS), low=0.75),
    Claim(
        "Kills are lower than 1, but significantly higher than in other free-for-all variants.",
        FFA,
        "kills in ffa_1 over the most of the others, at the end",
        lambda first, *others: over(end(first, KILLS), max(end(run, KILLS) for run in others)),
        low=1.2,
    ),
    *_each(
        FFA[:1],
        "Kills increase early, and then stabilise.",
        "kills, last third over middle third",
        lambda run: over(*(part(run, KILLS, k / 3, (k + 1) / 3) for k in (2, 1))),
        low=0.5,
        high=2,
    ),
    *_each(FFA[1:2], "Kills almost vanish.", "kills at the end", _of(end, KILLS), high=0.05),
    *_each(
        (*FFA[2:], "teams_4"), "Kills increase slowly.", "kills, last third over first third", _of(grows, KILLS), low=1
    ),
    *_each((*FFA[2:], *TEAMS[1:3]), "Kills remain close to 0.", "kills at the end", _of(end, KILLS), high=0.4),
    *_each(FFA[2:], "Boxes placed remain close to 0.", "boxes placed at the end", _of(end, BOXES), high=0.75),
    Claim(
        "Heals used are significantly fewer in ffa_4.",
        FFA,
        "heals in ffa_4 over the fewest of the others, at the end",
        lambda *runs: over(end(runs[3], HEALS), min(end(run, HEALS) for run in runs[:3])),
        high=0.8,
    ),
    *_each(
        FFA[1:3],
        "Agents do not attack an opponent in range.",
        "attacks with an opponent in range, share of ticks",
        _of(end, NEAR),
        high=0.25,
    ),
    *_each(
        FFA[1:2],
        "They attack all the time when nobody is in range.",
        "attacks with nobody in range",
        _of(end, FAR),
        low=0.5,
    ),
    Claim(
        "In ffa_3 they attack only boxes.",
        FFA[1:3],
        "attacks with nobody in range, ffa_3 over ffa_2",
        lambda second, third: over(end(third, FAR), end(second, FAR)),
        high=0.8,
    ),
    *_each(
        ("ffa_1", *TEAMS),
        "Agents attack an opponent in range almost always.",
        "attacks with an opponent in range, share of ticks",
        _of(end, NEAR),
        low=0.7,
    ),
    *_each(
        TEAMS[:3],
        "The return peaks around 4 million steps.",
        "its peak, in millions of agent-steps",
        _of(peak_at, RETURN),
        low=2,
        high=6,
    ),
    *_each(TEAMS[:3], "Afterwards it decreases significantly.", LEFT, _of(left, RETURN), high=0.9),
    *_each(TEAMS[3:], "The return of teams_4 does not decrease.", LEFT, _of(left, RETURN), low=0.9),
    *_each(
        TEAMS[:1],
        "Boxes placed and kills peak around 3 million steps.",
        "the later of both peaks, in millions of agent-steps",
        lambda run: max(peak_at(run, BOXES), peak_at(run, KILLS)),
        low=1.5,
        high=4.5,
    ),
    Claim(
        "Kills are higher in teams_1 than in teams_2 and teams_3.",
        TEAMS[:3],
        "peak in teams_1 over the higher of the others",
        lambda first, *others: over(peak(first, KILLS), max(peak(run, KILLS) for run in others)),
        low=1.2,
    ),
    *_each(
        TEAMS[1:2],
        "Kills are higher from 2 to 4 million steps, and then decrease.",
        "kills at the end over those from 2 to 4 million",
        lambda run: over(end(run, KILLS), part(run, KILLS, 0.2, 0.4)),
        high=0.8,
    ),
    *_each(
        TEAMS,
        "The number of heals used follows the reward.",
        "correlation of the moving averages",
        _of(together, HEALS, RETURN),
        low=0.3,
    ),
    *_each(
        ("teams_1", "teams_4"),
        "Boxes placed reach values slightly greater than 1.",
        "peak of boxes placed",
        _of(peak, BOXES),
        low=1,
    ),
    *_each(TEAMS[:1], "They decrease again.", LEFT, _of(left, BOXES), high=0.75),
    *_each(TEAMS[3:], "Boxes placed increase slowly.", "last third over first third", _of(grows, BOXES), low=1),
    *_each(
        TEAMS[3:],
        "Heals stabilise at around 2 million steps.",
        "heals at 2 million over those at the end",
        lambda run: over(at(run, HEALS, 2), end(run, HEALS)),
        low=0.75,
        high=1.25,
    ),
    Claim(
        "Kills do not come close to 1 in any variant.",
        (*FFA, *TEAMS),
        "the most kills of all sides, at the end",
        lambda *runs: max(end(run, KILLS) for run in runs),
        high=0.75,
    ),
    *_each(
        TEAMS[:3],
        "One agent of a team dies early, while others live much longer.",
        "the first death over the length of the episode",
        lambda run: over(end(run, FIRST), end(run, LENGTH)),
        high=0.6,
    ),
    *_each(
        TEAMS[:3],
        "Agents spread out more than at 4 million steps, even away from the zone.",
        "metres to the zone's centre, at the end over at 4 million",
        lambda run: over(end(run, ZONE), at(run, ZONE, 4)),
        low=1.05,
    ),
    Claim(
        "Only in the first three free-for-all variants do agents survive reliably.",
        (*FFA, *TEAMS),
        "the shortest episodes of these over the longest of the others, at the end",
        lambda *runs: over(min(end(run, LENGTH) for run in runs[:3]), max(end(run, LENGTH) for run in runs[3:])),
        low=1.1,
    ),
    *_each(
        (*FFA, *TEAMS),
        "Heals are used as soon as they are collected (flaw 1).",
        "heals in the bag of a living agent",
        _of(end, HELD),
        high=0.25,
    ),
)

"""The paper's claims, sections 4 and 5, as measurements of curves: of its own, and of ours.

A claim is a sentence of the paper, a number that says whether it is so, and the range in which that number has to be.
Where the paper says "close to 0" or "significantly", the range is ours; it holds for the paper's own curves, which a
test checks. What the paper saw by looking at policies has no curve of its own: there, ours are measured alone.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..base.curves import BOXES, HEALS, KILLS, LENGTH, RETURN, Curves, Quantity
from ..base.tables import markdown_table, number, spread
from .measures import Runs, at, curve, end, grows, left, over, part, peak, peak_at, together
from .published import behaviour, published_curves
from .results import PaperGroup

FFA, TEAMS = tuple(f"ffa_{k}" for k in range(1, 5)), tuple(f"teams_{k}" for k in range(1, 5))
HEADS = ("claim", "of", "measured", "asked", "the paper", "outlast", "95 %", "holds")


@dataclass(frozen=True)
class Claim:
    """A claim.

    Attributes:
        text: What the paper says.
        variants: The games that it is about; the measurement takes a run of each.
        what: What is measured.
        measure: Measures that in a run of each of these variants; NaN if a run does not say.
        low: The least number with which the claim holds.
        high: The largest one.
    """

    text: str
    variants: tuple[str, ...]
    what: str
    measure: Callable[[Runs], float]
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
        numbers = [claim.asked, theirs, number(self.mean), within]
        return [claim.text, _listed(claim.variants), claim.what, *numbers, verdict]


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
        values = [value for runs in seeds if not np.isnan(value := claim.measure(runs))]
        if values:
            yield ClaimResult(claim, claim.measure(published), tuple(values))


def claims_table(found: Sequence[ClaimResult]) -> str:
    """The table of findings, in Markdown."""
    return markdown_table(HEADS, [each.cells for each in found])


def _listed(variants: Sequence[str]) -> str:
    """The variants of a claim: "all", "ffa", "teams_1, teams_4"."""
    names = {(*FFA, *TEAMS): "all", FFA: "ffa", TEAMS: "teams"}
    return names.get(tuple(variants), ", ".join(variants))


def _over(
    text: str,
    variants: Sequence[str],
    what: str,
    measure: Callable[[Runs, str], float],
    low: float = -np.inf,
    high: float = np.inf,
) -> list[Claim]:
    """A claim about each of several variants."""
    return [Claim(text, (name,), what, lambda runs, own=name: measure(runs, own), low, high) for name in variants]  # type: ignore[misc]


NEAR, FAR = behaviour("attack_near"), behaviour("attack_far")
HELD, ZONE, FIRST = behaviour("heals_held"), behaviour("zone_distance"), Quantity("first death", "rollout/first_death")

CLAIMS: tuple[Claim, ...] = (
    *_over(
        "The reward steadily increases for the whole training.",
        FFA,
        "what is left of the return's peak at the end",
        lambda runs, name: left(runs, name, RETURN),
        low=0.9,
    ),
    *_over(
        "So does the number of heals used.",
        FFA,
        "what is left of its peak at the end",
        lambda runs, name: left(runs, name, HEALS),
        low=0.75,
    ),
    Claim(
        "Kills are lower than 1, but significantly higher than in other free-for-all variants.",
        FFA,
        "kills in ffa_1 over the most of the others, at the end",
        lambda runs: over(end(runs, "ffa_1", KILLS), max(end(runs, name, KILLS) for name in FFA[1:])),
        low=1.2,
    ),
    *_over(
        "Kills increase early, and then stabilise.",
        FFA[:1],
        "kills, last third over middle third",
        lambda runs, name: over(*(part(curve(runs, name, KILLS), k / 3, (k + 1) / 3) for k in (2, 1))),
        low=0.5,
        high=2,
    ),
    *_over("Kills almost vanish.", FFA[1:2], "kills at the end", lambda runs, name: end(runs, name, KILLS), high=0.05),
    *_over(
        "Kills increase slowly.",
        (*FFA[2:], "teams_4"),
        "kills, last third over first third",
        lambda runs, name: grows(runs, name, KILLS),
        low=1,
    ),
    *_over(
        "Kills remain close to 0.",
        (*FFA[2:], *TEAMS[1:3]),
        "kills at the end",
        lambda runs, name: end(runs, name, KILLS),
        high=0.4,
    ),
    *_over(
        "Boxes placed remain close to 0.",
        FFA[2:],
        "boxes placed at the end",
        lambda runs, name: end(runs, name, BOXES),
        high=0.75,
    ),
    Claim(
        "Heals used are significantly fewer in ffa_4.",
        FFA,
        "heals in ffa_4 over the fewest of the others, at the end",
        lambda runs: over(end(runs, "ffa_4", HEALS), min(end(runs, name, HEALS) for name in FFA[:3])),
        high=0.8,
    ),
    *_over(
        "Agents do not attack an opponent in range.",
        FFA[1:3],
        "attacks with an opponent in range, share of ticks",
        lambda runs, name: end(runs, name, NEAR),
        high=0.25,
    ),
    *_over(
        "They attack all the time when nobody is in range.",
        FFA[1:2],
        "attacks with nobody in range",
        lambda runs, name: end(runs, name, FAR),
        low=0.5,
    ),
    Claim(
        "In ffa_3 they attack only boxes.",
        FFA[1:3],
        "attacks with nobody in range, ffa_3 over ffa_2",
        lambda runs: over(end(runs, "ffa_3", FAR), end(runs, "ffa_2", FAR)),
        high=0.8,
    ),
    *_over(
        "Agents attack an opponent in range almost always.",
        ("ffa_1", *TEAMS),
        "attacks with an opponent in range, share of ticks",
        lambda runs, name: end(runs, name, NEAR),
        low=0.7,
    ),
    *_over(
        "The return peaks around 4 million steps.",
        TEAMS[:3],
        "its peak, in millions of agent-steps",
        lambda runs, name: peak_at(runs, name, RETURN),
        low=2,
        high=6,
    ),
    *_over(
        "Afterwards it decreases significantly.",
        TEAMS[:3],
        "what is left of the peak at the end",
        lambda runs, name: left(runs, name, RETURN),
        high=0.9,
    ),
    *_over(
        "The return of teams_4 does not decrease.",
        TEAMS[3:],
        "what is left of the peak at the end",
        lambda runs, name: left(runs, name, RETURN),
        low=0.9,
    ),
    *_over(
        "Boxes placed and kills peak around 3 million steps.",
        TEAMS[:1],
        "the later of both peaks, in millions of agent-steps",
        lambda runs, name: max(peak_at(runs, name, BOXES), peak_at(runs, name, KILLS)),
        low=1.5,
        high=4.5,
    ),
    Claim(
        "Kills are higher in teams_1 than in teams_2 and teams_3.",
        TEAMS[:3],
        "peak in teams_1 over the higher of the others",
        lambda runs: over(peak(runs, "teams_1", KILLS), max(peak(runs, name, KILLS) for name in TEAMS[1:3])),
        low=1.2,
    ),
    *_over(
        "Kills are higher from 2 to 4 million steps, and then decrease.",
        TEAMS[1:2],
        "kills at the end over those from 2 to 4 million",
        lambda runs, name: over(end(runs, name, KILLS), part(curve(runs, name, KILLS), 0.2, 0.4)),
        high=0.8,
    ),
    *_over(
        "The number of heals used follows the reward.",
        TEAMS,
        "correlation of the moving averages",
        lambda runs, name: together(runs, name, HEALS, RETURN),
        low=0.3,
    ),
    *_over(
        "Boxes placed reach values slightly greater than 1.",
        ("teams_1", "teams_4"),
        "peak of boxes placed",
        lambda runs, name: peak(runs, name, BOXES),
        low=1,
    ),
    *_over(
        "They decrease again.",
        TEAMS[:1],
        "what is left of the peak at the end",
        lambda runs, name: left(runs, name, BOXES),
        high=0.75,
    ),
    *_over(
        "Boxes placed increase slowly.",
        TEAMS[3:],
        "last third over first third",
        lambda runs, name: grows(runs, name, BOXES),
        low=1,
    ),
    *_over(
        "Heals stabilise at around 2 million steps.",
        TEAMS[3:],
        "heals at 2 million over those at the end",
        lambda runs, name: over(at(runs, name, HEALS, 2), end(runs, name, HEALS)),
        low=0.75,
        high=1.25,
    ),
    Claim(
        "Kills do not come close to 1 in any variant.",
        (*FFA, *TEAMS),
        "the most kills of all sides, at the end",
        lambda runs: max(end(runs, name, KILLS) for name in (*FFA, *TEAMS)),
        high=0.75,
    ),
    *_over(
        "One agent of a team dies early, while others live much longer.",
        TEAMS[:3],
        "the first death over the length of the episode",
        lambda runs, name: over(end(runs, name, FIRST), end(runs, name, LENGTH)),
        high=0.6,
    ),
    *_over(
        "Agents spread out more than at 4 million steps, even away from the zone.",
        TEAMS[:3],
        "metres to the zone's centre, at the end over at 4 million",
        lambda runs, name: over(end(runs, name, ZONE), at(runs, name, ZONE, 4)),
        low=1.05,
    ),
    Claim(
        "Only in the first three free-for-all variants do agents survive reliably.",
        (*FFA, *TEAMS),
        "the shortest episodes of these over the longest of the others, at the end",
        lambda runs: over(
            min(end(runs, name, LENGTH) for name in FFA[:3]), max(end(runs, name, LENGTH) for name in (FFA[3], *TEAMS))
        ),
        low=1.1,
    ),
    *_over(
        "Heals are used as soon as they are collected (flaw 1).",
        (*FFA, *TEAMS),
        "heals in the bag of a living agent",
        lambda runs, name: end(runs, name, HELD),
        high=0.25,
    ),
)

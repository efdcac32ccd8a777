"""Checks of the paper's claims against our runs."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ..curves import Quantity
from ..tables import number
from .curves import KILLS, LENGTH, RETURN
from .end_values import TOLERANCE, EndRow, rows
from .results import RunGroup

PEACEFUL = ("ffa_2",)  # "the number of kills almost vanishes in the last stages of training"
FEW = 0.05  # kills in an episode, of all agents
DECLINING = ("teams_1", "teams_2", "teams_3")  # "an initial increase", and then "the rewards decrease significantly"
DECLINE = 0.1  # of the peak, at least, that is lost by the end


@dataclass(frozen=True)
class Claim:
    """A sentence with numbers, and whether our runs agree with the paper."""

    text: str
    holds: bool


def claims(group: RunGroup) -> Iterator[Claim]:
    """The checks of a group; none if its runs are of another game than the paper's, or shorter."""
    if group.ablated or not all(run.done for run in group.ended):
        return
    found = [row for row in rows(group) if row.theirs]
    yield _close(found)
    if group.variant in PEACEFUL:
        yield _peaceful(_of(found, KILLS))
    if group.variant in DECLINING:
        yield _declining(_of(found, RETURN))


def sentences(group: RunGroup) -> str:
    """The checks as a list in Markdown; empty if there are none."""
    return "\n".join(f"- {'Agrees' if claim.holds else 'Differs'}: {claim.text}." for claim in claims(group))


def _of(found: Sequence[EndRow], quantity: Quantity) -> list[EndRow]:
    return [row for row in found if row.quantity == quantity]


def _close(found: Sequence[EndRow]) -> Claim:
    judged = [abs(row.apart) for row in found if row.apart is not None]
    names = f"{RETURN.name}s and {LENGTH.name}"
    return Claim(
        f"{names} end at most {max(judged):.0%} from the paper's (asked: {TOLERANCE:.0%})", max(judged) <= TOLERANCE
    )


def _peaceful(kills: Sequence[EndRow]) -> Claim:
    ours, theirs = sum(row.mean for row in kills), sum(row.theirs.mean for row in kills if row.theirs)
    text = f"{number(ours)} kills in an episode at the end (the paper: {number(theirs)}; asked: fewer than {FEW})"
    return Claim(text, ours < FEW)


def _declining(returns: Sequence[EndRow]) -> Claim:
    """Judged by the side that loses least."""
    ours = min(1 - row.mean / row.curve.peak[1] for row in returns)
    theirs = min(1 - row.theirs.mean / row.their_curve.peak[1] for row in returns if row.theirs and row.their_curve)
    text = f"returns end at least {ours:.0%} below their peak (the paper: {theirs:.0%}; asked: {DECLINE:.0%})"
    return Claim(text, ours >= DECLINE)

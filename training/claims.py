"""What the paper found, held against what came out here, in sentences."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from .curves import KILLS, LENGTH, RETURN, Quantity
from .endings import CLOSE
from .endtable import Row, number, rows
from .results import Group

PEACEFUL = ("ffa_2",)  # "the number of kills almost vanishes in the last stages of training"
FEW = 0.05  # kills in an episode, of all agents
DECLINING = ("teams_1", "teams_2", "teams_3")  # "an initial increase", and then "the rewards decrease significantly"
DECLINE = 0.1  # of the peak, at least, that is lost by the end


@dataclass(frozen=True)
class Claim:
    """A sentence with numbers, and whether it agrees with the paper."""

    text: str
    holds: bool


def claims(group: Group) -> Iterator[Claim]:
    """Of a group whose runs are of the paper's game and as long as the paper's; nothing of others."""
    if group.mended or not all(run.done for run in group.ended):
        return
    found = [row for row in rows(group) if row.theirs]
    yield _close(found)
    if group.variant in PEACEFUL:
        yield _peaceful(_of(found, KILLS))
    if group.variant in DECLINING:
        yield _declining(_of(found, RETURN))


def sentences(group: Group) -> str:
    """The claims as a list in Markdown; nothing if there are none."""
    return "\n".join(f"- {'Agrees' if claim.holds else 'Differs'}: {claim.text}." for claim in claims(group))


def _of(found: Sequence[Row], quantity: Quantity) -> list[Row]:
    return [row for row in found if row.quantity == quantity]


def _close(found: Sequence[Row]) -> Claim:
    judged = [abs(row.apart) for row in found if row.apart is not None]
    names = f"{RETURN.name}s and {LENGTH.name}"
    return Claim(f"{names} end at most {max(judged):.0%} from the paper's (asked: {CLOSE:.0%})", max(judged) <= CLOSE)


def _peaceful(kills: Sequence[Row]) -> Claim:
    ours, theirs = sum(row.mean for row in kills), sum(row.theirs.mean for row in kills if row.theirs)
    text = f"{number(ours)} kills in an episode at the end (the paper: {number(theirs)}; asked: fewer than {FEW})"
    return Claim(text, ours < FEW)


def _declining(returns: Sequence[Row]) -> Claim:
    """The side that loses least counts."""
    ours = min(1 - row.mean / row.curve.peak[1] for row in returns)
    theirs = min(1 - row.theirs.mean / row.their_curve.peak[1] for row in returns if row.theirs and row.their_curve)
    text = f"returns end at least {ours:.0%} below their peak (the paper: {theirs:.0%}; asked: {DECLINE:.0%})"
    return Claim(text, ours >= DECLINE)

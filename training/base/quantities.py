"""Columns of evaluations and training logs: the unit and meaning of each."""

import textwrap
from collections.abc import Iterator, Sequence
from typing import NamedTuple


class Meaning(NamedTuple):
    """The unit ("" for counts) and meaning of a column."""

    unit: str
    meaning: str


SUMMED = ("kills",)  # over the sides of an episode, where one number is shown; all others with several are averaged

# "Its" refers to the policy of the row, which plays one of two sides, or every other side where there are more.
COLUMNS = {
    "wins": Meaning(
        "share",
        "of the episodes that it wins: one of its sides outlives all others, or the game names it the winner; a draw "
        "counts half",
    ),
    "wins_first": Meaning(
        "share",
        "that it wins of the episodes in which it plays the first side. As agents see their id, a policy may play "
        "sides differently that are alike, also against itself",
    ),
    "wins_second": Meaning("share", "that it wins of the episodes in which its opponent plays the first side"),
    "length": Meaning("ticks", "of an episode; the same for both policies"),
    "life": Meaning("ticks", "that its longest-lived side has a living agent"),
    "return": Meaning(
        "reward",
        "that one of its agents gets in an episode, on average over its agents. Alone it does not show which policy is "
        "better: a long game rewards both sides",
    ),
    "kills": Meaning("", "kills by its sides in an episode"),
    "deaths_TYPE": Meaning("", "deaths of its agents in an episode by that type of damage: melee, zone"),
    "first_death": Meaning(
        "ticks", "until the first agent dies, in episodes in which one does; the same for both policies"
    ),
    "heals_used": Meaning("", "heals that all agents use in an episode; the same for both policies"),
    "boxes_placed": Meaning("", "boxes that all agents set up in an episode; the same for both policies"),
    "heals_given": Meaning("", "heals that its agents give to others in an episode; in logs, in 1000 agent-steps"),
    "heals_held": Meaning("", "heals in the bag of one of its living agents, on average over ticks"),
    "zone_distance": Meaning("m", "from its living agents to the centre of the safe zone, on average over ticks"),
    "near": Meaning(
        "share",
        "of the ticks of its living agents in which they could strike an enemy: its centre is within melee_reach + its "
        "agents_radius",
    ),
    "attack_near": Meaning("share", "of those ticks in which the agent attacks"),
    "attack_far": Meaning("share", "of the other ticks in which the agent attacks, without an enemy to strike"),
}


def combinable(tags: Sequence[str]) -> Sequence[str]:
    """Return the tags of one statistic in a log that are combined into one number.

    Where episodes differ in their sides, means of sides are over different episodes and cannot be added up. Then the
    value of all sides is logged, too, under the tag without a number; in that case only this tag is returned.
    """
    return [tag for tag in tags if f"{tag}0" in tags] or tags


def explained(width: int = 78) -> Iterator[str]:
    """Yield one or more lines of help for each column."""
    indent = max(map(len, COLUMNS)) + 4
    for name, (unit, meaning) in COLUMNS.items():
        text = f"{unit} {meaning}".strip()
        first = f"  {name}".ljust(indent)
        yield textwrap.fill(text, width, initial_indent=first, subsequent_indent=" " * indent)
    yield "  All other columns are statistics of the game's mechanics in an episode:"
    yield "  those of agents are means over its agents, those of sides sums over its"
    yield "  sides, and those of the world the same for both policies."

"""What evaluations report, and training logs, about what agents do: the unit and meaning of each column."""

import textwrap
from collections.abc import Iterator, Sequence
from typing import NamedTuple


class Column(NamedTuple):
    """A column: its unit ("" for what is counted) and its meaning."""

    unit: str
    meaning: str


SUMMED = ("kills",)  # over the sides of an episode, where one number is shown; all others with several are averaged

# "Its" refers to the policy of the row, which plays one of two sides, or every other side where there are more.
COLUMNS = {
    "wins": Column("share", "of episodes that it wins, as one of its sides outlives all others; a draw counts half"),
    "wins_first": Column("share", "the same, of the episodes in which it plays the first side"),
    "wins_second": Column("share", "the same, of those in which its opponent plays the first side"),
    "length": Column("ticks", "of an episode; the same for both"),
    "life": Column("ticks", "to whose end its longest-lived side has a living member"),
    "return": Column(
        "reward",
        "of one of its agents in an episode; the mean over its agents. Alone it does not say who is better: a long game"
        " rewards both sides",
    ),
    "kills": Column("", "by its sides in an episode"),
    "deaths_TYPE": Column("", "of its agents in an episode by that type of damage: melee, zone"),
    "first_death": Column("ticks", "until the first agent dies, of episodes in which one does; the same for both"),
    "heals_used": Column("", "by all agents in an episode; the same for both"),
    "boxes_placed": Column("", "by all agents in an episode; the same for both"),
    "heals_given": Column("", "from its agents to others in an episode; in logs, in 1000 agent-steps"),
    "heals_held": Column("", "in the bag of one of its living agents, a mean over ticks"),
    "zone_distance": Column("m", "from its living agents to the centre of the safe zone, a mean over ticks"),
    "near": Column(
        "share",
        "of ticks of its living agents in which an enemy could be struck: its centre is within"
        " melee_reach + its agents_radius",
    ),
    "attack_near": Column("share", "of those ticks in which the agent attacks"),
    "attack_far": Column("share", "of its other ticks in which the agent attacks, with nobody to strike"),
}


def combinable(tags: Sequence[str]) -> Sequence[str]:
    """Choose, from the tags that a log has of one statistic, those to combine into one number.

    Where episodes differ in their sides, means of sides are over different episodes and cannot be added up. Then the
    value of all sides together is logged, too, under the tag without a number; in that case only this one counts.
    """
    return [tag for tag in tags if f"{tag}0" in tags] or tags


def explained(width: int = 100) -> Iterator[str]:
    """Yield one or more lines of help for each column."""
    indent = max(map(len, COLUMNS)) + 4
    for name, (unit, meaning) in COLUMNS.items():
        text = f"{unit} {meaning}".strip()
        first = f"  {name}".ljust(indent)
        yield textwrap.fill(text, width, initial_indent=first, subsequent_indent=" " * indent)
    yield "  others: statistics of the scenario's mechanics in an episode: of agents, the mean over its agents; of"
    yield "  sides, the sum over its sides; of the world, the same for both"

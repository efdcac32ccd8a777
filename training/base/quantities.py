"""Columns of evaluations and training logs, with unit and meaning; and the main figures of a running training."""

import math
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from outlast.envs.progress import large

SUMMED = ("kills",)  # over the sides of an episode, where one number is shown; all others with several are averaged

# The unit ("" for counts) and meaning of each column. "Its" refers to the policy of the row, which plays one of two
# sides, or every other side where there are more.
COLUMNS = {
    "wins": (
        "share",
        "of the episodes that it wins: one of its sides outlives all others, or the game names it the winner; a draw "
        "counts half",
    ),
    "wins_first": (
        "share",
        "that it wins of the episodes in which it plays the first side. As agents see their id, a policy may play "
        "sides differently that are alike, also against itself",
    ),
    "wins_second": ("share", "that it wins of the episodes in which its opponent plays the first side"),
    "length": ("ticks", "of an episode; the same for both policies"),
    "life": ("ticks", "that its longest-lived side has a living agent"),
    "return": (
        "reward",
        "that one of its agents gets in an episode, on average over its agents. Alone it does not show which policy is "
        "better: a long game rewards both sides",
    ),
    "kills": ("", "kills by its sides in an episode"),
    "deaths_TYPE": ("", "deaths of its agents in an episode by that type of damage: melee, zone"),
    "first_death": ("ticks", "until the first agent dies, in episodes in which one does; the same for both policies"),
    "heals_used": ("", "heals that all agents use in an episode; the same for both policies"),
    "boxes_placed": ("", "boxes that all agents set up in an episode; the same for both policies"),
    "heals_given": ("", "heals that its agents give to others in an episode; in logs, in 1000 agent-steps"),
    "heals_held": ("", "heals in the bag of one of its living agents, on average over ticks"),
    "zone_distance": ("m", "from its living agents to the centre of the safe zone, on average over ticks"),
    "near": (
        "share",
        "of the ticks of its living agents in which they could strike an enemy: its centre is within melee_reach + its "
        "agents_radius",
    ),
    "attack_near": ("share", "of those ticks in which the agent attacks"),
    "attack_far": ("share", "of the other ticks in which the agent attacks, without an enemy to strike"),
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


@dataclass(frozen=True)
class Figure:
    """One of the main figures."""

    group: str  # its subject, one of GROUPS
    name: str  # unique in its group
    value: float
    text: str  # the displayed number


def _rate(value: float) -> str:
    return f"{large(value)}/s"


def _fixed(digits: int) -> Callable[[float], str]:
    return lambda value: f"{value:,.{digits}f}"


def _mean(values: Iterable[float]) -> float:
    each = list(values)
    return sum(each) / len(each)


# Group, name, pattern of the tags (there may be one for each side or agent), the function that combines their values,
# and the format of the result.
_FIGURES: tuple[tuple[str, str, str, Callable[[Iterable[float]], float], Callable[[float], str]], ...] = (
    ("speed", "collecting", r"time/collected_per_second", _mean, _rate),
    ("speed", "updating", r"time/updated_per_second", _mean, _rate),
    ("episodes", "length", r"rollout/steps", _mean, _fixed(0)),
    ("episodes", "return", r"rollout/reward\d+", _mean, _fixed(1)),
    ("episodes", "kills", r"rollout/kills\d*", sum, _fixed(2)),
    ("episodes", "heals used", r"rollout/heals_used", _mean, _fixed(2)),
    ("learning", "epochs", r"train/epochs", _mean, _fixed(1)),
    ("learning", "KL", r"train/approx_kl", _mean, _fixed(4)),
    ("learning", "entropy", r"train/entropy", _mean, _fixed(2)),
    ("learning", "learning rate", r"train/learning_rate", _mean, "{:.1e}".format),
)
GROUPS = ("speed", "episodes", "wins", "learning")  # in the order of display
WINS, GAMES, RATING = "wins/", "games/", "rating/"  # by opponent: share of recent games won; games in all; Elo
OWN = "rating/self"
APART = 4  # returns of at most this many sides are shown one by one if they differ


def headline(tags: Mapping[str, float]) -> list[Figure]:
    """Return the figures that have tags, in the order in which to show them, without values that are not finite.

    tags: The last logged values, by tag. Where tags are numbered ("rollout/kills0"), the kills of all sides are added
    up, and returns are averaged; the text of a few sides lists them one by one.
    """
    finite = {tag: value for tag, value in tags.items() if math.isfinite(value)}
    found = []
    for group, name, pattern, combine, text in _FIGURES:
        if values := [finite[tag] for tag in combinable([tag for tag in finite if re.fullmatch(pattern, tag)])]:
            each = list(dict.fromkeys(map(text, values)))
            apart = name == "return" and 1 < len(each) <= len(values) <= APART  # in a zero-sum game, their mean is 0
            shown = " / ".join(map(text, values)) if apart else text(combine(values))
            found.append(Figure(group, name, combine(values), shown))
    for tag, share in finite.items():
        if tag.startswith(WINS):
            name, games = tag.removeprefix(WINS), finite.get(tag.replace(WINS, GAMES, 1))
            rating = finite.get(tag.replace(WINS, RATING, 1))
            notes = [] if games is None else [large(games)]
            notes += [] if rating is None else [f"Elo {rating:.0f}"]
            found.append(Figure("wins", name, share, f"{100 * share:.0f} %" + f" ({', '.join(notes)})" * bool(notes)))
    if OWN in finite:
        found.append(Figure("wins", "own Elo", finite[OWN], f"{finite[OWN]:.0f}"))
    return sorted(found, key=lambda figure: GROUPS.index(figure.group))

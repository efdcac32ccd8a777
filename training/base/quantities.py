"""Columns of evaluations and logs with their meanings, tables of numbers, and the main figures of a run, also live."""

import csv
import io
import itertools
import math
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from outlast.envs.progress import Progress, large

from .statistics import interval

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
GROUPS = ("speed", "episodes", "wins", "learning")  # in the order of display
WINS, GAMES, RATING = "wins/", "games/", "rating/"  # by opponent: share of recent games won; games in all; Elo
OWN = "rating/self"
APART = 4  # returns of at most this many sides are shown one by one if they differ
ENDS = "ends.csv"  # the file of end values, beside a figure
NONE = "–"  # for values that cannot be measured, such as the distance to mates in a game without them
NAME = max(map(len, GROUPS)) + 2  # width of the name of a line, in characters
BETWEEN = " · "  # separator of figures


def combinable(tags: Sequence[str]) -> Sequence[str]:
    """Return the tags of one statistic that are combined: only that of all sides, if episodes differ in their sides."""
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


def _mean(values: Iterable[float]) -> float:
    each = list(values)
    return sum(each) / len(each)


# Group, name, pattern of the tags (there may be one for each side or agent), the function that combines their values,
# and the format of the result.
_FIGURES: tuple[tuple[str, str, str, Callable[[Iterable[float]], float], Callable[[float], str]], ...] = (
    ("speed", "collecting", r"time/collected_per_second", _mean, lambda value: f"{large(value)}/s"),
    ("speed", "updating", r"time/updated_per_second", _mean, lambda value: f"{large(value)}/s"),
    ("episodes", "length", r"rollout/steps", _mean, "{:,.0f}".format),
    ("episodes", "return", r"rollout/reward\d+", _mean, "{:,.1f}".format),
    ("episodes", "kills", r"rollout/kills\d*", sum, "{:,.2f}".format),
    ("episodes", "heals used", r"rollout/heals_used", _mean, "{:,.2f}".format),
    ("learning", "epochs", r"train/epochs", _mean, "{:,.1f}".format),
    ("learning", "KL", r"train/approx_kl", _mean, "{:,.4f}".format),
    ("learning", "entropy", r"train/entropy", _mean, "{:,.2f}".format),
    ("learning", "learning rate", r"train/learning_rate", _mean, "{:.1e}".format),
)


def headline(tags: Mapping[str, float]) -> list[Figure]:
    """Return the finite figures that have tags, in the order in which to show them.

    tags: The last logged values, by tag. Where tags are numbered ("rollout/kills0"), kills of sides are added up, and
    returns are averaged; the text of a few sides lists them one by one.
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


def number(value: float) -> str:
    """Format a number with its meaningful digits."""
    return f"{value:,.{decimals(value)}f}"


def digits(value: float) -> str:
    """Format a number with six significant digits, for a file; "" for NaN."""
    return "" if math.isnan(value) else f"{value:.6g}"


def spread(values: Sequence[float]) -> str:
    """Format the 95 % bootstrap interval of a mean over runs; "" for a single run."""
    ends = interval(values)
    return "" if ends is None else f"{number(ends[0])} to {number(ends[1])}"


def with_spread(values: Sequence[float]) -> str:
    """Return the mean over runs, and its interval: "653 (594 to 713)"."""
    mean, ends = number(sum(values) / len(values)), spread(values)
    return f"{mean} ({ends})" if ends else mean


def with_error(mean: float, error: float) -> str:
    """Write a mean and its standard error, to the error's second digit: "0.512 ± 0.025"."""
    if math.isnan(mean):
        return "-"
    if math.isnan(error):  # it was measured in one episode only
        return f"{mean:.2f} ± -"
    if not error:  # all episodes were alike
        return f"{mean:.2f}"
    digits = min(max(1 - math.floor(math.log10(error)), 0), 4)
    return f"{mean:.{digits}f} ± {error:.{digits}f}"


def pivot(rows: Sequence[Sequence[str]], down: int, across: int) -> tuple[list[str], list[list[str]]]:
    """Return heads and lines of a table, by two cells of each row; its last two are a mean and its error."""
    names, heads = (list(dict.fromkeys(row[k] for row in rows)) for k in (down, across))
    heads = names if {*names} == {*heads} else heads
    cells = {(row[down], row[across]): with_error(*(float(cell or "nan") for cell in row[-2:])) for row in rows}
    return heads, [[name, *(cells.get((name, head), "") for head in heads)] for name in names]


def decimals(value: float) -> int:
    """Return the number of digits after the decimal point."""
    return sum(abs(value) < bound for bound in (100, 10, 1))


def markdown_table(heads: Sequence[str], lines: Iterable[list[str]]) -> str:
    """Write a table in Markdown, with numbers aligned right and without empty columns."""
    table = list(lines)
    kept = [k for k in range(len(heads)) if k == 0 or any(line[k] for line in table)]
    every = [list(heads), ["---", *["---:"] * (len(heads) - 1)], *table]
    return "\n".join("| " + " | ".join(line[k].replace("|", r"\|") for k in kept) + " |" for line in every)


def csv_text(heads: Iterable[Any], rows: Iterable[Iterable[Any]]) -> str:
    """Write a table as CSV, with a line feed after each row."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([heads, *rows])
    return text.getvalue()


class LiveView(Progress):
    """The progress of a run with its figures, in a line for each group of them, shortened to the terminal's width.

    >>> view = LiveView(done=0, total=10_000_000)
    >>> view.now("collecting")
    >>> view.update(16_384, 10_000_000, {"rollout/steps": 812.0, "wins/scripted": 0.12})
    >>> view.close()
    """

    def __init__(self, done: int, total: int, *, unit: str = "agent-steps", **options: Any) -> None:
        """Show the beginning of the run, with `done` of `total` agent-steps, or of another unit; see Progress."""
        self.tags = dict[str, float]()
        super().__init__(total, unit, done=done, **options)

    def update(self, done: int, total: int, shown: Mapping[str, float]) -> None:
        """Show the progress of the run, and its numbers by tag; those that are missing keep their values."""
        self.tags |= shown
        self.show(done, total)
        if self.bar is not None:
            self.bar.refresh()

    def below(self, columns: int) -> list[str]:
        """Return the line of each group of figures, of at most `columns` characters."""
        lines = list[str]()
        for name, figures in self._groups():
            text = name.ljust(NAME)
            for k, figure in enumerate(figures):
                more = f"{BETWEEN if k else ''}{figure.name} {figure.text}"
                if k and len(text) + len(more) > columns:
                    break
                text += more
            lines.append(text[: max(0, columns)])
        return lines

    def beside(self) -> list[str]:
        """Return the figures of each group, for the line of a log."""
        return [f"{name}: {', '.join(f'{each.name} {each.text}' for each in own)}" for name, own in self._groups()]

    def _groups(self) -> list[tuple[str, list[Figure]]]:
        return [(name, [*own]) for name, own in itertools.groupby(headline(self.tags), lambda figure: figure.group)]

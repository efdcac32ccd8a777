"""The few numbers of a run to look at while it goes on, from the tags of its log. Needs no PyTorch."""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from outlast.envs.progress import large

from .quantities import combinable


@dataclass(frozen=True)
class Figure:
    """A number to look at.

    group: What it is about, one of GROUPS. name: Its name, unique in its group. text: The number as it is shown.
    """

    group: str
    name: str
    value: float
    text: str


def _rate(value: float) -> str:
    return f"{large(value)}/s"


def _fixed(digits: int) -> Callable[[float], str]:
    return lambda value: f"{value:,.{digits}f}"


def _mean(values: Iterable[float]) -> float:
    each = list(values)
    return sum(each) / len(each)


# Group, name, pattern of the tags (there may be one for each side or agent), how their values become one number, and
# how that is written.
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
GROUPS = ("speed", "episodes", "wins", "learning")  # in the order in which they are shown
WINS, GAMES, RATING = "wins/", "games/", "rating/"  # by opponent: share of recent games won; games in all; Elo
OWN = "rating/self"
APART = 4  # returns of so many sides are shown side by side where they differ


def headline(tags: Mapping[str, float]) -> list[Figure]:
    """Return the figures that have tags, in the order in which to show them, without those that are not finite.

    tags: What was logged last, by tag. Where tags are numbered ("rollout/kills0"), the kills of all sides are added up,
    and returns are averaged; as text, those of a few sides stand side by side.
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

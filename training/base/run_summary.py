"""The main figures of a running training, from the tags of its log. Does not need PyTorch."""

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from outlast.envs.progress import large

from .quantities import combinable


@dataclass(frozen=True)
class Figure:
    """One of the main figures.

    group: Its subject, one of GROUPS. name: Its name, unique in its group. text: The displayed number.
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

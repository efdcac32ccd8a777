"""Verification: every match is played again from its recording, bit for bit, and compared with what the result says."""

import math
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from outlast.envs.errors import RecordingError, UsageError

from ..errors import TrainingError
from ..evaluation.contenders import Contender
from . import crossplay
from .described import described, wrong_with_response
from .matches import ROUNDING, digest, repeat
from .result import BEST, POLICY, RESPONSE, SELF, Content, Result
from .suite import Member, missing, other_games, suite
from .tasks import Game, Task, task_of

NEAR = 1e-4  # relative: figures that differ by less are the same, as machines round sums differently


@dataclass(frozen=True)
class Finding:
    """What was found out about a match, or about an entry as a whole.

    Attributes:
        what: "ffa_2-v1 fast/0, trained against scripted".
        wrong: What is not as the result says; empty if nothing is.
        missing: What is not here, so that not all could be verified; empty if everything is.
    """

    what: str
    wrong: str = ""
    missing: str = ""

    def __str__(self) -> str:
        return f"{self.what}: {self.wrong or self.missing or 'as recorded'}"


Check = Callable[[], Finding]  # can be pickled


def checks(entry: Result) -> list[Check]:
    """The checks of an entry, each with one finding: game and policies, which are compared at once, and matches."""
    content, name = entry.content, f"{entry.content['task']} {entry.name}"
    try:
        task = task_of(content["task"])
        members = {member.name: member for member in suite(task)}
        own = _wrong_with_entry(entry, task), _missing_of_entry(entry, task, members)
    except TrainingError as error:
        return [partial(Finding, name, str(error))]
    found: list[Check] = [partial(Finding, name, *own)]
    for match in entry.matches:
        what = f"{name}, {match['game']} against {match['against']}"
        found.append(partial(_of_match, what, entry.recording(match), _wrong_with_match, entry, match, task, members))
    return found


def cross_checks(folder: Path, entries: Mapping[str, Result], chosen: Container[str]) -> list[Check]:
    """The checks of a task's cross-play.

    Args:
        folder: Of the task.
        entries: All entries of the task, by name.
        chosen: Names of entries, whose matches are checked.
    """
    found: list[Check] = []
    try:
        task = task_of(folder.name)
    except TrainingError:  # the checks of the entries say so
        return found
    for (one, other), match in crossplay.load(folder).items():
        what, path = f"{folder.name} {one} against {other}", crossplay.recording(folder, match)
        if one not in chosen and other not in chosen:
            continue
        if gone := [name for name in (one, other) if name not in entries]:
            found.append(partial(Finding, what, missing=f"the entry {gone[0]} is not here"))
        else:
            pair = entries[one], entries[other]
            found.append(partial(_of_match, what, path, _wrong_with_cross, task, match, path, *pair))
    return found


def _of_match(what: str, recording: Path, wrong: Callable[..., str], *arguments: Any) -> Finding:
    if not recording.exists():
        return Finding(what, missing="its recording is not here")
    try:
        return Finding(what, wrong(*arguments))
    except (RecordingError, UsageError) as error:
        return Finding(what, str(error))


def _missing_of_entry(entry: Result, task: Task, members: Iterable[str]) -> str:
    """What an entry lacks, so that not all of it can be verified; empty if it lacks nothing."""
    if not (entry.folder / POLICY).exists():
        return f"{POLICY} is not here, and is not asked what it would do"
    absent = missing(entry, task, members)
    return f"it has not played {absent[0][1]} in the game '{absent[0][0]}'" if absent else ""


def _wrong_with_entry(entry: Result, task: Task) -> str:
    """What is wrong with the games and the policies of an entry; empty if nothing is."""
    content = entry.content
    if other := other_games(content, task):
        return other
    for key, name in (("policy", POLICY), ("response", RESPONSE)):
        path, given = entry.folder / name, content[key]
        if not path.exists():
            continue
        if given is None or digest(path) != given["digest"]:
            return f"{name} is another file than the one that was tested"
        for what, found in described(path, task).items():
            if given[what] != found:
                return f"{what} of {name} is {given[what]} in the result, and {found} by the file"
        if name == RESPONSE and (wrong := wrong_with_response(path, task, content["seed"], content["budget"])):
            return wrong
    return ""


def _wrong_with_match(entry: Result, match: Content, task: Task, members: Mapping[str, Member]) -> str:
    game = next((game for game in task.games if game.name == match["game"]), None)
    if game is None:
        return f"{task.name} has no game '{match['game']}'"
    own, against = _saved(entry.folder / POLICY), match["against"]
    if against == SELF:
        return _wrong_with_games(game, [own], match, entry.recording(match))
    if against == BEST:
        known, other = (entry.content["response"] or {}).get("digest"), _saved(entry.folder / RESPONSE)
    elif against in members:
        known, other = members[against].digest, members[against].contender()
    else:
        return f"there is no {against} in the suite of {task.name}"
    if match["opponent"] != known:
        return f"it was played against another {against} than that of the suite, or of the entry"
    return _wrong_with_games(game, [own, other], match, entry.recording(match))


def _wrong_with_cross(task: Task, match: Content, path: Path, one: Result, other: Result) -> str:
    if not crossplay.is_of(match, one, other):
        return "it was played by other policies than those of the entries"
    pair = [_saved(entry.folder / POLICY) for entry in (one, other)]
    return _wrong_with_games(task.games[0], pair, match, path)


def _saved(path: Path) -> Contender | None:
    """The policy in a file, whose digest has been compared; None if there is no file, as for a function."""
    return Contender(path.stem, str(path)) if path.exists() else None


def _wrong_with_games(game: Game, pair: list[Contender | None], match: Content, path: Path) -> str:
    """Where the recording of a match contradicts the result; empty if it does not."""
    if digest(path) != match["recording"]:
        return "its recording is another file than the one that was made"
    found = repeat(game, pair, match["games"], path)
    for key in ("games", "won", "drawn", "lost"):
        if found.outcome[key] != match[key]:
            return f"{key} is {match[key]} in the result, and {found.outcome[key]} in the recording"
    for figures, recorded in zip(match["figures"], found.outcome["figures"], strict=True):
        for name in sorted(figures.keys() | recorded.keys()):
            one, two = figures.get(name, (math.nan,)), recorded.get(name, (math.nan,))
            if not _follows(one, two):
                return f"{name} is {one[0]:g} in the result, and {two[0]:g} in the recording"
    for policy, share in zip(pair, found.others, strict=True):
        if policy is not None and share > ROUNDING:
            return f"{policy.text} did not play it: it chooses other actions in {100 * share:.3g} % of its ticks"
    return ""


def _follows(given: Sequence[float], found: Sequence[float]) -> bool:
    """Whether a mean, and its error if there is one, are those of a recording.

    Earlier results counted all episodes in errors, even those without a value. These errors are smaller, by a factor of
    the root of a half at most.
    """
    if len(given) != len(found) or not _near(given[0], found[0]):
        return False
    return all(_near(one, two) or math.sqrt(0.5) * two <= one <= two for one, two in zip(given[1:], found[1:]))


def _near(one: float, two: float) -> bool:
    return math.isclose(one, two, rel_tol=NEAR, abs_tol=1e-9)

"""Verification: every match is played again from its recording, bit for bit, and compared with the result."""

import json
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

from outlast.envs.errors import RecordingError, UsageError

from ..arena.players import Contender
from ..base.errors import TrainingError
from ..base.processes import results
from . import crossplay, scores
from .games import repeat
from .kept import SHORT, find
from .matches import digest
from .policy_facts import described, wrong_with_response
from .result import BEST, RESPONSE, SELF, Content, Result, read_json
from .suite import SuiteOpponent, missing, other_games, suite
from .tasks import Task, TaskGame, task_of

NEAR = 1e-4  # relative: smaller differences are equal, since machines round sums differently
# Share of a saved policy's actions that may differ where another machine rounds otherwise, beside a few. For the
# policies of matches.ROUNDING it is at most 1.3e-6; a search for actions to alter finds 5e-5.
SHARE, FEW = 5e-6, 3


@dataclass(frozen=True)
class Verification:
    """A finding about a match, an entry or a cross-play.

    Attributes:
        what: "ffa_2-v1 fast/0, trained against scripted".
        wrong: Contradiction with the result; empty if it has none.
        missing: Parts that could not be verified, since files are missing; empty if all were.
        differing: Number of actions within rounding of the choices of saved policies.
        drawn: Number of actions that saved policies chose.
    """

    what: str
    wrong: str = ""
    missing: str = ""
    differing: int = 0
    drawn: int = 0

    def __str__(self) -> str:
        text = f"{self.what}: {self.wrong or self.missing or 'as recorded'}"
        if not self.drawn:
            return text
        share = f" ({self.differing / self.drawn:.1e})" if self.differing else ""
        return f"{text}; {self.differing:,} of {self.drawn:,} actions differ by rounding{share}"

    def of(self, matches: Sequence["Verification"]) -> "Verification":
        """Return the joint finding of these matches; more actions may differ in them than rounding explains."""
        differing, drawn = (sum(getattr(match, name) for match in matches) for name in ("differing", "drawn"))
        wrong, missing = (sum(bool(getattr(match, name)) for match in matches) for name in ("wrong", "missing"))
        rest = "more of its actions differ than rounding explains" if differing > FEW + SHARE * drawn else ""
        return Verification(
            self.what,
            self.wrong or (f"of {len(matches)} matches, {wrong} are wrong" if wrong else rest),
            self.missing or (f"of {len(matches)} matches, {missing} are not verified" if missing else ""),
            differing,
            drawn,
        )


Check = Callable[[], Verification]  # can be pickled


def verify(place: Path, at_once: int = 1) -> Iterator[Verification]:
    """Verify all results in a folder, and yield the findings: of matches and then of their entries and tasks.

    place: A folder of results, or a folder in it, such as that of an entry. at_once: Number of processes. Raises
    TrainingError: it has no results, or they cannot be read.
    """
    plans: list[list[Check]] = []
    for own in scores.by_budget(place).values():
        for folder, entries in scores.task_folders(own).items():
            plans += [checks(entry) for entry in entries]
            plans.append(cross_checks(folder, find(folder), [entry.name for entry in entries]))
    found = results([check for plan in plans for check in plan], at_once)
    for plan in filter(None, plans):
        first, matches = next(found), []
        for match in islice(found, len(plan) - 1):
            matches.append(match)
            yield match
        yield first.of(matches)
    if (place / scores.NAME).exists():
        yield _of_scores(place)


def _of_scores(place: Path) -> Verification:
    """Compare the scores beside the results with those that follow from the results."""
    what = str(place / scores.NAME)
    try:
        same = json.loads(json.dumps(scores.scores(place))) == read_json(place / scores.NAME, lambda content: "")
    except TrainingError as error:
        return Verification(what, missing=str(error))
    return Verification(what, "" if same else "the results have other scores: run `outlast benchmark score` again")


def checks(entry: Result) -> list[Check]:
    """Return the checks of an entry, each with one finding: games and policies first, then matches."""
    content, name = entry.content, f"{entry.content['task']} {entry.name}"
    try:
        task = task_of(content["task"])
        members = {member.name: member for member in suite(task)}
        own = _wrong_with_entry(entry, task), _missing_of_entry(entry, task, members)
    except TrainingError as error:
        return [partial(Verification, name, str(error))]
    found: list[Check] = [partial(Verification, name, *own)]
    for match in entry.matches:
        what = f"{name}, {match['game']} against {match['against']}"
        found.append(partial(_of_match, what, entry.recording(match), _of_entry, entry, match, task, members))
    return found


def cross_checks(folder: Path, entries: Sequence[Result], chosen: Collection[str]) -> list[Check]:
    """Return the checks of a task's cross-play, each with one finding: first the cross-play, then its matches.

    entries: All entries of the task. chosen: Names of entries, whose matches are checked.
    """
    try:
        task = task_of(folder.name)
    except TrainingError:  # the checks of the entries report it
        return []
    by_name = {entry.name: entry for entry in entries}
    pairs = [(one.name, other.name) for one, other in crossplay.pairs(entries)]
    known, found, absent = crossplay.load(folder), list[Check](), ""
    wanted = [pair for pair in dict.fromkeys([*known, *pairs]) if not {*pair}.isdisjoint(chosen)]
    for one, other in wanted:
        if (match := known.get((one, other))) is None:
            absent = f"{one} has not played against {other}: run `outlast benchmark score`"
            continue
        what, path = f"{folder.name} {one} against {other}", crossplay.recording(folder, match)
        if gone := [name for name in (one, other) if name not in by_name]:
            found.append(partial(Verification, what, missing=f"the entry {gone[0]} is not here"))
        else:
            found.append(partial(_of_match, what, path, _of_cross, task, match, path, by_name[one], by_name[other]))
    all_of_it = partial(Verification, f"{folder.name}, cross-play", missing=absent)
    return [all_of_it, *found] if wanted else []


def _of_match(what: str, recording: Path, judge: Callable[..., Verification], *arguments: Any) -> Verification:
    """Return the finding about a match. judge: Returns it without `what`."""
    if not recording.exists():
        return Verification(what, missing="its recording is not here")
    try:
        return replace(judge(*arguments), what=what)
    except (RecordingError, UsageError) as error:
        return Verification(what, str(error))


def _missing_of_entry(entry: Result, task: Task, members: Iterable[str]) -> str:
    """Return the parts of an entry that are missing for its verification; empty if it is complete."""
    if not entry.policy.exists():
        return f"{entry.policy.name} is missing, so its choices were not compared"
    absent = missing(entry, task, members)
    return f"it has not played {absent[0][1]} in the game '{absent[0][0]}'" if absent else ""


def _wrong_with_entry(entry: Result, task: Task) -> str:
    """Return the fault in the games and the policies of an entry; empty if they are valid."""
    content = entry.content
    if other := other_games(content, task):
        return other
    for key, path in (("policy", entry.policy), ("response", entry.folder / RESPONSE)):
        given, name = content[key], path.name
        if not path.exists():
            continue
        if given is None or digest(path) != given["digest"]:
            return f"{name} is not the file that was tested"
        for what, found in described(path, task).items():
            if given[what] != found:
                return f"{what} of {name} is {given[what]} in the result, but {found} in the file"
        if key == "response" and (wrong := wrong_with_response(path, task, content["seed"], content["budget"])):
            return wrong
    return ""


def _of_entry(entry: Result, match: Content, task: Task, members: Mapping[str, SuiteOpponent]) -> Verification:
    game = next((game for game in task.games if game.name == match["game"]), None)
    if game is None:
        return Verification("", f"{task.name} has no game '{match['game']}'")
    own, against = _saved(entry.policy), match["against"]
    if against == SELF:
        return _of_games(game, [own], match, entry.recording(match))
    if against == BEST:
        known, other = (entry.content["response"] or {}).get("digest"), _saved(entry.folder / RESPONSE)
    elif against in members:
        known, other = members[against].digest, members[against].contender()
    else:
        return Verification("", f"the suite of {task.name} has no member {against}")
    if match["opponent"] != known:
        return Verification("", f"its opponent {against} is not the one of the suite or of the entry")
    return _of_games(game, [own, other], match, entry.recording(match))


def _of_cross(task: Task, match: Content, path: Path, one: Result, other: Result) -> Verification:
    if not crossplay.is_of(match, one, other):
        return Verification("", "it was not played by the policies of the entries")
    pair = [_saved(entry.policy) for entry in (one, other)]
    return _of_games(task.games[0], pair, match, path)


def _saved(path: Path) -> Contender | None:
    """Return the policy in a file, whose digest has been compared; None without a file, as for a function."""
    return Contender(path.stem, str(path)) if path.exists() else None


def _of_games(game: TaskGame, pair: list[Contender | None], match: Content, path: Path) -> Verification:
    """Compare a match with its recording."""
    if digest(path) != match["recording"]:
        return Verification("", "its recording is not the file that was made")
    missing = "a policy that played it is missing, so its choices were not compared" if None in pair else ""
    if missing and path.suffix == SHORT:
        return Verification("", missing=missing)
    found = repeat(game, pair, match["games"], path)
    return Verification("", _wrong_with_outcome(match, found.outcome), missing, found.differing, found.drawn)


def _wrong_with_outcome(match: Content, outcome: Content) -> str:
    """Return the contradiction between the recording of a match and the result; empty without one."""
    for key in ("games", "won", "drawn", "lost"):
        if outcome[key] != match[key]:
            return f"{key} is {match[key]} in the result, but {outcome[key]} in the recording"
    for figures, recorded in zip(match["figures"], outcome["figures"], strict=True):
        for name in sorted(figures.keys() | recorded.keys()):
            one, two = figures.get(name, (math.nan,)), recorded.get(name, (math.nan,))
            if not _follows(one, two):
                return f"{name} is {one[0]:g} in the result, but {two[0]:g} in the recording"
    return ""


def _follows(given: Sequence[float], found: Sequence[float]) -> bool:
    """Return whether a mean, and its error if there is one, agree with a recording."""
    each = zip(given, found, strict=False)
    return len(given) == len(found) and all(math.isclose(*pair, rel_tol=NEAR, abs_tol=1e-9) for pair in each)

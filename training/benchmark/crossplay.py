"""Cross-play: matches between all entries of a task, those of different agents and different seeds of one agent."""

import itertools
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from outlast.envs.scenarios.fingerprint import is_word

from ..arena.players import Contender
from ..base.errors import TrainingError
from ..base.processes import results
from . import kept, result
from .agents import Agent
from .matches import digest, play
from .result import DIGEST, Content, Result, match_twice, read_json, write_json, wrong_with_match
from .tasks import PROTOCOL, Task, task_of

NAME = "cross.json"


def contender(entry: Result) -> Contender:
    """Return the policy of an entry. Raises TrainingError if its file is missing, or is not the tested one."""
    content, path = entry.content, entry.policy
    made = None
    if not path.exists() and content["source"].rpartition(":")[0].endswith(".py"):
        made = Agent(entry.name, content["source"]).made(content["task"], content["seed"])
        path = made.file
    if not path.exists():
        raise TrainingError(f"{path} is missing, but {entry.name} needs it: put it back, or run the entry again")
    if content["policy"] is None or digest(path) != content["policy"]["digest"]:
        raise TrainingError(f"{path} is not the policy in {entry.folder / result.NAME}")
    return made or Contender(entry.name, str(path))


def load(folder: Path) -> dict[tuple[str, str], Content]:
    """Read the played matches, by names of entries. folder: Folder of the task. Raises TrainingError."""
    path = folder / NAME
    content = read_json(path, _wrong) if path.exists() else {"matches": []}
    return kept.cross_play(folder) | {(match["one"], match["other"]): match for match in content["matches"]}


def pairs(entries: Sequence[Result]) -> list[tuple[Result, Result]]:
    """Return all pairs of entries of a task."""
    in_order = sorted(entries, key=lambda entry: (entry.content["agent"], entry.content["seed"]))
    return list(itertools.combinations(in_order, 2))


def recording(folder: Path, match: Content) -> Path:
    """Return the file in which a match is recorded."""
    return folder / "cross" / result.recording_name(match["one"], match["other"])


def play_all(
    folder: Path, entries: Sequence[Result], progress: Callable[[int], None] = lambda games: None, at_once: int = 1
) -> None:
    """Play the matches that are missing, or were played by other policies.

    folder: Folder of the task, with its results of one budget. entries: All entries in it. progress: Called with the
    number of further games done. at_once: Number of processes. Raises TrainingError: a policy is missing.
    """
    known, missing = load(folder), []
    for one, other in pairs(entries):
        match = known.get((one.name, other.name))
        if match is None or not is_of(match, one, other):
            missing.append((one, other))
        else:
            progress(match["games"])
    jobs = [partial(_play, task_of(one.content["task"]), one, other, folder) for one, other in missing]
    for match in results(jobs, at_once):
        known[match["one"], match["other"]] = match
        write_json(folder / NAME, {"version": PROTOCOL, "matches": [known[key] for key in sorted(known)]})
        progress(match["games"])


def is_of(match: Content, one: Result, other: Result) -> bool:
    """Return whether a match was played by the present policies of these entries."""
    digests = [entry.content["policy"]["digest"] for entry in (one, other)]
    return [match["own"], match["opponent"], match["games"]] == [*digests, one.content["games"]]


def _play(task: Task, one: Result, other: Result, folder: Path) -> Content:
    names = {"one": one.name, "other": other.name}
    digests = {"own": one.content["policy"]["digest"], "opponent": other.content["policy"]["digest"]}
    path = recording(folder, names)
    path.parent.mkdir(exist_ok=True)
    return names | digests | play(task.games[0], [contender(one), contender(other)], one.content["games"], path)


def _wrong(content: Content) -> str:
    """Return the fault in the content of a file of cross-play; empty if it is valid."""
    if content["version"] != PROTOCOL:
        return f"version {content['version']!r:.20}: must be {PROTOCOL}"
    for match in content["matches"]:
        if fault := wrong_with_match(match, ("one", "other")):
            return fault
        if not is_word(match["own"]) or DIGEST.fullmatch(match["own"]) is None:
            return "invalid digests"
    return match_twice(content["matches"], ("one", "other"))

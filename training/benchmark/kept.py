"""Kept results: entries.json.xz, which holds the numbers of many entries; tables made from it have the same bytes.

Each match has its numbers of games won, drawn and lost; an entry's games against itself have all figures. Games and
opponents are described once for each task. Does not need PyTorch.
"""

import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from ..base.errors import TrainingError
from ..base.files import packed, write_files
from . import result
from .result import BEST, POLICY, SELF, Content, Result, read, read_json, wrong_with_match, wrong_with_result
from .tasks import PROTOCOL

NAME = "entries.json.xz"
TRAINED = "trained"  # the game of training
SAME = ("task", "agent", "seed", "budget", "games", "source", "options", "policy", "response", "seconds", "made")
NUMBERS = ("won", "drawn", "lost")
NOTHING = "0" * 64  # the digest of a recording that was not kept
GAMES, SHORT = "games", ".npz"  # the folder and the ending of matches that can be verified, see `games`
Cross = dict[str, list[list[Any]]]  # by "BUDGET/TASK": one, other, and the games that `one` won, drew and lost


class KeptResult(Result):
    """A result in the file of kept ones. Its folder need not exist: its parts name the entry."""

    @property
    def place(self) -> Path:
        """The folder of the file."""
        return self.folder.parents[3]

    @property
    def policy(self) -> Path:
        """The file of its policy, which may not be kept."""
        own = (self.content["policy"] or {}).get("file")
        return self.folder / POLICY if own is None else Path(os.path.normpath(self.place / own))

    def recording(self, match: Content) -> Path:
        """Return the file of a match; only games against itself can have one, see `games`."""
        if (match["game"], match["against"]) != (TRAINED, SELF):
            return super().recording(match)
        budget, task, agent, seed = place_of(self)
        return self.place / GAMES / budget / task / f"{agent}-{seed}{SHORT}"


def place_of(entry: Result) -> tuple[str, str, str, str]:
    """Return the budget, the task, the agent and the seed of an entry, which name its folder."""
    budget, task, agent, seed = entry.folder.resolve().parts[-4:]
    return budget, task, agent, seed


def find(place: Path) -> list[Result]:
    """Return the results in a folder and all folders in it, in order of paths: written by runs, or kept.

    place: The folder; for kept results also a virtual one, such as KEPT/BUDGET/TASK. Raises TrainingError: none are
    found, or one cannot be read.
    """
    files = [*place.rglob(NAME)] or above(place)
    found = {entry.folder.resolve(): entry for file in files for entry in _entries(file.parent)}
    found |= {path.parent.resolve(): read(path) for path in place.rglob(result.NAME)}
    within = [entry for folder, entry in sorted(found.items()) if folder.is_relative_to(place.resolve())]
    if not within:
        names = f"{result.NAME} or {NAME}"
        raise TrainingError(f"{place} and its folders do not hold {names}: make one by `outlast benchmark run`")
    return within


def above(place: Path) -> list[Path]:
    """Return the file of kept results that contains a folder, in a list; [] if none does."""
    return [each / NAME for each in place.resolve().parents if (each / NAME).is_file()][:1]


def cross_play(folder: Path) -> dict[tuple[str, str], Content]:
    """Return the kept matches between entries, see `crossplay.load`. folder: The task's. Raises TrainingError."""
    place = folder.parents[1]
    if not (place / NAME).is_file():
        return {}
    rows = _content(place)["cross"].get(f"{folder.parent.name}/{folder.name}", [])
    own = [entry for entry in _entries(place) if entry.task_folder == folder.resolve()]
    return {(one, other): _cross_match(one, other, numbers, own) for one, other, *numbers in rows}


def write(place: Path, entries: Iterable[Result], cross: Cross) -> None:
    """Write results, completely or not at all; equal results give equal bytes.

    cross: Their matches against each other. Raises TrainingError: the file cannot be written, or two results of a task
    have other games or opponents.
    """
    tasks = dict[str, Content]()
    for entry in entries:
        own = {"fingerprints": entry.content["fingerprints"], "opponents": _opponents(entry)}
        if tasks.setdefault(entry.content["task"], own) != own:
            raise TrainingError(f"{entry.folder} has other games or opponents than other results of its task")
    in_order = sorted(entries, key=lambda entry: [entry.content[key] for key in ("budget", "task", "agent", "seed")])
    content = {"version": PROTOCOL, "tasks": tasks, "entries": [*map(_packed, in_order)], "cross": cross}
    text = json.dumps(content, separators=(",", ":"), allow_nan=False)
    write_files({place / NAME: packed(text)})


def _packed(entry: Result) -> Content:
    """Return an entry without the parts that all entries of its task share, and without most figures."""
    own, matches = entry.against[TRAINED, SELF], dict[str, dict[str, list[int]]]()
    for match in entry.matches:
        matches.setdefault(match["game"], {})[match["against"]] = [match[key] for key in NUMBERS]
    self_play = {"figures": own["figures"], "recording": own["recording"]}
    return {key: entry.content[key] for key in SAME} | {"self": self_play, "matches": matches}


def _opponents(entry: Result) -> dict[str, str]:
    """Return the digests of the members of the suite that an entry has played."""
    return {match["against"]: match["opponent"] for match in entry.matches if match["against"] not in (SELF, BEST)}


def _content(place: Path) -> Content:
    """Return the content of the file in a folder, which `_wrong` has checked."""
    return read_json(place / NAME, _wrong)


def _entries(place: Path) -> list[Result]:
    """Return the results that the file in a folder holds. Raises TrainingError."""
    content = _content(place)
    return [_result(place, entry, content["tasks"][entry["task"]]) for entry in content["entries"]]


def _result(place: Path, packed: Content, of_task: Content) -> Result:
    """Return the result that was given to `_packed`, without figures of other matches."""
    folder = place / str(packed["budget"]) / packed["task"] / packed["agent"] / str(packed["seed"])
    best, own = (packed["response"] or {}).get("digest", ""), packed["self"]
    known, matches = of_task["opponents"] | {SELF: "", BEST: best}, list[Content]()
    for game, played in packed["matches"].items():
        for name, numbers in played.items():
            more = own if (game, name) == (TRAINED, SELF) else {"figures": [{}, {}], "recording": NOTHING}
            matches.append({"game": game, "against": name, "opponent": known[name]} | _outcome(numbers) | more)
    more = {"version": PROTOCOL, "fingerprints": of_task["fingerprints"], "matches": matches}
    return KeptResult(folder, {key: packed[key] for key in SAME} | more)


def _outcome(numbers: Sequence[int]) -> Content:
    """Return the entries of a match for its games won, drawn and lost."""
    return dict(zip(NUMBERS, numbers, strict=True)) | {"games": sum(numbers)}


def _cross_match(one: str, other: str, numbers: Sequence[int], entries: Iterable[Result]) -> Content:
    """Return a match between two entries, as `crossplay` writes it."""
    digests = {entry.name: entry.content["policy"]["digest"] for entry in entries}
    names = {"one": one, "other": other, "own": digests.get(one, NOTHING), "opponent": digests.get(other, NOTHING)}
    return names | _outcome(numbers) | {"figures": [{}, {}], "recording": NOTHING}


def _wrong(content: Content) -> str:
    """Return the fault in the content of the file; "" if it is valid. Raises KeyError or similar for a missing part."""
    if content["version"] != PROTOCOL:
        return f"version {content['version']!r:.20}: must be {PROTOCOL}"
    for entry in content["entries"]:
        if fault := wrong_with_result(_result(Path(), entry, content["tasks"][entry["task"]]).content):
            return f"{entry['task']} {entry['agent']}/{entry['seed']}: {fault}"
    for folder, rows in content["cross"].items():
        for one, other, *numbers in rows:
            if fault := wrong_with_match(_cross_match(one, other, numbers, ()), ("one", "other")):
                return f"{folder}: {fault}"
    return ""

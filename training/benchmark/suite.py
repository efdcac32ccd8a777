"""The held-out suite: opponents that no agent is trained against, the same for everyone, with fixed ratings.

These are scripted styles, and frozen checkpoints: files of this package, which `outlast benchmark anchors` makes. For
each task, there is a file anchors/TASK.json with the ratings of all of them in that task.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from outlast.envs.scenarios.fingerprint import difference, fingerprint, is_fingerprint, is_word

from ..errors import TrainingError
from ..evaluation.contenders import Contender
from .matches import digest
from .result import BEST, DIGEST, SELF, Content, Result, are_finite, read_json
from .tasks import PROTOCOL, Task

STYLES = ("random", "noop", "scripted", "camper", "hunter", "hoarder", "healer")
FOLDER = Path(__file__).parent / "anchors"


@dataclass(frozen=True)
class Member:
    """An opponent of the suite.

    Attributes:
        name: A style, or the name of an anchor.
        file: The file of an anchor; None for a style.
        digest: The digest of the file; empty for a style.
        rating: Its fixed Elo rating in the task; None: it has none yet.
    """

    name: str
    file: Path | None = None
    digest: str = ""
    rating: float | None = None

    def contender(self) -> Contender:
        """The opponent as a policy. Raises TrainingError."""
        return Contender(self.name, self.name if self.file is None else str(self.file))


def suite(task: Task, folder: Path | None = None) -> list[Member]:
    """The suite of a task: styles, then anchors. folder: Of the anchors, if these are not the package's own.

    Raises TrainingError if an anchor's file is not the one that was rated, or it was rated in another game.
    """
    place = (folder or FOLDER) / f"{task.name}.json"
    if not place.exists():
        return [Member(name) for name in STYLES]
    content = read_json(place, _wrong)
    if other := difference(content["fingerprint"], fingerprint(task.games[0].scenario)):
        raise TrainingError(f"{place}: its ratings are of another game {other}")
    found = []
    for entry in content["members"]:
        file = place.parent / entry["file"] if entry["file"] else None
        if file is not None and (not file.exists() or digest(file) != entry["digest"]):
            raise TrainingError(f"{file} is not the policy that was rated, as {place} says: its digest is another one")
        found.append(Member(entry["name"], file, entry["digest"], float(entry["elo"])))
    return found


def missing(entry: Result, task: Task, members: Iterable[str]) -> list[tuple[str, str]]:
    """The games and opponents that an entry has not played: itself, the suite, and the best response to a saved policy.

    members: The names of the suite.
    """
    wanted = [(game.name, name) for game in task.games for name in (SELF, *members)]
    if (entry.content["policy"] or {}).get("steps") is not None:  # of functions it is not known
        wanted.append((task.games[0].name, BEST))
    return [each for each in wanted if each not in entry.against]


def other_games(content: Content, task: Task) -> str:
    """Say which game of a result is not that of its task; empty if all are."""
    for game in task.games:
        if other := difference(content["fingerprints"].get(game.name), fingerprint(game.scenario)):
            return f"its game '{game.name}' is another one than that of {task.name} {other}"
    return ""


def _wrong(content: Content) -> str:
    """What is wrong with the content of a file of anchors; empty if nothing is."""
    if content["version"] != PROTOCOL or not is_fingerprint(content["fingerprint"]):
        return "its version or its game cannot be"
    for entry in content["members"]:
        plain = all(isinstance(entry[key], str) and entry[key].isprintable() for key in ("name", "file", "digest"))
        if not plain or not is_word(entry["name"]) or Path(entry["file"]).name != entry["file"]:
            return f"a member that cannot be: {entry!r:.80}"
        known = bool(entry["file"]) == bool(DIGEST.fullmatch(entry["digest"]))
        if not known or not are_finite((entry["elo"], entry["error"])):
            return f"a rating or a digest that cannot be: {entry!r:.80}"
    return ""

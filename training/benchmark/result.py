"""result.json: an agent with a seed in a task. It is validated, as it may come from others. Needs no PyTorch."""

import json
import math
import platform
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from outlast.ecs.kernels.available import available_cores
from outlast.envs.scenarios.fingerprint import fingerprint, is_fingerprint, is_word
from outlast.envs.storage import strict_json
from outlast.envs.storage.limited_read import read_bytes, read_xz
from outlast.systems import box2d

from ..base.errors import TrainingError
from ..base.files import write_files
from .tasks import PROTOCOL, Task

NAME, POLICY, RESPONSE = "result.json", "policy.safetensors", "response.safetensors"
SELF = "self"  # the opponent in matches against itself
BEST = "response"  # the opponent in matches against the best response
LONGEST = 2**24  # maximum bytes of a JSON file
AGENT = re.compile(r"\w[\w.+-]{0,60}")  # a part of the names of files
DIGEST = re.compile(r"[0-9a-f]{64}")
PACKAGES = ("outlast", "numpy", "numba", "Box2D", "torch")
Content = dict[str, Any]


@dataclass(frozen=True)
class Result:
    """A result in its folder, RESULTS/BUDGET/TASK/AGENT/SEED, together with its policies and recordings.

    folder: The folder of result.json. content: The content of result.json.
    """

    folder: Path
    content: Content

    @property
    def name(self) -> str:
        """The name in messages and tables: "fast/0"."""
        return f"{self.content['agent']}/{self.content['seed']}"

    @property
    def task_folder(self) -> Path:
        """The folder of its task, with the other entries; absolute, as `folder` may be relative."""
        return self.folder.resolve().parents[1]

    @property
    def matches(self) -> list[Content]:
        """The matches that were played."""
        found: list[Content] = self.content["matches"]
        return found

    @property
    def against(self) -> dict[tuple[str, str], Content]:
        """The matches by game and opponent."""
        return {(match["game"], match["against"]): match for match in self.matches}

    @property
    def policy(self) -> Path:
        """The file of its policy; it does not exist for a function."""
        return self.folder / POLICY

    def recording(self, match: Content) -> Path:
        """Return the file in which a match is recorded."""
        return self.folder / recording_name(match["game"], match["against"])

    def write(self) -> None:
        """Write it, completely or not at all. Raises TrainingError."""
        write_json(self.folder / NAME, self.content)


def recording_name(game: str, against: str) -> str:
    """Return the name of the recording of a match, in the folder of a result."""
    return re.sub(r"[^\w.+-]+", "-", f"{game}-{against}") + ".rec"


def begun(task: Task, **entry: Any) -> Content:
    """Return the result of an entry without any work. entry: Agent, source, options, seed, budget and games."""
    games = {game.name: fingerprint(game.scenario) for game in task.games}
    empty: Content = {"policy": None, "response": None, "matches": [], "seconds": {}}
    return {"version": PROTOCOL, "task": task.name, **entry, "fingerprints": games, **empty, "made": made()}


def made() -> Content:
    """Return the origin of a result: versions, and the machine."""
    versions = {name: _version(name) for name in PACKAGES}
    machine = f"{platform.system()} {platform.machine()}"
    return {"python": platform.python_version(), **versions, "machine": machine, "cores": available_cores()}


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file, completely or not at all; equal content gives equal bytes. Raises TrainingError."""
    text = json.dumps(content, indent=1, sort_keys=True, allow_nan=False)
    short = re.sub(r"\[\n\s+([^][{}]{1,80}?)\n\s+\]", lambda found: f"[{' '.join(found[1].split())}]", text)  # [1, 2]
    write_files({path: (short + "\n").encode()})


def read_json(path: Path, wrong: Callable[[Any], str]) -> Content:
    """Read the content of a JSON file.

    path: The file; with the ending .xz, it is compressed. wrong: Returns the fault in the content; "" if valid. Raises
    TrainingError: the file cannot be read, or its content is invalid.
    """
    try:
        content = json.loads((read_xz if path.suffix == ".xz" else read_bytes)(path, LONGEST))
        fault = wrong(content)
    except OSError as error:
        raise TrainingError(f"{path} cannot be read: {error.strerror}") from error
    except strict_json.BROKEN as error:
        fault = f"{type(error).__name__}: {error}"
    if fault:
        raise TrainingError(f"{path} is not a result of the benchmark: {fault:.200}")
    return dict(content)


def read(path: Path) -> Result:
    """Read the result in a file. Raises TrainingError."""
    return Result(path.parent, read_json(path, wrong_with_result))


def wrong_with_result(content: Content) -> str:
    """Return the fault in the content of a result; "" if it is valid. Raises KeyError or similar for a missing part."""
    if content["version"] != PROTOCOL:
        return f"version {content['version']!r:.20}: must be {PROTOCOL}"
    valid: dict[str, Callable[[Any], bool]] = {
        "task": is_word,
        "agent": lambda given: isinstance(given, str) and AGENT.fullmatch(given) is not None,
        "source": is_word,
        "options": lambda given: isinstance(given, dict) and all(map(is_word, given)),
        "seed": _is_count,
        "budget": _is_count,
        "games": _is_count,
        "fingerprints": lambda given: all(map(is_word, given)) and all(map(is_fingerprint, given.values())),
        "policy": _is_policy,
        "response": _is_policy,
        "matches": lambda given: isinstance(given, list) and len(given) < 10_000,
        "seconds": lambda given: all(map(is_word, given)) and are_finite(given.values()),
        "made": lambda given: all(is_word(key) and is_word(str(value)) for key, value in given.items()),
    }
    wrong = [key for key, is_valid in valid.items() if not is_valid(content[key])]
    if wrong:
        return f"its {wrong[0]} cannot be {content[wrong[0]]!r:.80}"
    if content["matches"] and content["policy"] is None:
        return "it has matches, but no policy that played them"
    faults = (
        f"{match['against']!r:.60}: {fault}" for match in content["matches"] if (fault := wrong_with_match(match))
    )
    if fault := next(faults, "") or match_twice(content["matches"], ("game", "against")):
        return fault
    other = [match["games"] for match in content["matches"] if match["games"] != content["games"]]
    return f"a match of {other[0]} games: must be {content['games']}" if other else ""


def match_twice(matches: Iterable[Content], names: tuple[str, str]) -> str:
    """Return the first match that occurs twice; empty if none does. names: The keys that identify matches."""
    seen = set[tuple[str, str]]()
    for match in matches:
        if (key := (match[names[0]], match[names[1]])) in seen:
            return f"the match of {key[0]} and {key[1]} occurs twice"
        seen.add(key)
    return ""


def wrong_with_match(match: Content, names: tuple[str, ...] = ("game", "against")) -> str:
    """Return the fault in a match; empty if it is valid. names: The keys of its names."""
    if not all(is_word(match[name]) for name in names):
        return "invalid names"
    if not all(_is_count(match[name]) for name in ("games", "won", "drawn", "lost")):
        return "invalid numbers of games"
    if match["won"] + match["drawn"] + match["lost"] != match["games"] or not match["games"]:
        return "games won, drawn and lost do not add up to all games"
    if DIGEST.fullmatch(match["recording"]) is None or DIGEST.fullmatch(match["opponent"] or "0" * 64) is None:
        return "invalid digests"
    pairs = [pair for figures in match["figures"] for pair in figures.values()]
    names_of_figures = [name for figures in match["figures"] for name in figures]
    sound = all(isinstance(pair, list) and len(pair) == 2 and are_finite(pair) for pair in pairs)
    if len(match["figures"]) != 2 or not all(map(is_word, names_of_figures)) or not sound:
        return "invalid figures"
    return ""


def _is_policy(given: Any) -> bool:
    if given is None:
        return True
    steps, of_task = given["steps"], given["of_task"]
    trained = isinstance(of_task, bool) and (_is_count(steps) or (steps is None and not of_task))
    named = DIGEST.fullmatch(given["digest"]) is not None and is_word(given.get("file", POLICY))
    return named and trained and all(map(is_word, given["met"]))


def _is_count(given: Any) -> bool:
    return type(given) is int and 0 <= given < 2**63


def are_finite(given: Iterable[Any]) -> bool:
    """Return whether all are finite numbers."""
    return all(type(each) in (int, float) and math.isfinite(each) for each in given)


def _version(package: str) -> str:
    if package == "outlast":
        import outlast  # imported here, since it imports this package

        return outlast.__version__
    if package == "Box2D":
        return box2d.VERSION  # it is in two packages
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"

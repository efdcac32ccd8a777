"""result.json: an agent with a seed in a task. It is validated, as it may come from others. Needs no PyTorch."""

import json
import math
import platform
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, NamedTuple

from outlast.ecs.kernels.available import available_cores
from outlast.envs.scenarios.fingerprint import is_word
from outlast.envs.storage import strict_json
from outlast.envs.storage.limited_read import read_bytes
from outlast.systems import box2d

from ..base import policy_file
from ..base.errors import TrainingError
from ..base.files import write_files
from .tasks import PROTOCOL

NAME = "result.json"
SELF = "self"  # in matches: the agent itself, as its own opponent or team-mate
AGENT = "agent:"  # begins the name of another agent of the manifest, as an opponent
KINDS = ("scratch", "self")  # best responses that begin with random weights, or with those of the agent
LONGEST = 2**24  # maximum bytes of a JSON file
NAMES = re.compile(r"\w[\w.+-]{0,60}")  # of agents: a part of the names of files
DIGEST = re.compile(r"[0-9a-f]{64}")
PACKAGES = ("outlast", "numpy", "numba", "Box2D", "torch")
NUMBERS = ("won", "drawn", "lost")
Content = dict[str, Any]


class Pairing(NamedTuple):
    """The players of a match: the agent, with `mate` in the places of its team-mates, against `against`, in a game.

    candidate: Number of the agent's checkpoint; -1: the one that was chosen.
    """

    game: str
    against: str
    mate: str = SELF
    candidate: int = -1

    @classmethod
    def of(cls, match: Content) -> "Pairing":
        """Return the pairing of a match of a result."""
        return cls(*(match[name] for name in cls._fields))

    def __str__(self) -> str:
        who = f"candidate {self.candidate}, " if self.candidate >= 0 else ""
        beside = f" beside {self.mate}" if self.mate != SELF else ""
        return f"{who}{self.game} against {self.against}{beside}"

    @property
    def file(self) -> str:
        """The name of its file, in the folder of its result."""
        parts = [self.game, self.against, *([self.mate] if self.mate != SELF else [])]
        return re.sub(r"[^\w.+-]+", "-", "-".join(parts + [str(self.candidate)] * (self.candidate >= 0))) + ".npz"


@dataclass(frozen=True)
class Result:
    """A result in its folder, RESULTS/AGENT/TASK/SEED, together with its policies and the files of its matches.

    folder: The folder of result.json. content: The content of result.json.
    """

    folder: Path
    content: Content

    @property
    def name(self) -> str:
        """The name in messages: "fast ffa_2-v2 0"."""
        return "{agent} {task} {seed}".format(**self.content)

    @property
    def matches(self) -> dict[Pairing, Content]:
        """The matches that were played."""
        return {Pairing.of(match): match for match in self.content["matches"]}

    def policy(self, candidate: int = -1) -> Path:
        """Return the file of its policy, or of a candidate; it does not exist for a function."""
        return self.folder / f"{'policy' if candidate < 0 else f'candidate-{candidate}'}{policy_file.SUFFIX}"

    def response(self, name: str) -> Path:
        """Return the file of a best response, "scratch 5000000"."""
        return self.folder / f"response-{name.replace(' ', '-')}{policy_file.SUFFIX}"

    def write(self) -> None:
        """Write it, completely or not at all. Raises TrainingError."""
        write_json(self.folder / NAME, self.content)


def share(match: Mapping[str, int]) -> float:
    """Return the share of games that the agent won; a draw counts half."""
    return float((match["won"] + match["drawn"] / 2) / sum(match[name] for name in NUMBERS))


def begun(manifest: str, agent: str, task: str, seed: int) -> Content:
    """Return the result of an entry without any work. manifest: Its digest."""
    named = {"version": PROTOCOL, "manifest": manifest, "agent": agent, "task": task, "seed": seed, "made": made()}
    return named | {"candidates": [], "policy": None, "responses": {}, "matches": [], "situations": None}


def made() -> Content:
    """Return the origin of a file: versions, and the machine."""
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

    path: The file. wrong: Returns the fault in the content; "" if valid. Raises TrainingError: the file cannot be read,
    or its content is invalid.
    """
    try:
        content = json.loads(read_bytes(path, LONGEST))
        fault, found = wrong(content), dict(content)
    except OSError as error:
        raise TrainingError(f"{path} cannot be read: {error.strerror}") from error
    except strict_json.BROKEN as error:
        fault = f"{type(error).__name__}: {error}"
    if fault:
        raise TrainingError(f"{path} is not a result of the benchmark: {fault:.200}")
    return found


def read(path: Path) -> Result:
    """Read the result in a file. Raises TrainingError."""
    return Result(path.parent, read_json(path, wrong_with_result))


def wrong_with_parts(content: Content, valid: dict[str, Callable[[Any], bool]]) -> str:
    """Return the fault in the version or another part; "" if all are valid. Raises KeyError for a missing part."""
    if content["version"] != PROTOCOL:
        return f"version {content['version']!r:.20}: must be {PROTOCOL}"
    wrong = [key for key, is_valid in valid.items() if not is_valid(content[key])]
    return f"its {wrong[0]} cannot be {content[wrong[0]]!r:.80}" if wrong else ""


def wrong_with_result(content: Content) -> str:
    """Return the fault in the content of a result; "" if it is valid. Raises KeyError or similar for a missing part."""
    valid: dict[str, Callable[[Any], bool]] = {
        "manifest": is_digest,
        "agent": is_name,
        "task": is_word,
        "seed": is_count,
        "candidates": lambda given: isinstance(given, list) and all(map(_is_policy, given)),
        "policy": lambda given: given is None or _is_policy(given),
        "responses": lambda given: all(map(is_word, given)) and all(map(_is_policy, given.values())),
        "matches": lambda given: isinstance(given, list) and len(given) < 10_000,
        "situations": lambda given: given is None or (all(map(is_word, given)) and are_finite(given.values())),
        "made": lambda given: all(is_word(key) and is_word(str(value)) for key, value in given.items()),
    }
    if fault := wrong_with_parts(content, valid):
        return fault
    pairings = [Pairing.of(match) for match in content["matches"]]
    if len(set(pairings)) < len(pairings):
        return "a match occurs twice"
    for pairing, match in zip(pairings, content["matches"], strict=True):
        if not all(is_word(name) for name in pairing[:3]) or type(pairing.candidate) is not int:
            return "invalid names of a match"
        if fault := _wrong_with_match(match):
            return f"{pairing}: {fault}"
    return ""


def _wrong_with_match(match: Content) -> str:
    if not all(is_count(match[name]) for name in NUMBERS) or not sum(match[name] for name in NUMBERS):
        return "invalid numbers of games"
    if not is_digest(match["moves"]) or not (match["opponent"] == "" or is_digest(match["opponent"])):
        return "invalid digests"
    figures = match["figures"]
    known = [pair for pair in figures.values() if pair is not None]
    sound = all(isinstance(pair, list) and len(pair) == 2 and are_finite(pair) for pair in known)
    return "" if all(map(is_word, figures)) and sound else "invalid figures"


def _is_policy(given: Any) -> bool:
    steps, of_task = given["steps"], given["of_task"]
    trained = isinstance(of_task, bool) and (is_count(steps) or (steps is None and not of_task))
    return is_digest(given["digest"]) and trained and all(map(is_word, given["met"]))


def is_digest(given: Any) -> bool:
    """Return whether it is a SHA-256, hexadecimal."""
    return isinstance(given, str) and DIGEST.fullmatch(given) is not None


def is_name(given: Any) -> bool:
    """Return whether it can be the name of an agent."""
    return isinstance(given, str) and NAMES.fullmatch(given) is not None and not given.endswith((".json", ".zip"))


def is_count(given: Any) -> bool:
    """Return whether it is an integer >= 0 of 63 bits."""
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

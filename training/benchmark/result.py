"""Files of the benchmark: JSON, which is validated, as it may come from others. Needs no PyTorch."""

import json
import math
import platform
import re
from collections.abc import Iterator, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from outlast.ecs.kernels.available import available_cores
from outlast.envs.scenarios.fingerprint import is_word
from outlast.envs.storage import inputs
from outlast.envs.storage.inputs import read_bytes
from outlast.systems import box2d

from ..base.errors import TrainingError
from ..base.files import write_files
from .tasks import PROTOCOL

NAME = "result.json"
SELF = "self"  # in matches: the agent itself, as its own opponent or team-mate
AGENT = "agent:"  # begins the name of another agent of the manifest, as an opponent
KINDS = ("scratch", "self")  # best responses that begin with random weights, or with those of the agent
LONGEST = 2**24  # maximum bytes of a JSON file
is_name = re.compile(r"(?!.*\.(json|zip)$)\w[\w.+-]{0,60}").fullmatch  # of an agent: a part of the names of files
is_digest = re.compile(r"[0-9a-f]{64}").fullmatch  # SHA-256, hexadecimal
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


def share(match: Mapping[str, int]) -> float:
    """Return the share of games that the agent won; a draw counts half."""
    return float((match["won"] + match["drawn"] / 2) / sum(match[name] for name in NUMBERS))


def made() -> Content:
    """Return the origin of a file: versions, and the machine."""
    import outlast  # imported here, since it imports this package

    versions = {"outlast": outlast.__version__} | {name: version(name) for name in ("numpy", "numba", "torch")}
    about = {"Box2D": box2d.VERSION, "machine": f"{platform.system()} {platform.machine()}", "cores": available_cores()}
    return {"python": platform.python_version(), **versions, **about}


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file, completely or not at all; equal content gives equal bytes. Raises TrainingError."""
    text = json.dumps(content, indent=1, sort_keys=True, allow_nan=False)
    short = re.sub(r"\[\n\s+([^][{}]{1,80}?)\n\s+\]", lambda found: f"[{' '.join(found[1].split())}]", text)  # [1, 2]
    write_files({path: (short + "\n").encode()})


def read_json(path: Path, form: Any) -> Content:
    """Read the content of a JSON file. Raises TrainingError: it cannot be read, or is not of this form, see `fault`."""
    try:
        found = dict(json.loads(read_bytes(path, LONGEST)))
        wrong = fault(found, form)
    except OSError as error:
        raise TrainingError(f"{path} cannot be read: {error.strerror}") from error
    except inputs.BROKEN_JSON as error:
        wrong = f"{type(error).__name__}: {error}"
    if wrong:
        raise TrainingError(f"{path} is not a result of the benchmark: {wrong:.200}")
    return found


def fault(given: Any, form: Any, name: str = "") -> str:
    """Return the first part of JSON that is not of its form; "" if all are. Raises KeyError for a missing part.

    form: A value, or a test of one; [form] of each entry of a list; {name: form} of these parts of an object, or, with
    a test in place of a name, {test: form} of all its names and parts. name: Where the value is, in messages.
    """
    several = isinstance(form, (list, dict))
    if not (form(given) if callable(form) else isinstance(given, type(form)) if several else given == form):
        return f"its {name} cannot be {given!r:.80}"
    found = (fault(value, own, f"{name} {key}".strip()) for key, value, own in _parts(given, form))
    return next(filter(None, found), "")


def _parts(given: Any, form: Any) -> Iterator[tuple[Any, Any, Any]]:
    """Yield the name, the value and the form of each part."""
    if isinstance(form, list):
        yield from ((k, each, form[0]) for k, each in enumerate(given))
    elif isinstance(form, dict):
        for key, own in form.items():
            names = [key] if isinstance(key, str) else given
            yield from ((name, name, key) for name in names if callable(key))
            yield from ((name, given[name], own) for name in names)


def is_count(given: Any) -> bool:
    """Return whether it is an integer from 0 to 2**63 - 1."""
    return type(given) is int and 0 <= given < 2**63


def is_finite(given: Any) -> bool:
    """Return whether it is a finite number."""
    return type(given) in (int, float) and math.isfinite(given)


def _is_policy(given: Any) -> bool:
    steps, of_task = given["steps"], given["of_task"]
    trained = isinstance(of_task, bool) and (is_count(steps) or (steps is None and not of_task))
    return trained and all(map(is_word, given["met"])) and is_digest(given["digest"]) is not None


MATCH = {
    **dict.fromkeys(("game", "against", "mate"), is_word),
    **dict.fromkeys(NUMBERS, is_count),
    "candidate": lambda given: type(given) is int,
    "moves": is_digest,
    "opponent": lambda given: given == "" or is_digest(given),
    "figures": {is_word: lambda given: given is None or (len(given) == 2 and not fault(given, [is_finite]))},
}
RESULT = {
    "version": PROTOCOL,
    "manifest": is_digest,
    "agent": is_name,
    "task": is_word,
    "seed": is_count,
    "candidates": [_is_policy],
    "policy": lambda given: given is None or _is_policy(given),
    "responses": {is_word: _is_policy},
    "matches": [MATCH],
    "situations": lambda given: given is None or not fault(given, {is_word: is_finite}),
    "made": {is_word: lambda given: is_word(str(given))},
}


def read(path: Path) -> Content:
    """Read a result. Raises TrainingError."""
    content = read_json(path, RESULT)
    if len({Pairing.of(match) for match in content["matches"]}) < len(content["matches"]):
        raise TrainingError(f"{path} is not a result of the benchmark: a match occurs twice")
    return content

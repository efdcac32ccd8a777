"""What a run and each of its checkpoints say of themselves in run.json: checked before it is believed. No PyTorch."""

import json
import math
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from outlast.envs.errors import TrainingError
from outlast.envs.scenarios.fingerprint import is_fingerprint, is_word
from outlast.envs.storage import safe_npz

from .layout import MASK
from .presets import PRESETS

NAME = "run.json"
VERSION = 1
MOST, FEW = 2**16, 256  # numbers that an agent is told, values of its actions; actions
LONGEST = 2**20  # bytes
Header = dict[str, Any]


def read(path: Path, entries: Collection[str], needed: Collection[str]) -> tuple[Header, dict[str, bytes]]:
    """What the checkpoint says of itself, all that is needed, and these entries of it. Raises TrainingError."""
    try:
        with path.open("rb") as file:
            files = safe_npz.entries(file, {NAME, *entries})
        header = json.loads(files[NAME][: LONGEST + 1])
    except FileNotFoundError as error:
        raise TrainingError(f"there is no checkpoint {path}") from error
    except safe_npz.BROKEN as error:
        raise TrainingError(f"{path} is not a checkpoint: {str(error) or type(error).__name__}") from error
    return sound(path, header, needed), files


def of_run(folder: Path) -> Header:
    """What the run in a folder says of itself, before and without any checkpoint. Raises TrainingError."""
    path = folder / NAME
    try:
        with path.open("rb") as file:
            header = json.loads(file.read(LONGEST))
    except FileNotFoundError as error:
        raise TrainingError(f"{folder} has no {NAME}, which would say what is trained in it") from error
    except (OSError, ValueError, RecursionError) as error:
        raise TrainingError(f"{path} does not say what the run is: {error}") from error
    return sound(path, header, ("plan", "scenario"))


def sound(path: Path, header: Any, needed: Collection[str]) -> Header:
    """The same, if it is what a run would say, with all that is needed. Raises TrainingError."""
    told = f"{path} does not say what the run is"
    if not isinstance(header, dict):
        raise TrainingError(f"{told}: it holds {type(header).__name__}")
    if header.get("version", VERSION) != VERSION:
        raise TrainingError(f"{path} has version {header['version']!r:.20}: {VERSION} is needed")
    if missing := set(needed) - header.keys():
        raise TrainingError(f"{told}: its {', '.join(sorted(missing))} is missing")
    for key, fits in KINDS.items():
        if key in header and not fits(header[key]):
            raise TrainingError(f"{told}: its {key} cannot be {header[key]!r:.80}")
    return header


def is_plain(given: Any) -> bool:
    """Whether it is a number, a truth, nothing, or a text to be shown in a line (in which $ would begin a formula)."""
    number = isinstance(given, (int, float)) and abs(given) < 1e300
    return given is None or number or (is_word(given) and "$" not in given)


def is_plan(given: Any) -> bool:
    """Whether it could be a Plan as `about` tells it: plain values by name, and in `settings` once more."""
    if not isinstance(given, dict) or not isinstance(settings := given.get("settings", {}), dict):
        return False
    own = {key: value for key, value in given.items() if key != "settings"}
    return all(map(is_plain, (*own, *own.values(), *settings, *settings.values())))


def _is_size(given: Any) -> bool:
    return type(given) is int and 0 <= given <= MOST


def _are_observations(given: Any) -> bool:
    """Shapes by key; a kind has two dimensions, and beside it a mask of the first of them."""
    if not isinstance(given, dict) or not given or "self" not in given or not all(map(is_word, given)):
        return False
    if not all(isinstance(shape, list) and shape and all(map(_is_size, shape)) for shape in given.values()):
        return False
    kinds = [(given[key], given[key + MASK]) for key in given if key + MASK in given]
    room = sum(math.prod(max(1, size) for size in shape) for shape in given.values())
    return room <= MOST and all(len(shape) == 2 and mask == shape[:1] for shape, mask in kinds)


def _are_actions(given: Any) -> bool:
    few = isinstance(given, list) and 0 < len(given) <= FEW
    return few and all(_is_size(size) and size for size in given) and sum(given) <= MOST


KINDS: dict[str, Callable[[Any], bool]] = {
    "steps": lambda given: type(given) is int and 0 <= given < 2**62,
    "preset": lambda given: isinstance(given, str) and given in PRESETS,
    "scenario": is_fingerprint,
    "observations": _are_observations,
    "actions": _are_actions,
    "plan": is_plan,
}

"""run.json, in the folder of a run and in its checkpoints: settings of training, with checks. Needs no PyTorch."""

import json
import math
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from outlast.ecs.declarations.fields import SMALLEST
from outlast.envs.core.options import ChoicesBySide
from outlast.envs.scenarios.fingerprint import is_fingerprint, is_word
from outlast.envs.storage import safe_npz, strict_json

from .errors import TrainingError
from .files import read_bytes
from .observation_layout import MASK, OWN
from .presets import PRESETS

NAME = "run.json"
WEIGHTS = "policy.safetensors"  # in a checkpoint: weights of its policies
VERSION = 1
NEEDED = "version", "steps", "preset", "scenario", "observations", "fields", "actions", "team", "memory", "state"
MOST, FEW = 2**16, 256  # maximum numbers of an observation or values of an action; maximum actions
LONGEST, LARGEST = 2**20, 2**30  # maximum bytes of the file, and of a checkpoint
ASKED = "asked"  # agent-steps that were last requested; the plan omits them if the run may be extended
TEXTS = ("opponents", "warm_start", "anneal")  # texts of a plan, which may name many files
Header = dict[str, Any]


def read_checkpoint(path: Path, entries: Collection[str], needed: Collection[str]) -> tuple[Header, dict[str, bytes]]:
    """Read the header of a checkpoint, which must have all `needed` keys, and these entries. Raises TrainingError."""
    try:
        with path.open("rb") as file:
            files = safe_npz.entries(file, {NAME, *entries}, LARGEST)
    except FileNotFoundError as error:
        raise TrainingError(f"checkpoint {path} does not exist") from error
    except safe_npz.BROKEN as error:
        cure = "outlast's training saves them; wrap a policy of another library in a function"
        raise TrainingError(f"{path} is not a checkpoint: {str(error) or type(error).__name__}; {cure}") from error
    return parse_header(path, files[NAME], needed), files


def read_run_folder(folder: Path) -> Header:
    """Read the header of the run in a folder, which is written before the first checkpoint. Raises TrainingError."""
    if not (path := folder / NAME).exists():
        raise TrainingError(f"{folder} has no {NAME}, which describes the run")
    return parse_header(path, read_bytes(path, LONGEST), ("plan", "scenario"))


def parse_header(path: Path, content: bytes, needed: Collection[str]) -> Header:
    """Parse the content of run.json. Raises TrainingError if it is not valid."""
    wrong = f"{path} does not describe a run"
    try:
        header = json.loads(content[: LONGEST + 1])
    except strict_json.BROKEN as error:
        raise TrainingError(f"{wrong}: {error}") from error
    if not isinstance(header, dict):
        raise TrainingError(f"{wrong}: it holds {type(header).__name__}")
    if header.get("version", VERSION) != VERSION:
        raise TrainingError(f"{path} has version {header['version']!r:.20}: {VERSION} is needed")
    if missing := set(needed) - header.keys():
        raise TrainingError(f"{wrong}: its {', '.join(sorted(missing))} is missing")
    for key, is_valid in VALIDATORS.items():
        if key in header and not is_valid(header[key]):
            raise TrainingError(f"{wrong}: its {key} cannot be {header[key]!r:.80}")
    return header


def is_plain(given: Any) -> bool:
    """Return whether it is a number, a bool, None, or a text of one line without $, which begins a formula in plots."""
    number = isinstance(given, (int, float)) and abs(given) < 1e300
    return given is None or number or (is_word(given) and "$" not in given)


def is_plan(given: Any) -> bool:
    """Return whether it could be the `plan` of TrainingConfig.header: plain values by name, also in `settings`."""
    if not isinstance(given, dict) or not isinstance(settings := given.get("settings", {}), dict):
        return False
    own = {key: value for key, value in given.items() if key not in ("settings", *TEXTS)}
    texts = [given[key] for key in TEXTS if key in given]
    lines = all(isinstance(text, str) and len(text) <= MOST and text.isprintable() for text in texts)
    return lines and all(map(is_plain, (*own, *own.values(), *settings, *settings.values())))


def _is_size(given: Any) -> bool:
    return type(given) is int and 0 <= given <= MOST


def _are_observations(given: Any) -> bool:
    """Return whether these are shapes by key, where each kind has two dimensions and its mask has the first of them."""
    if not isinstance(given, dict) or OWN not in given or not all(map(is_word, given)):
        return False
    if not all(isinstance(shape, list) and shape and all(map(_is_size, shape)) for shape in given.values()):
        return False
    kinds = [(given[key], given[key + MASK]) for key in given if key + MASK in given]
    room = sum(math.prod(max(1, size) for size in shape) for shape in given.values())
    return room <= MOST and all(len(shape) == 2 and mask == shape[:1] for shape, mask in kinds)


def _are_fields(given: Any) -> bool:
    """Return whether it holds [size, scale] by key and name."""
    if not isinstance(given, dict) or not all(isinstance(fields, dict) and fields for fields in given.values()):
        return False
    entries = [entry for fields in given.values() for entry in fields.values()]
    names = [*given, *(name for fields in given.values() for name in fields)]
    pairs = all(isinstance(each, list) and len(each) == 2 for each in entries) and all(map(is_word, names))
    sound = pairs and all(_is_size(size) and size and _is_scale(scale) for size, scale in entries)
    return sound and sum(size for size, _ in entries) <= MOST


def _is_scale(given: Any) -> bool:
    return type(given) in (int, float) and SMALLEST <= given < math.inf


def _sizes(most: int, least: int) -> Callable[[Any], bool]:
    """Return a check for a list of 1 to `most` sizes, each at least `least`."""
    return lambda given: (
        isinstance(given, list) and 0 < len(given) <= most and all(_is_size(n) and n >= least for n in given)
    )


def is_count(given: Any) -> bool:
    """Return whether it could be a number of agent-steps, updates or epochs."""
    return type(given) is int and 0 <= given < 2**62


VALIDATORS: dict[str, Callable[[Any], bool]] = {
    "steps": is_count,
    ASKED: is_count,
    "preset": lambda given: isinstance(given, str) and given in ChoicesBySide(PRESETS),
    "presets": lambda given: isinstance(given, list) and all(map(PRESETS.__contains__, given)),
    "scenario": is_fingerprint,
    "modules": lambda given: isinstance(given, list) and all(map(is_word, given)),
    "observations": _are_observations,
    "fields": _are_fields,
    "actions": lambda given: _sizes(FEW, 1)(given) and sum(given) <= MOST,
    "team": _sizes(MOST, 0),
    "memory": _is_size,
    "networks": lambda given: is_word(given) or (isinstance(given, list) and all(e == "" or is_word(e) for e in given)),
    "state": _is_size,
    "state_scale": lambda given: isinstance(given, list) and len(given) <= MOST and all(map(_is_scale, given)),
    "plan": is_plan,
}

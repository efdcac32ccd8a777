"""Saved policies: run.json, which describes the training and is checked here, and weights. Needs no PyTorch.

run.json is in the folder of a run, in its checkpoints, and in files of weights: safetensors in float16, with run.json
as the only entry of the metadata, since the order of several is random: equal content gives equal bytes. Tensors are
called "0.actor.first.weight": number of the policy, name of the weight. Checkpoints hold such a file, too, in float32
and without run.json.
"""

import json
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from outlast.ecs.declarations.fields import SMALLEST
from outlast.envs.errors import needed
from outlast.envs.scenarios.fingerprint import is_fingerprint, is_word
from outlast.envs.storage import inputs

from .errors import TrainingError
from .files import read_bytes, write_files
from .observation_layout import MASK, OWN
from .presets import PRESETS, ChoicesBySide

RUN_JSON = "run.json"
WEIGHTS = "policy.safetensors"  # in a checkpoint: weights of its policies
VERSION = 1
NEEDED = "version", "steps", "preset", "scenario", "observations", "fields", "actions", "team", "memory", "state"
MOST, FEW = 2**16, 256  # maximum numbers of an observation or values of an action; maximum actions
LONGEST, LARGEST_CHECKPOINT = 2**20, 2**30  # maximum bytes of the file, and of a checkpoint
ASKED = "asked"  # agent-steps that were last requested; the plan omits them if the run may be extended
TEXTS = ("opponents", "warm_start", "anneal")  # texts of a plan, which may name many files
Header = dict[str, Any]
SUFFIX = ".safetensors"
LARGEST = 2**26  # maximum bytes of a file
ENTRY = "outlast"  # the only key of the metadata
DTYPES = "float16", "float32", "float64", "int64", "int32", "uint8"  # of tensors
CRITIC = ("critic.", "overview.", "extractors.1.")  # prefixes of weights that only the value function needs
Array = np.ndarray[Any, Any]
Weights = Mapping[str, Array]


def read_checkpoint(path: Path, entries: Collection[str], needed: Collection[str]) -> tuple[Header, dict[str, bytes]]:
    """Read the header of a checkpoint, which must have all `needed` keys, and these entries. Raises TrainingError."""
    try:
        with path.open("rb") as file:
            files = inputs.zip_entries(file, {RUN_JSON, *entries}, LARGEST_CHECKPOINT)
    except FileNotFoundError as error:
        raise TrainingError(f"checkpoint {path} does not exist") from error
    except inputs.BROKEN_ZIP as error:
        cure = "outlast's training saves them; wrap a policy of another library in a function"
        raise TrainingError(f"{path} is not a checkpoint: {str(error) or type(error).__name__}; {cure}") from error
    return parse_header(path, files[RUN_JSON], needed), files


def read_run_folder(folder: Path) -> Header:
    """Read the header of the run in a folder, which is written before the first checkpoint. Raises TrainingError."""
    if not (path := folder / RUN_JSON).exists():
        raise TrainingError(f"{folder} has no {RUN_JSON}, which describes the run")
    return parse_header(path, read_bytes(path, LONGEST), ("plan", "scenario"))


def parse_header(path: Path, content: bytes, needed: Collection[str]) -> Header:
    """Parse the content of run.json. Raises TrainingError if it is not valid."""
    wrong = f"{path} does not describe a run"
    try:
        header = json.loads(content[: LONGEST + 1])
    except inputs.BROKEN_JSON as error:
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


def _are_sizes(given: Any, most: int, least: int) -> bool:
    """Return whether it is a list of 1 to `most` sizes, each at least `least`."""
    return isinstance(given, list) and 0 < len(given) <= most and all(_is_size(n) and n >= least for n in given)


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
    "actions": lambda given: _are_sizes(given, FEW, 1) and sum(given) <= MOST,
    "team": lambda given: _are_sizes(given, MOST, 0),
    "memory": _is_size,
    "networks": lambda given: is_word(given) or (isinstance(given, list) and all(e == "" or is_word(e) for e in given)),
    "state": _is_size,
    "state_scale": lambda given: isinstance(given, list) and len(given) <= MOST and all(map(_is_scale, given)),
    "plan": is_plan,
}


def content(header: Header, policies: Sequence[Weights], exact: str | None = None) -> bytes:
    """Return the content of a file of policies with these weights by name; equal policies give equal bytes.

    exact: Prefix of weights that stay float32; "": all; None: all become float16.
    """
    tensors = {
        name: value.astype(np.float32 if exact is not None and name.partition(".")[2].startswith(exact) else np.float16)
        for name, value in _numbered(policies).items()
    }
    return tensors_content(tensors, json.dumps(header, separators=(",", ":")))


def weights_content(policies: Sequence[Weights]) -> bytes:
    """Return the content of the file of policies in a checkpoint: unrounded weights."""
    return tensors_content(_numbered(policies))


def write(path: Path, header: Header, policies: Sequence[Weights], exact: str | None = None) -> None:
    """Write the policies of a checkpoint, completely or not at all; see `content`. Raises TrainingError."""
    write_files({path: content(header, policies, exact)})


def read(path: Path) -> tuple[Header, list[dict[str, Array]]]:
    """Return run.json and the weights of each policy by name, float32 from a file of weights. Raises TrainingError."""
    if path.suffix != SUFFIX:
        header, files = read_checkpoint(path, (WEIGHTS,), NEEDED)
        return header, parse_weights(files[WEIGHTS], f"{path} is not a checkpoint: {WEIGHTS} in it")
    text, tensors = _parsed(read_bytes(path, LARGEST), path)
    header = parse_header(path, text.encode(), NEEDED)
    return header, _by_policy({name: values.astype(np.float32) for name, values in tensors.items()}, path)


def parse_weights(data: bytes, name: object = WEIGHTS) -> list[dict[str, Array]]:
    """Return the weights of each policy in a checkpoint by name, unchecked. Raises TrainingError with the name."""
    return _by_policy(_parsed(data, name)[1], name)


def read_header(path: Path, needed: Collection[str]) -> Header:
    """Return run.json of a saved policy, which must have these keys. Raises TrainingError."""
    if path.suffix == SUFFIX:
        return parse_header(path, _parsed(read_bytes(path, LARGEST), path)[0].encode(), needed)
    return read_checkpoint(path, (), needed)[0]


def _numbered(policies: Sequence[Weights]) -> dict[str, Array]:
    return {f"{k}.{name}": values for k, own in enumerate(policies) for name, values in own.items()}


def _by_policy(tensors: Mapping[str, Array], name: object) -> list[dict[str, Array]]:
    """Return the tensors of each policy. Raises TrainingError, which contains the name."""
    policies = dict[str, dict[str, Array]]()
    for key, values in sorted(tensors.items()):
        number, _, weight = key.partition(".")
        policies.setdefault(number, {})[weight] = values
    numbers = [str(k) for k in range(len(policies))]
    if not policies or policies.keys() != {*numbers}:
        raise TrainingError(f"{name} is not a policy: its tensors are not called 0.NAME, 1.NAME ...")
    return [policies[number] for number in numbers]


def _parsed(data: bytes, name: object) -> tuple[str, dict[str, Array]]:
    try:
        return parse_tensors(data)
    except ValueError as error:
        raise TrainingError(f"{name} is not a policy: {error}") from error


def tensors_content(tensors: Mapping[str, Array], text: str = "") -> bytes:
    """Return the content of a file with these tensors; equal ones give equal bytes."""
    return _safetensors().numpy.save(
        {name: np.asarray(values, order="C") for name, values in tensors.items()}, {ENTRY: text}
    )


def parse_tensors(data: bytes) -> tuple[str, dict[str, Array]]:
    """Return the text and the tensors of a file, sorted, in memory of the length of `data`. Raises ValueError."""
    safetensors = _safetensors()
    try:
        tensors = dict(sorted(safetensors.numpy.load(data).items()))  # whose order is random
    except safetensors.SafetensorError as error:
        raise ValueError(str(error)) from error
    except KeyError as error:  # a type that numpy lacks
        raise ValueError(f"a tensor is of type {error}: {', '.join(DTYPES)} are known") from error
    for name, values in tensors.items():
        if values.dtype.name not in DTYPES:
            raise ValueError(f"{name:.80} is of type {values.dtype}: {', '.join(DTYPES)} are known")
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    return (header.get("__metadata__") or {}).get(ENTRY, ""), tensors


def _safetensors() -> Any:
    """Return the library, without which this module can be imported. Raises TrainingError if it is not installed."""
    with needed("train", "weights of policies need {}", TrainingError):
        import safetensors.numpy
    return safetensors

"""Policies as safetensors: weights in float16, and run.json without indentation. Needs numpy, and no PyTorch.

A file holds the policies of one checkpoint, whose tensors are called "0.actor.first.weight": number of the policy, name
of the weight. The metadata have one entry, as the order of several is random.
"""

import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.errors import install

from .errors import TrainingError
from .files import write_files
from .run_header import NEEDED, Header, parse_header, read_checkpoint

SUFFIX = ".safetensors"
ENTRY = "outlast"  # of the metadata: run.json
LARGEST = 2**26  # bytes of a file
CRITIC = ("critic.", "overview.", "extractors.1.")  # the beginnings of weights that only values need
Array = np.ndarray[Any, Any]
Weights = Mapping[str, Array]


def content(header: Header, policies: Sequence[Weights], exact: str = "") -> bytes:
    """Return the content of a file of policies; equal policies give equal bytes.

    Args:
        header: The content of run.json.
        policies: Weights of each policy by name, float32; they are rounded to float16.
        exact: Weights whose names begin with this stay float32; "": none.
    """
    from safetensors.numpy import save  # imported here, as checkpoints are read without it

    tensors = {
        f"{k}.{name}": value.astype(np.float32 if exact and name.startswith(exact) else np.float16)
        for k, own in enumerate(policies)
        for name, value in own.items()
    }
    return save(tensors, {ENTRY: json.dumps(header, separators=(",", ":"))})


def write(path: Path, header: Header, policies: Sequence[Weights], exact: str = "") -> None:
    """Write the policies of a checkpoint, completely or not at all; see `content`.

    Raises:
        TrainingError: The file cannot be written.
    """
    write_files({path: content(header, policies, exact)})


def read(path: Path) -> tuple[Header, list[dict[str, Array]]]:
    """Return run.json and the weights of each policy by name, float32.

    Raises:
        TrainingError: The file cannot be read, or holds something else; or safetensors is not installed.
    """
    entry, tensors = _opened(path, weights=True)
    header = parse_header(path, entry, NEEDED)
    policies = dict[str, dict[str, Array]]()
    for name, values in sorted(tensors.items()):
        number, _, weight = name.partition(".")
        policies.setdefault(number, {})[weight] = values
    numbers = [str(k) for k in range(len(policies))]
    if not policies or policies.keys() != {*numbers}:
        raise TrainingError(f"{path} is not a policy: its tensors are not called 0.NAME, 1.NAME ...")
    return header, [policies[number] for number in numbers]


def read_header(path: Path, needed: Collection[str]) -> Header:
    """Return run.json of a saved policy, which must have these keys: of a file of weights, or of a checkpoint.

    Raises:
        TrainingError: The file cannot be read, or holds something else; or safetensors is not installed.
    """
    if path.suffix == SUFFIX:
        return parse_header(path, _opened(path, weights=False)[0], needed)
    return read_checkpoint(path, (), needed)[0]


def _opened(path: Path, weights: bool) -> tuple[bytes, dict[str, Array]]:
    """Return run.json as it is, and all tensors as float32, or none."""
    try:
        from safetensors import SafetensorError, safe_open
    except ModuleNotFoundError as error:
        raise TrainingError(f"{path} needs {error.name}: {install('train')}") from error
    try:
        if path.stat().st_size > LARGEST:
            raise ValueError(f"it has more than {LARGEST:,} bytes")
        with safe_open(path, framework="np") as file:
            entry = (file.metadata() or {}).get(ENTRY, "")
            names = file.keys() if weights else ()
            return entry.encode(), {name: file.get_tensor(name).astype(np.float32) for name in names}
    except OSError as error:
        raise TrainingError(f"{path} cannot be read: {error.strerror or error}") from error
    except (SafetensorError, ValueError, TypeError) as error:
        raise TrainingError(f"{path} is not a policy: {error}") from error

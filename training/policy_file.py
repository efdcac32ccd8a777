"""Policies as safetensors: weights in float16, and run.json without indentation. Needs numpy, and no PyTorch.

A file holds the policies of one checkpoint, whose tensors are called "0.actor.first.weight": number of the policy, name
of the weight. The metadata have one entry, as the order of several is random.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from .errors import TrainingError
from .files import write_files
from .run_header import NEEDED, Header, parse_header

SUFFIX = ".safetensors"
ENTRY = "outlast"  # of the metadata: run.json
LARGEST = 2**26  # bytes of a file
CRITIC = "critic."  # weights that a policy can play without
Array = np.ndarray[Any, Any]
Weights = Mapping[str, Array]


def write(path: Path, header: Header, policies: Sequence[Weights]) -> None:
    """Write the policies of a checkpoint, completely or not at all; equal policies give equal bytes.

    Args:
        path: The file.
        header: The content of run.json.
        policies: Weights of each policy by name, float32; they are rounded to float16.

    Raises:
        TrainingError: The file cannot be written.
    """
    tensors = {f"{k}.{name}": value.astype(np.float16) for k, own in enumerate(policies) for name, value in own.items()}
    metadata = {ENTRY: json.dumps(header, separators=(",", ":"))}
    write_files({path: save(tensors, metadata)})


def read(path: Path) -> tuple[Header, list[dict[str, Array]]]:
    """Return run.json and the weights of each policy by name, float32.

    Raises:
        TrainingError: The file cannot be read, or holds something else.
    """
    try:
        if path.stat().st_size > LARGEST:
            raise TrainingError(f"{path} is larger than {LARGEST:,} bytes: it is not a policy")
        with safe_open(path, framework="np") as file:
            entry = (file.metadata() or {}).get(ENTRY, "")
            tensors = {name: file.get_tensor(name).astype(np.float32) for name in file.keys()}  # noqa: SIM118
    except OSError as error:
        raise TrainingError(f"{path} cannot be read: {error.strerror or error}") from error
    except (SafetensorError, ValueError, TypeError) as error:
        raise TrainingError(f"{path} is not a policy: {error}") from error
    header = parse_header(path, entry.encode(), NEEDED)
    policies = dict[str, dict[str, Array]]()
    for name, values in sorted(tensors.items()):
        number, _, weight = name.partition(".")
        policies.setdefault(number, {})[weight] = values
    numbers = [str(k) for k in range(len(policies))]
    if not policies or policies.keys() != {*numbers}:
        raise TrainingError(f"{path} is not a policy: its tensors are not called 0.NAME, 1.NAME ...")
    return header, [policies[number] for number in numbers]

"""Policies as safetensors: weights in float16, and run.json without indentation. Needs numpy, but not PyTorch.

The metadata of a file has a single entry, since the order of several is random: equal content gives equal bytes. A
file holds the policies of one checkpoint, with tensors called "0.actor.first.weight": number of the policy, name of
the weight. Checkpoints hold such a file, too, in float32 and without run.json.
"""

import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from outlast.envs.errors import needed

from .errors import TrainingError
from .files import read_bytes, write_files
from .run_header import NEEDED, WEIGHTS, Header, parse_header, read_checkpoint

SUFFIX = ".safetensors"
LARGEST = 2**26  # maximum bytes of a file
ENTRY = "outlast"  # the only key of the metadata
DTYPES = "float16", "float32", "float64", "int64", "int32", "uint8"  # of tensors
CRITIC = ("critic.", "overview.", "extractors.1.")  # prefixes of weights that only the value function needs
Array = np.ndarray[Any, Any]
Weights = Mapping[str, Array]


def content(header: Header, policies: Sequence[Weights], exact: str | None = None) -> bytes:
    """Return the content of a file of policies; equal policies give equal bytes.

    header: The content of run.json. policies: Weights of each policy by name, float32; they are rounded to float16.
    exact: Prefix of weights that stay float32; "": all; None: none.
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
    """Return run.json and the weights of each policy by name, float32 if the file is a file of weights.

    Raises TrainingError if the file cannot be read, or has other content.
    """
    if path.suffix != SUFFIX:
        header, files = read_checkpoint(path, (WEIGHTS,), NEEDED)
        return header, parse_weights(files[WEIGHTS], f"{path} is not a checkpoint: {WEIGHTS} in it")
    text, tensors = _opened(path)
    header = parse_header(path, text.encode(), NEEDED)
    return header, _by_policy({name: values.astype(np.float32) for name, values in tensors.items()}, path)


def parse_weights(data: bytes, name: object = WEIGHTS) -> list[dict[str, Array]]:
    """Return the weights of each policy in a checkpoint by name, unchecked.

    name: Name of the file in errors. Raises TrainingError if the data has other content.
    """
    try:
        return _by_policy(parse_tensors(data)[1], name)
    except ValueError as error:
        raise TrainingError(f"{name} is not a policy: {error}") from error


def read_header(path: Path, needed: Collection[str]) -> Header:
    """Return run.json of a saved policy, which must have these keys: a file of weights or a checkpoint.

    Raises TrainingError if the file cannot be read, or has other content.
    """
    if path.suffix == SUFFIX:
        return parse_header(path, _opened(path)[0].encode(), needed)
    return read_checkpoint(path, (), needed)[0]


def _numbered(policies: Sequence[Weights]) -> dict[str, Array]:
    """Return the tensors of a file of these policies."""
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


def _opened(path: Path) -> tuple[str, dict[str, Array]]:
    """Return run.json, unparsed, and all tensors."""
    content = read_bytes(path, LARGEST)
    try:
        return parse_tensors(content)
    except ValueError as error:
        raise TrainingError(f"{path} is not a policy: {error}") from error


def tensors_content(tensors: Mapping[str, Array], text: str = "") -> bytes:
    """Return the content of a file with these tensors; equal ones give equal bytes."""
    return _safetensors().numpy.save(
        {name: np.asarray(values, order="C") for name, values in tensors.items()}, {ENTRY: text}
    )


def parse_tensors(data: bytes) -> tuple[str, dict[str, Array]]:
    """Return the text and the tensors of a file, in order of their names. Memory is bounded by the length of `data`.

    Raises ValueError for other content.
    """
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

"""Tensors as safetensors, with one text beside them. Needs numpy, and no PyTorch.

The metadata have one entry, as the order of several is random: so equal content gives equal bytes.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from .errors import needed

ENTRY = "outlast"  # of the metadata: the text
DTYPES = "float16", "float32", "float64", "int64", "int32", "uint8"  # of tensors
Array = np.ndarray[Any, Any]


def content(tensors: Mapping[str, Array], text: str = "") -> bytes:
    """Return the content of a file with these tensors; equal ones give equal bytes."""
    _check_installed()
    from safetensors.numpy import save

    return save({name: np.asarray(values, order="C") for name, values in tensors.items()}, {ENTRY: text})


def parse(data: bytes) -> tuple[str, dict[str, Array]]:
    """Return the text and the tensors of a file's content, in order of their names. Memory is bounded by its length.

    Raises ValueError if it is something else.
    """
    _check_installed()
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        tensors = dict(sorted(load(data).items()))  # whose order is random
    except SafetensorError as error:
        raise ValueError(str(error)) from error
    except KeyError as error:  # a type that numpy lacks
        raise ValueError(f"a tensor is of type {error}: {', '.join(DTYPES)} are known") from error
    for name, values in tensors.items():
        if values.dtype.name not in DTYPES:
            raise ValueError(f"{name:.80} is of type {values.dtype}: {', '.join(DTYPES)} are known")
    header = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])
    return (header.get("__metadata__") or {}).get(ENTRY, ""), tensors


def _check_installed() -> None:
    """Raise TrainingError if safetensors is not installed: this module is imported without it."""
    with needed("train", "weights of policies need"):
        import safetensors  # noqa: F401

"""Policies as safetensors: what is written is read, rounded to float16, and other files are refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("safetensors", reason="needs safetensors: outlast[train]")

from safetensors.numpy import save

from outlast import variant
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.training.base import policy_file
from outlast.training.base.errors import TrainingError

HEADER: dict[str, Any] = {
    "version": 1,
    "steps": 3,
    "preset": "fast",
    "observations": {"own": [8]},
    "fields": {"own": {"id": [1, 1.0]}},
    "actions": [3, 2],
    "team": [0, 0],
    "memory": 0,
    "state": 0,
    "scenario": fingerprint(variant("ffa_2")),
}


def test_what_is_written_is_read(tmp_path: Path) -> None:
    """In order of the policies, of which there are more than ten, and to the bit where float16 holds the numbers."""
    generator = np.random.default_rng(0)
    exact = [{"a.weight": np.full((2, 3), k / 8, np.float32), "a.bias": np.float32([k])} for k in range(12)]
    exact[3]["a.weight"] = generator.normal(size=(2, 3)).astype(np.float32)
    places = [tmp_path / "a.safetensors", tmp_path / "b.safetensors"]
    for place in places:
        policy_file.write(place, HEADER, exact)
    assert places[0].read_bytes() == places[1].read_bytes()
    header, found = policy_file.read(places[0])
    assert header == HEADER
    assert [{name: (each.shape, each.dtype) for name, each in own.items()} for own in found] == [
        {name: (each.shape, each.dtype) for name, each in own.items()} for own in exact
    ]
    assert all(np.array_equal(own["a.bias"], each["a.bias"]) for own, each in zip(found, exact, strict=True))
    assert np.abs(found[3]["a.weight"] - exact[3]["a.weight"]).max() < 2**-10
    assert not np.array_equal(found[3]["a.weight"], exact[3]["a.weight"])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is not a policy"),
        (b"\xff" * 64, "is not a policy"),
        (save({"0.a": np.zeros(2, np.float16)}), "does not describe a run"),
        (save({"0.a": np.zeros(2, np.float16)}, {"outlast": "{}"}), "its .*preset.* is missing"),
    ],
)
def test_other_files_are_refused(content: bytes, message: str, tmp_path: Path) -> None:
    place = tmp_path / "a.safetensors"
    place.write_bytes(content)
    with pytest.raises(TrainingError, match=message):
        policy_file.read(place)
    with pytest.raises(TrainingError, match="cannot be read: No such file"):
        policy_file.read(tmp_path / "b.safetensors")


def test_policies_are_numbered(tmp_path: Path) -> None:
    policy_file.write(tmp_path / "a.safetensors", HEADER, [])
    with pytest.raises(TrainingError, match=r"its tensors are not called 0\.NAME, 1\.NAME"):
        policy_file.read(tmp_path / "a.safetensors")

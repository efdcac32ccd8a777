"""Checkpoints: one .zip file with everything that a run needs to go on as if it had never stopped.

It contains policy.pt and rest.pt (tensors and numbers only, see safe_torch), worlds.npz (see envs.snapshots), and
run.json (see run_header), which says what the policy was trained in, and how. Nothing in it is executed.
"""

import io
import zipfile
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.storage.atomic_write import atomic_write

from . import policy_file, run_header, safe_torch
from .errors import TrainingError
from .observation_layout import Array, ObservationLayout, scales
from .policy import ActorCritic

HEAVIEST = 1000  # the largest weight: with larger ones sums may overflow to NaN, from which no action can be chosen


def write_checkpoint(path: Path, files: dict[str, bytes]) -> None:
    """Write a checkpoint, completely or not at all."""
    with atomic_write(path) as place, zipfile.ZipFile(place, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)


def read_checkpoint(path: Path, names: Collection[str] = ("policy.pt", "rest.pt", "worlds.npz")) -> dict[str, bytes]:
    """Read files of a checkpoint. run.json is checked here, the others when they are used. Raises TrainingError."""
    return run_header.read_checkpoint(path, names, run_header.NEEDED)[1]


def header_of(files: dict[str, bytes]) -> run_header.Header:
    """Return run.json of a checkpoint, with an empty plan if it was not made by a run."""
    return {"plan": {}, **run_header.parse_header(Path(run_header.NAME), files[run_header.NAME], ())}


def check_fields(header: run_header.Header, env: SurvivalVectorEnv) -> None:
    """Raise TrainingError if observations have other fields here than in training."""
    for key, fields in header["fields"].items():
        known, here = ", ".join(fields), ", ".join(env.fields.get(key, {}))
        if known != here:
            raise TrainingError(
                f"the policy was trained on rows '{key}' of {known}; here they are {here or 'not there'}"
            )


def recorded_scales(header: run_header.Header, layout: ObservationLayout) -> tuple[Array, Array]:
    """Return the scales of inputs in training, float32 (own,) and (numbers of all kinds,). Raises TrainingError."""
    try:
        return scales(layout, header["fields"])
    except ValueError as error:
        raise TrainingError(f"run.json has observations that no scenario has: {error}") from None


def policies_in(files: dict[str, bytes]) -> list[Any]:
    """The weights of each policy in policy.pt, which holds those of one or a list; unchecked. Raises TrainingError."""
    found = load_tensors(files, "policy.pt")
    return found if isinstance(found, list) and found else [found]


def read_policies(path: Path) -> tuple[run_header.Header, list[Any], int]:
    """Read what a saved policy plays with, from a checkpoint or a file of weights. Raises TrainingError.

    Returns:
        run.json, the weights of each policy, unchecked, and how many bytes these take as float32, at least.
    """
    if path.suffix == policy_file.SUFFIX:
        header, policies = policy_file.read(path)
        weights = [{name: torch.from_numpy(values) for name, values in own.items()} for own in policies]
        return {"plan": {}, **header}, weights, sum(values.nbytes for own in policies for values in own.values())
    files = read_checkpoint(path, ("policy.pt",))
    return header_of(files), policies_in(files), len(files["policy.pt"])


def load_weights(policy: ActorCritic, weights: Any, where: str = "policy.pt") -> None:
    """Load weights into a policy. Raises TrainingError if they are not those of such a policy."""
    own = policy.state_dict()
    if not isinstance(weights, dict) or weights.keys() != own.keys():
        raise TrainingError(f"{where} of the checkpoint does not hold the weights of this policy")
    for name, weight in own.items():
        check_like(weights[name], weight, f"{name} in {where}")
    if name := wrong_weight(weights):
        raise TrainingError(f"{name} in {where} of the checkpoint has numbers beyond {HEAVIEST}, or that are none")
    policy.load_state_dict(weights)


def wrong_weight(weights: Mapping[str, Tensor]) -> str:
    """The name of the first weights that are NaN or beyond HEAVIEST; "" if all are as they should be."""
    return next((name for name, weight in weights.items() if not (weight.abs() <= HEAVIEST).all()), "")


def check_like(given: Any, own: Tensor, name: str) -> None:
    """Raise TrainingError unless `given` is a tensor of the same shape and type."""
    if not isinstance(given, Tensor) or given.shape != own.shape or given.dtype != own.dtype:
        found = f"{given.dtype} {tuple(given.shape)}" if isinstance(given, Tensor) else "no tensor"
        raise TrainingError(f"{name} of the checkpoint is {found}: {own.dtype} {tuple(own.shape)} is needed")


def check_state(given: Any, like: Any, name: str) -> None:
    """Raise TrainingError unless `given` has the same names, with finite tensors of the same shapes and types."""
    if not isinstance(like, dict):
        check_like(given, like, f"{name} in rest.pt")
        if not torch.isfinite(given).all():
            raise TrainingError(f"{name} in rest.pt of the checkpoint is not finite")
    elif not isinstance(given, dict) or given.keys() != like.keys():
        raise TrainingError(f"{name} in rest.pt of the checkpoint is not what a run goes on with")
    else:
        for key, value in like.items():
            check_state(given[key], value, f"{name} {key}")


def tensor_bytes(content: Any) -> bytes:
    """What torch.save writes for the content, as bytes."""
    buffer = io.BytesIO()
    torch.save(content, buffer, pickle_protocol=2)  # whose instructions safe_torch knows, whatever torch's default is
    return buffer.getvalue()


def load_tensors(files: dict[str, bytes], name: str) -> Any:
    """Load what torch.save has written into one of the files. Raises TrainingError."""
    try:
        return safe_torch.load_tensors(files[name])
    except safe_torch.BROKEN as error:
        raise TrainingError(f"{name} of the checkpoint is not what torch.save writes: {error}") from None

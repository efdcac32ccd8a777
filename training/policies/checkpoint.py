"""Checkpoints: one .zip file with everything that a run needs to continue as if it had never stopped.

It contains policy.safetensors (see policy_file), rest.safetensors (the further state of a run: tensors, with all
other values as JSON in the metadata), worlds.npz (see envs.snapshots), and run.json (see policy_file), which describes
the game and the settings of training. Nothing in it is executed.
"""

import json
import zipfile
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.storage import inputs
from outlast.envs.storage.outputs import atomic_write

from ..base import policy_file
from ..base.errors import TrainingError
from ..base.observation_layout import Array
from ..base.policy_file import WEIGHTS
from .policy import Networks

REST = "rest.safetensors"
WORLDS = "worlds.npz"
HEAVIEST = 1000  # the largest weight: with larger ones sums may overflow to NaN, which allows no choice of an action


def write_checkpoint(path: Path, files: dict[str, bytes]) -> None:
    """Write a checkpoint, completely or not at all."""
    with atomic_write(path) as place, zipfile.ZipFile(place, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)


def read_checkpoint(path: Path, names: Collection[str] = (WEIGHTS, REST, WORLDS)) -> dict[str, bytes]:
    """Read files of a checkpoint. run.json is checked here, the others when they are used. Raises TrainingError."""
    return policy_file.read_checkpoint(path, names, policy_file.NEEDED)[1]


def header_of(files: dict[str, bytes]) -> policy_file.Header:
    """Return run.json of a checkpoint, with an empty plan if it was not made by a run."""
    return {"plan": {}, **policy_file.parse_header(Path(policy_file.RUN_JSON), files[policy_file.RUN_JSON], ())}


def check_fields(header: policy_file.Header, env: SurvivalVectorEnv) -> None:
    """Raise TrainingError if the fields of observations differ from those in training."""
    for key, fields in header["fields"].items():
        known, here = ", ".join(fields), ", ".join(env.fields.get(key, {}))
        if known != here:
            raise TrainingError(f"the policy was trained on rows '{key}' of {known}; here they are {here or 'absent'}")


def policies_in(files: dict[str, bytes]) -> list[dict[str, Tensor]]:
    """Return the weights of each policy of a checkpoint by name, unchecked. Raises TrainingError."""
    return _as_tensors(policy_file.parse_weights(files[WEIGHTS], f"{WEIGHTS} of the checkpoint"))


def policies_content(policies: Sequence[Mapping[str, Tensor]]) -> bytes:
    """Return the content of WEIGHTS from the weights of each policy by name."""
    return policy_file.weights_content([{name: _as_array(values) for name, values in own.items()} for own in policies])


def read_policies(path: Path) -> tuple[policy_file.Header, list[dict[str, Tensor]]]:
    """Return run.json, and the weights of each policy by name, unchecked. Raises TrainingError."""
    header, policies = policy_file.read(path)
    return {"plan": {}, **header}, _as_tensors(policies)


def load_weights(policy: Networks, weights: Any, where: str = WEIGHTS) -> None:
    """Load weights into a policy. Raises TrainingError if they do not fit the policy."""
    own = policy.state_dict()
    if not isinstance(weights, dict) or weights.keys() != own.keys():
        raise TrainingError(f"{where} of the checkpoint does not hold the weights of this policy")
    for name, weight in own.items():
        check_like(weights[name], weight, f"{name} in {where}")
    if name := wrong_weight(weights):
        raise TrainingError(f"{name} in {where} of the checkpoint has numbers that are NaN or beyond {HEAVIEST}")
    policy.load_state_dict(weights)


def wrong_weight(weights: Mapping[str, Tensor]) -> str:
    """Return the name of the first weights that are NaN or beyond HEAVIEST; "" without any."""
    return next((name for name, weight in weights.items() if not (weight.abs() <= HEAVIEST).all()), "")


def check_like(given: Any, own: Tensor, name: str) -> None:
    """Raise TrainingError unless `given` is a tensor of the same shape and type."""
    if not isinstance(given, Tensor) or given.shape != own.shape or given.dtype != own.dtype:
        found = f"{given.dtype} {tuple(given.shape)}" if isinstance(given, Tensor) else "no tensor"
        raise TrainingError(f"{name} of the checkpoint is {found}: it must be {own.dtype} {tuple(own.shape)}")


def check_state(given: Any, like: Any, name: str = "") -> None:
    """Raise TrainingError unless a tree is like another (None: any value). name: Its place in messages."""
    where = f"{name} in {REST}" if name else REST
    if isinstance(given, list) and isinstance(like, list):
        given, like = dict(enumerate(given)), dict(enumerate(like))
    if isinstance(like, Tensor):
        check_like(given, like, where)
        if not torch.isfinite(given).all():
            raise TrainingError(f"{where} of the checkpoint is not finite")
    elif isinstance(like, dict) and isinstance(given, dict) and given.keys() == like.keys():
        for key, value in like.items():
            check_state(given[key], value, f"{name} {key}".strip())
    elif not (like is None or (isinstance(like, int) and policy_file.is_count(given)) or isinstance(like, str)):
        raise TrainingError(f"{where} of the checkpoint does not fit the run")


def tree_content(tree: dict[str, Any]) -> bytes:
    """Return a file with a tree of dicts and lists: tensors, called "learners/0/minibatches", and JSON."""
    tensors = dict[str, Array]()
    return policy_file.tensors_content(tensors, json.dumps(_without_tensors(tree, "", tensors)))


def load_tree(files: dict[str, bytes], name: str) -> Any:
    """Return the tree in one of the files, see `tree_content`, unchecked. Raises TrainingError."""
    wrong = f"{name} of the checkpoint does not fit the run"
    try:
        text, tensors = policy_file.parse_tensors(files[name])
        tree = inputs.parse_json(text)
    except inputs.BROKEN_JSON as error:
        raise TrainingError(f"{wrong}: {error}") from error
    for place, values in tensors.items():
        *path, last = place.split("/")
        try:
            node = tree
            for key in path:
                node = node[int(key) if isinstance(node, list) else key]
            if not isinstance(node, dict) or last in node:
                raise KeyError(last)
            node[last] = torch.from_numpy(values)
        except (LookupError, TypeError, ValueError) as error:
            raise TrainingError(f"{wrong}: its tensor {place:.80} has no place") from error
    return tree


def _without_tensors(node: Any, place: str, tensors: dict[str, Array]) -> Any:
    """Return a part of a tree without its tensors, and add these by their places."""
    if isinstance(node, list):
        return [_without_tensors(each, f"{place}{k}/", tensors) for k, each in enumerate(node)]
    if not isinstance(node, dict):
        return node
    own = {name: each for name, each in node.items() if isinstance(each, Tensor)}
    tensors |= {f"{place}{name}": _as_array(each) for name, each in own.items()}
    others = node.keys() - own.keys()
    return {name: _without_tensors(node[name], f"{place}{name}/", tensors) for name in node if name in others}


def _as_array(tensor: Tensor) -> Array:
    return tensor.detach().cpu().numpy()


def _as_tensors(policies: Sequence[Mapping[str, Array]]) -> list[dict[str, Tensor]]:
    return [{name: torch.from_numpy(values) for name, values in own.items()} for own in policies]

"""Checkpoints: one .zip file with everything that a run needs to go on as if it had never stopped.

In it: policy.pt and rest.pt (tensors and numbers only, see tensors), worlds.npz (envs.state), and run.json (see
header), which says what the policy was trained in and how. Nothing in it is executed.
"""

import io
import json
import tempfile
import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from outlast.envs.errors import TrainingError
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.envs.snapshots import state
from outlast.envs.snapshots.state import State
from outlast.envs.storage.atomic_write import atomic_write

from . import header, tensors
from .policy import Policy
from .ppo import SharedPPO

HEAVIEST = 1000  # weight: with larger ones sums may overflow, and what is not a number chooses no action
LAST = 2**53  # updates, which are counted in float32
TWISTER = 5056, 624  # bytes of the state of PyTorch's generator of random numbers, numbers that it draws at once
NAME = "steps_{:010d}.zip"


def capture(model: SharedPPO, about: dict[str, Any]) -> dict[str, bytes]:
    """The files of a checkpoint, in memory. about: what run.json says besides."""
    rest = {
        "optimiser": model.policy.optimizer.state_dict(),
        "random": {"actions": model.generator.get_state(), "minibatches": model.shuffler.get_state()},
        "updates": model._n_updates,  # Stable-Baselines3 has no other name for it
    }
    told = {"version": header.VERSION, "steps": model.num_timesteps, "preset": model.preset.name, **about}
    told["scenario"] = fingerprint(model.core.scenario)
    told["observations"] = model.policy.layout.shapes
    told["actions"] = [int(size) for size in model.core.action_sizes]
    return {
        header.NAME: json.dumps(told, indent=1).encode(),
        "policy.pt": _tensors(model.policy.state_dict()),
        "rest.pt": _tensors(rest),
        "worlds.npz": _worlds(model.core.get_state()),
    }


def write(path: Path, files: dict[str, bytes]) -> None:
    """Write a checkpoint; whole or not at all."""
    with atomic_write(path) as place, zipfile.ZipFile(place, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)


def read(path: Path, names: Collection[str] = ("policy.pt", "rest.pt", "worlds.npz")) -> dict[str, bytes]:
    """The files of a checkpoint; run.json is sound, the others are checked when they are used. Raises TrainingError."""
    needed = ("version", "steps", "observations", "actions", "preset", "scenario")
    return header.read(path, names, needed)[1]


def about(files: dict[str, bytes]) -> dict[str, Any]:
    """What run.json says; a plan of nothing if it does not say which."""
    told: dict[str, Any] = {"plan": {}, **json.loads(files[header.NAME])}
    return told


def restore(model: SharedPPO, files: dict[str, bytes]) -> None:
    """Make a new model of the same preset go on from a checkpoint.

    Raises StateError if it is of another scenario, TrainingError if what is in it is of something else, or broken.
    """
    rest, random = _loaded(files, "rest.pt"), {"actions": model.generator, "minibatches": model.shuffler}
    if not isinstance(rest, dict) or type(rest.get("updates")) is not int:
        raise TrainingError("rest.pt of the checkpoint is not what a run goes on with")
    for name, generator in random.items():
        _check_random(generator, _inside(rest, "random", name))
    optimiser = _optimiser(model.policy, _inside(rest, "optimiser", "state"))
    model.start()
    model.core.set_state(state.read(io.BytesIO(files["worlds.npz"]), "worlds.npz of the checkpoint"))
    fill(model.policy, files)
    model.policy.optimizer.load_state_dict(optimiser)
    for name, generator in random.items():
        generator.set_state(rest["random"][name].clone())
    model.num_timesteps, model._n_updates = about(files)["steps"], rest["updates"]


def fill(policy: Policy, files: dict[str, bytes]) -> None:
    """Give a policy the weights of a checkpoint. Raises TrainingError if they are not those of such a policy."""
    weights, own = _loaded(files, "policy.pt"), policy.state_dict()
    if not isinstance(weights, dict) or weights.keys() != own.keys():
        raise TrainingError("policy.pt of the checkpoint does not hold the weights of this policy")
    for name, weight in own.items():
        _check_like(weights[name], weight, f"{name} in policy.pt")
        if not (weights[name].abs() <= HEAVIEST).all():  # NaN, too
            raise TrainingError(
                f"{name} in policy.pt of the checkpoint has numbers beyond {HEAVIEST}, or that are none"
            )
    policy.load_state_dict(weights)


def _optimiser(policy: Policy, moments: Any) -> dict[str, Any]:
    """What the policy's optimiser goes on with, given the moments of all of its parameters (or of none yet).

    Its numbers are its own: the learning rate is set ahead of each update, the others are the same for all policies.
    """
    parameters = list(policy.parameters())
    if not isinstance(moments, dict) or moments.keys() not in (set(), set(range(len(parameters)))):
        raise TrainingError("rest.pt of the checkpoint is not of an optimiser of this policy")
    for k, kept in moments.items():
        if not isinstance(kept, dict) or kept.keys() != {"step", "exp_avg", "exp_avg_sq"}:
            raise TrainingError("rest.pt of the checkpoint is not of an optimiser of this policy")
        for name, value in kept.items():
            like = parameters[k] if name != "step" else torch.zeros(())
            _check_like(value, like, f"{name} of parameter {k} in rest.pt")
            if not torch.isfinite(value).all():
                raise TrainingError(f"{name} of parameter {k} in rest.pt of the checkpoint is not finite")
        if not 0 <= float(kept["step"]) <= LAST:
            raise TrainingError(f"step of parameter {k} in rest.pt of the checkpoint is {float(kept['step'])}")
    copies = {k: {name: value.clone() for name, value in kept.items()} for k, kept in moments.items()}
    return {"state": copies, "param_groups": policy.optimizer.state_dict()["param_groups"]}


def _check_like(given: Any, own: Tensor, name: str) -> None:
    if not isinstance(given, Tensor) or given.shape != own.shape or given.dtype != own.dtype:
        found = f"{given.dtype} {tuple(given.shape)}" if isinstance(given, Tensor) else "no tensor"
        raise TrainingError(f"{name} of the checkpoint is {found}: {own.dtype} {tuple(own.shape)} is needed")


def _check_random(generator: torch.Generator, given: Any) -> None:
    """PyTorch believes where in its table a generator is; that place, and what is left from there, lie in it."""
    _check_like(given, generator.get_state(), "a random generator in rest.pt")
    size, count = TWISTER
    if len(given) == size:
        left, place = (int.from_bytes(bytes(given[a:b].tolist()), "little") for a, b in ((8, 12), (16, 24)))
        if not 1 <= left <= count or place + left > count + 1:
            raise TrainingError("a random generator in rest.pt of the checkpoint is in a state that cannot be")


def _inside(rest: dict[str, Any], *names: str) -> Any:
    found: Any = rest
    for name in names:
        found = found.get(name) if isinstance(found, dict) else None
    return found


def newest(folder: Path) -> Path:
    """The checkpoint with the most steps in the folder of a run."""
    found = sorted(folder.glob(NAME.format(0).replace("0" * 10, "*")))
    if not found:
        raise TrainingError(f"there is nothing to resume in {folder}")
    return found[-1]


def _tensors(content: Any) -> bytes:
    buffer = io.BytesIO()
    torch.save(content, buffer)
    return buffer.getvalue()


def _loaded(files: dict[str, bytes], name: str) -> Any:
    try:
        return tensors.load(files[name])
    except tensors.BROKEN as error:
        raise TrainingError(f"{name} of the checkpoint is not what torch.save writes: {error}") from None


def _worlds(worlds: State) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "worlds.npz")
        worlds.save(path)
        return path.read_bytes()

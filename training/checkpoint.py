"""Checkpoints: one .zip file with everything that a run needs to go on as if it had never stopped.

In it: policy.pt and rest.pt (tensors and numbers only, read without executing anything), worlds.npz (envs.state), and
run.json, which says what the policy was trained in and how.
"""

import io
import json
import tempfile
import zipfile
from pathlib import Path
from typing import Any

import torch

from outlast.envs.drafts import draft
from outlast.envs.errors import TrainingError
from outlast.envs.state import State, identity

from .policy import Policy
from .ppo import SharedPPO

VERSION = 1
NAME = "steps_{:010d}.zip"


def capture(model: SharedPPO, about: dict[str, Any]) -> dict[str, bytes]:
    """The files of a checkpoint, in memory. about: what run.json says besides."""
    rest = {
        "optimiser": model.policy.optimizer.state_dict(),
        "random": {"actions": model.generator.get_state(), "minibatches": model.shuffler.get_state()},
        "updates": model._n_updates,  # Stable-Baselines3 has no other name for it
    }
    header = {"version": VERSION, "steps": model.num_timesteps, "preset": model.preset.name, **about}
    header["scenario"] = identity(model.core.scenario)
    header["observations"] = model.policy.layout.shapes
    header["actions"] = [int(size) for size in model.core.action_sizes]
    return {
        "run.json": json.dumps(header, indent=1).encode(),
        "policy.pt": _tensors(model.policy.state_dict()),
        "rest.pt": _tensors(rest),
        "worlds.npz": _worlds(model.core.get_state()),
    }


def write(path: Path, files: dict[str, bytes]) -> None:
    """Write a checkpoint; whole or not at all."""
    with draft(path) as place, zipfile.ZipFile(place, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)


def read(path: Path) -> dict[str, bytes]:
    """The files of a checkpoint. Raises TrainingError for anything else."""
    try:
        with zipfile.ZipFile(path) as archive:
            files = {name: archive.read(name) for name in ("run.json", "policy.pt", "rest.pt", "worlds.npz")}
    except FileNotFoundError as error:
        raise TrainingError(f"there is no checkpoint {path}") from error
    except (zipfile.BadZipFile, KeyError, OSError) as error:
        raise TrainingError(f"{path} is not a checkpoint: {error}") from error
    version = about(files).get("version")
    if version != VERSION:
        raise TrainingError(f"{path} has version {version}: {VERSION} is needed")
    if missing := {"observations", "actions", "preset", "scenario"} - about(files).keys():
        raise TrainingError(f"{path} is not a checkpoint: it does not say its {', '.join(sorted(missing))}")
    return files


def about(files: dict[str, bytes]) -> dict[str, Any]:
    """What run.json says."""
    header: dict[str, Any] = json.loads(files["run.json"])
    return header


def restore(model: SharedPPO, files: dict[str, bytes]) -> None:
    """Make a new model of the same preset go on from a checkpoint. Raises StateError if it is of another scenario."""
    model.start()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "worlds.npz")
        path.write_bytes(files["worlds.npz"])
        model.core.set_state(State.load(path))
    rest = _loaded(files["rest.pt"])
    fill(model.policy, files)
    model.policy.optimizer.load_state_dict(rest["optimiser"])
    model.generator.set_state(rest["random"]["actions"])
    model.shuffler.set_state(rest["random"]["minibatches"])
    model.num_timesteps, model._n_updates = about(files)["steps"], rest["updates"]


def fill(policy: Policy, files: dict[str, bytes]) -> None:
    """Give a policy the weights of a checkpoint."""
    policy.load_state_dict(_loaded(files["policy.pt"]))


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


def _loaded(content: bytes) -> Any:
    return torch.load(io.BytesIO(content), weights_only=True, map_location="cpu")


def _worlds(state: State) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "worlds.npz")
        state.save(path)
        return path.read_bytes()

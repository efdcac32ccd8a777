"""Checkpoints: one .zip file with everything that a run needs to go on as if it had never stopped.

In it: policy.pt and rest.pt (tensors and numbers only, see safe_torch), worlds.npz (see envs.snapshots), and run.json
(see run_header): what the policy was trained in, and how. Nothing in it is executed.
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

from outlast.envs.core.vector_env import SurvivalVectorEnv
from outlast.envs.scenarios.fingerprint import fingerprint
from outlast.envs.snapshots import state
from outlast.envs.snapshots.state import State
from outlast.envs.storage.atomic_write import atomic_write

from . import run_header, safe_torch
from .errors import TrainingError
from .learner import Learner
from .observation_layout import Array, ObservationLayout, earlier_scales, field_table, scales
from .policy import ActorCritic
from .trainer import Trainer

HEAVIEST = 1000  # weight: with larger ones sums may overflow, and what is not a number chooses no action
LAST = 2**53  # updates, which are counted in float32
DEAREST = 1e30  # reward, or sum of rewards: float32, also when it is squared in float64
GENERATOR = 5056, 624  # bytes of the state of PyTorch's generator of random numbers, numbers that it draws at once
NAME = "steps_{:010d}.zip"


def capture(trainer: Trainer, header: dict[str, Any]) -> dict[str, bytes]:
    """The files of a checkpoint, in memory. header: more for run.json, see TrainingConfig.header."""
    rest = {
        "optimiser": trainer.learner.optimizer.state_dict(),
        "random": {"actions": trainer.generator.get_state(), "minibatches": trainer.learner.generator.get_state()},
        "updates": trainer.learner.epochs,
        "rewards": trainer.collector.scale.state(),
    }
    first = {"version": run_header.VERSION, "steps": trainer.steps, "preset": trainer.preset.name}
    last = {
        "scenario": fingerprint(trainer.env.scenario),
        "observations": trainer.layout.shapes,
        "fields": field_table(trainer.env.fields),
        "actions": [int(size) for size in trainer.env.action_sizes],
    }
    return {
        run_header.NAME: json.dumps(first | header | last, indent=1).encode(),
        "policy.pt": _tensor_bytes(trainer.policy.state_dict()),
        "rest.pt": _tensor_bytes(rest),
        "worlds.npz": _state_bytes(trainer.env.get_state()),
    }


def write_checkpoint(path: Path, files: dict[str, bytes]) -> None:
    """Write a checkpoint; whole or not at all."""
    with atomic_write(path) as place, zipfile.ZipFile(place, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)


def read_checkpoint(path: Path, names: Collection[str] = ("policy.pt", "rest.pt", "worlds.npz")) -> dict[str, bytes]:
    """The files of a checkpoint; run.json is valid, the others are checked when they are used. Raises TrainingError."""
    needed = ("version", "steps", "observations", "actions", "preset", "scenario")
    return run_header.read_checkpoint(path, names, needed)[1]


def header_of(files: dict[str, bytes]) -> run_header.Header:
    """run.json of a checkpoint, with an empty plan if there is none."""
    return {"plan": {}, **run_header.parse_header(Path(run_header.NAME), files[run_header.NAME], ())}


def restore(trainer: Trainer, files: dict[str, bytes]) -> None:
    """Make a new trainer of the same preset go on from a checkpoint.

    Raises StateError if it is of another scenario, TrainingError if what is in it is of something else, or broken.
    """
    header, learner = header_of(files), trainer.learner
    check_fields(header, trainer.env)
    factors = recorded_scales(header, trainer.layout)
    rest, random = _load(files, "rest.pt"), {"actions": trainer.generator, "minibatches": learner.generator}
    if not isinstance(rest, dict) or type(rest.get("updates")) is not int:
        raise TrainingError("rest.pt of the checkpoint is not what a run goes on with")
    for name, generator in random.items():
        _check_random(generator, _get(rest, "random", name))
    optimiser = _optimiser(learner, _get(rest, "optimiser", "state"))
    if "rewards" in rest:
        _check_rewards(trainer, rest["rewards"])
    trainer.env.set_state(state.read(io.BytesIO(files["worlds.npz"]), "worlds.npz of the checkpoint"))
    load_weights(trainer.policy, files)
    trainer.policy.rescale(factors)
    learner.optimizer.load_state_dict(optimiser)
    for name, generator in random.items():
        generator.set_state(rest["random"][name].clone())
    if "rewards" in rest:  # files of outlast 0.1 have none, and scale none
        trainer.collector.scale.restore(rest["rewards"])
    trainer.steps, learner.epochs = header["steps"], rest["updates"]


def _check_rewards(trainer: Trainer, given: Any) -> None:
    """Check what rewards are divided by. Raises TrainingError."""
    own = trainer.collector.scale.state()
    if not isinstance(given, dict) or given.keys() != own.keys():
        raise TrainingError("rest.pt of the checkpoint has rewards that no run has")
    for name, like in own.items():
        _check_like(given[name], like, f"{name} of rewards in rest.pt")
        low, high = (0.0, DEAREST**2) if name in ("count", "variance") else (-DEAREST, DEAREST)
        if not ((given[name] >= low) & (given[name] <= high)).all():  # NaN, too
            raise TrainingError(f"{name} of rewards in rest.pt of the checkpoint is beyond {low:g} to {high:g}")


def check_fields(header: run_header.Header, env: SurvivalVectorEnv) -> None:
    """TrainingError if rows of observations hold other fields here than in training. Earlier files do not say."""
    for key, fields in header.get("fields", {}).items():
        known, here = ", ".join(fields), ", ".join(env.fields.get(key, {}))
        if known != here:
            raise TrainingError(
                f"the policy was trained on rows '{key}' of {known}; here they are {here or 'not there'}"
            )


def recorded_scales(header: run_header.Header, layout: ObservationLayout) -> tuple[Array, Array]:
    """The scales of inputs in training, float32 (own,) and (numbers of all kinds,). Raises TrainingError."""
    if "fields" in header:
        try:
            return scales(layout, header["fields"])
        except ValueError as error:
            raise TrainingError(f"run.json has observations that no scenario has: {error}") from None
    try:
        own, kinds = earlier_scales(layout, header["scenario"]["numbers"])
    except (KeyError, TypeError, ValueError, ArithmeticError):
        raise TrainingError("run.json has numbers that no scenario has") from None
    if (len(own), len(kinds)) != (layout.own, sum(kind.features for kind in layout.kinds)):
        raise TrainingError("run.json has observations that no scenario has")
    return own, kinds


def load_weights(policy: ActorCritic, files: dict[str, bytes]) -> None:
    """Load the weights of a checkpoint into a policy. Raises TrainingError if they are not those of such a policy."""
    weights, own = _load(files, "policy.pt"), policy.state_dict()
    if not isinstance(weights, dict) or weights.keys() != own.keys():
        raise TrainingError("policy.pt of the checkpoint does not hold the weights of this policy")
    for name, weight in own.items():
        _check_like(weights[name], weight, f"{name} in policy.pt")
        if not (weights[name].abs() <= HEAVIEST).all():  # NaN, too
            raise TrainingError(
                f"{name} in policy.pt of the checkpoint has numbers beyond {HEAVIEST}, or that are none"
            )
    policy.load_state_dict(weights)


def _optimiser(learner: Learner, moments: Any) -> dict[str, Any]:
    """The state that the learner's optimiser goes on with, given the moments of all its parameters (or of none yet).

    Its numbers are its own: the learning rate is set ahead of each update, the others are the same for all policies.
    """
    parameters = learner.parameters
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
    return {"state": copies, "param_groups": learner.optimizer.state_dict()["param_groups"]}


def _check_like(given: Any, own: Tensor, name: str) -> None:
    if not isinstance(given, Tensor) or given.shape != own.shape or given.dtype != own.dtype:
        found = f"{given.dtype} {tuple(given.shape)}" if isinstance(given, Tensor) else "no tensor"
        raise TrainingError(f"{name} of the checkpoint is {found}: {own.dtype} {tuple(own.shape)} is needed")


def _check_random(generator: torch.Generator, given: Any) -> None:
    """Check the position in the generator's table and the count left in it, which PyTorch takes as they are."""
    _check_like(given, generator.get_state(), "a random generator in rest.pt")
    size, count = GENERATOR
    if len(given) == size:
        left, place = (int.from_bytes(bytes(given[a:b].tolist()), "little") for a, b in ((8, 12), (16, 24)))
        if not 1 <= left <= count or place + left > count + 1:
            raise TrainingError("a random generator in rest.pt of the checkpoint is in a state that cannot be")


def _get(rest: dict[str, Any], *names: str) -> Any:
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


def _tensor_bytes(content: Any) -> bytes:
    buffer = io.BytesIO()
    torch.save(content, buffer)
    return buffer.getvalue()


def _load(files: dict[str, bytes], name: str) -> Any:
    try:
        return safe_torch.load_tensors(files[name])
    except safe_torch.BROKEN as error:
        raise TrainingError(f"{name} of the checkpoint is not what torch.save writes: {error}") from None


def _state_bytes(worlds: State) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "worlds.npz")
        worlds.save(path)
        return path.read_bytes()

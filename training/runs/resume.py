"""The content of checkpoints, beside the policies, with which a run continues as if it had never stopped."""

import io
import tempfile
from pathlib import Path
from typing import Any

import torch

from outlast.envs.snapshots import state
from outlast.envs.snapshots.state import State

from ..base.errors import TrainingError
from ..base.observation_layout import scales
from ..policies import checkpoint
from ..policies.checkpoint import REST, WORLDS, check_state
from ..ppo.learner import Learner
from ..ppo.trainer import Trainer

LAST = 2**53  # maximum updates of an optimiser, which counts them in float32
GENERATOR = 5056, 624  # bytes of the state of PyTorch's generator of random numbers, numbers drawn at once
WRONG = f"{REST} of the checkpoint does not fit the run"


def capture(trainer: Trainer, header: dict[str, Any]) -> dict[str, bytes]:
    """Return the files of a checkpoint, in memory. header: Further entries of run.json, see TrainingConfig.header.

    All processes that train together must call it, although only the first one needs the result.
    """
    worlds, lanes = trainer.captured()
    rest = checkpoint.tree_content(_rest(trainer, lanes))
    return {**trainer.policy_files(header), REST: rest, WORLDS: _state_bytes(worlds)}


def _rest(trainer: Trainer, lanes: dict[str, Any]) -> dict[str, Any]:
    """Return the state of a run besides its policies and worlds, as a tree. lanes: See Trainer.captured."""
    rest = {
        "learners": [
            {
                "optimiser": {str(k): moments for k, moments in enumerate(learner.optimizer.moments)},
                "minibatches": learner.generator.get_state(),
                "epochs": learner.epochs,
            }
            for learner in trainer.learners
        ],
        "updates": trainer.updates,
        "rewards": trainer.collector.scale.state(),
        "lane": {name: torch.from_numpy(values) for name, values in lanes.items()},
        "opponents": trainer.opponents.state(),
    }
    return rest if trainer.curriculum is None else rest | {"levels": trainer.curriculum.state()}


def restore(trainer: Trainer, files: dict[str, bytes]) -> None:
    """Restore a new trainer of the same config from a checkpoint.

    Raises StateError if it is of another scenario, TrainingError if its content does not fit the trainer or is broken.
    """
    header, rest = checkpoint.header_of(files), checkpoint.load_tree(files, REST)
    weights = checkpoint.policies_in(files)
    checkpoint.check_fields(header, trainer.env)
    factors = scales(trainer.layout, header["fields"])
    if len(weights) != len(trainer.learners):
        raise TrainingError(f"the checkpoint has {len(weights)} policies, but the run {len(trainer.learners)}")
    check_state(rest, _rest(trainer, trainer.captured_lanes()) | {"opponents": None})  # checked by the pool
    for learner, given in zip(trainer.learners, rest["learners"], strict=True):
        _check_learner(learner, given)
    worlds, mine = state.read(io.BytesIO(files[WORLDS]), f"{WORLDS} of the checkpoint"), trainer.lane.rows
    trainer.env.set_state(worlds[mine] if len(worlds) == trainer.worlds else worlds)
    for learner, given, own in zip(trainer.learners, rest["learners"], weights, strict=True):
        checkpoint.load_weights(learner.policy, own)
        learner.policy.rescale(factors)
        learner.optimizer.restore([given["optimiser"][str(k)] for k in range(len(learner.parameters))])
        learner.generator.set_state(given["minibatches"].clone())
        learner.epochs = given["epochs"]
    trainer.updates = rest["updates"]
    trainer.collector.scale.restore(rest["rewards"])
    past = rest["opponents"].get("past") if isinstance(rest["opponents"], dict) else None
    each = sum(weight.nbytes for policy in trainer.policies for weight in policy.state_dict().values())
    if isinstance(past, dict) and len(past) * each > len(files[REST]):
        raise TrainingError(f"{WRONG}: it is too small for {len(past)} past selves")
    trainer.opponents.restore(rest["opponents"], trainer.policies, header["plan"].get("opponents", ""))
    if trainer.curriculum is not None:
        trainer.curriculum.restore(rest["levels"])
    trainer.lane.restore({name: values.numpy()[mine] for name, values in rest["lane"].items()})
    trainer.steps = header["steps"]


def _state_bytes(worlds: State) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "worlds.npz")
        worlds.save(path)
        return path.read_bytes()


def _check_learner(learner: Learner, given: dict[str, Any]) -> None:
    """Check the steps of the optimiser, and the generator's place in its table, both unchecked by PyTorch."""
    for k, moments in given["optimiser"].items():
        if not 0 <= float(moments["step"]) <= LAST:
            raise TrainingError(f"step of parameter {k} in {REST} of the checkpoint is {float(moments['step'])}")
    size, count = GENERATOR
    if len(found := bytes(given["minibatches"].tolist())) == size:
        left, place = (int.from_bytes(found[a:b], "little") for a, b in ((8, 12), (16, 24)))
        if not 1 <= left <= count or place + left > count + 1:
            raise TrainingError(f"a random generator in {REST} of the checkpoint is in an invalid state")

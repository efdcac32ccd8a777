"""The content of checkpoints, beside the policies, with which a run goes on as if it had never stopped."""

import io
import tempfile
from pathlib import Path
from typing import Any

import torch

from outlast.envs.snapshots import state
from outlast.envs.snapshots.state import State

from ..base.errors import TrainingError
from ..base.observation_layout import scales
from ..base.run_header import is_count
from ..policies import checkpoint
from ..policies.checkpoint import REST, WORLDS, check_like, check_state
from ..ppo.learner import Learner
from ..ppo.trainer import Trainer

LAST = 2**53  # the most updates of an optimiser, which counts them in float32
GENERATOR = 5056, 624  # bytes of the state of PyTorch's generator of random numbers, numbers that it draws at once
WRONG = f"{REST} of the checkpoint is not what a run goes on with"


def capture(trainer: Trainer, header: dict[str, Any]) -> dict[str, bytes]:
    """Make the files of a checkpoint, in memory. header: Further entries of run.json, see TrainingConfig.header.

    All processes that train together must call it, though only the first one needs the result.
    """
    worlds, lanes = trainer.captured()
    rest = {
        "learners": [_learner_state(learner) for learner in trainer.learners],
        "updates": trainer.updates,
        "rewards": trainer.collector.scale.state(),
        "lane": {name: torch.from_numpy(values) for name, values in lanes.items()},
        "opponents": trainer.opponents.state(),
    }
    if trainer.curriculum is not None:
        rest["levels"] = trainer.curriculum.state()
    return {**trainer.policy_files(header), REST: checkpoint.tree_content(rest), WORLDS: _state_bytes(worlds)}


def restore(trainer: Trainer, files: dict[str, bytes]) -> None:
    """Make a new trainer of the same config go on from a checkpoint.

    Raises StateError if it is of another scenario, TrainingError if its content does not fit the trainer or is broken.
    """
    header, rest, weights = (
        checkpoint.header_of(files),
        checkpoint.load_tree(files, REST),
        checkpoint.policies_in(files),
    )
    checkpoint.check_fields(header, trainer.env)
    factors = scales(trainer.layout, header["fields"])
    names = {"learners", "updates", "rewards", "lane", "opponents"} | (
        set() if trainer.curriculum is None else {"levels"}
    )
    if not isinstance(rest, dict) or rest.keys() != names or not isinstance(learners := rest["learners"], list):
        raise TrainingError(WRONG)
    if not len(learners) == len(weights) == len(trainer.learners):
        raise TrainingError(f"the checkpoint has {len(weights)} policies; here are {len(trainer.learners)}")
    optimisers = [_checked_learner(*pair) for pair in zip(trainer.learners, learners, strict=True)]
    trainer.restore_worlds(state.read(io.BytesIO(files[WORLDS]), f"{WORLDS} of the checkpoint"))
    for learner, given, own, optimiser in zip(trainer.learners, learners, weights, optimisers, strict=True):
        checkpoint.load_weights(learner.policy, own)
        learner.policy.rescale(factors)
        learner.optimizer.restore(optimiser)
        learner.generator.set_state(given["minibatches"].clone())
        learner.epochs = given["epochs"]
    if not is_count(rest["updates"]):
        raise TrainingError(WRONG)
    trainer.updates = rest["updates"]
    trainer.collector.scale.restore(rest["rewards"])
    past = rest["opponents"].get("past") if isinstance(rest["opponents"], dict) else None
    each = sum(weight.nbytes for policy in trainer.policies for weight in policy.state_dict().values())
    if isinstance(past, dict) and len(past) * each > len(files[REST]):
        raise TrainingError(f"{WRONG}: it is too small for {len(past)} past selves")
    trainer.opponents.restore(rest["opponents"], trainer.policies, header["plan"].get("opponents", ""))
    if trainer.curriculum is not None:
        trainer.curriculum.restore(rest["levels"])
    like = {name: torch.from_numpy(values) for name, values in trainer.captured_lanes().items()}
    check_state(rest["lane"], like, "lane")
    trainer.restore_lanes({name: values.numpy() for name, values in rest["lane"].items()})
    trainer.steps = header["steps"]


def _state_bytes(worlds: State) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "worlds.npz")
        worlds.save(path)
        return path.read_bytes()


def _learner_state(learner: Learner) -> dict[str, Any]:
    return {
        "optimiser": {str(k): moments for k, moments in enumerate(learner.optimizer.moments)},
        "minibatches": learner.generator.get_state(),
        "epochs": learner.epochs,
    }


def _checked_learner(learner: Learner, given: Any) -> list[dict[str, torch.Tensor]]:
    """The moments that the learner's optimiser goes on with; the rest of what is given is checked, too."""
    if not isinstance(given, dict) or given.keys() != {"optimiser", "minibatches", "epochs"}:
        raise TrainingError(WRONG)
    if not is_count(given["epochs"]):
        raise TrainingError(WRONG)
    _check_random(learner.generator, given["minibatches"])
    return _optimiser(learner, given["optimiser"])


def _optimiser(learner: Learner, given: Any) -> list[dict[str, torch.Tensor]]:
    """The moments that the learner's optimiser goes on with, those of all its parameters in order."""
    wrong = f"{REST} of the checkpoint is not of an optimiser of this policy"
    if not isinstance(given, dict) or given.keys() != {str(k) for k in range(len(learner.parameters))}:
        raise TrainingError(wrong)
    for k, moments in given.items():
        like = learner.optimizer.moments[int(k)]
        if not isinstance(moments, dict) or moments.keys() != like.keys():
            raise TrainingError(wrong)
        for name, value in moments.items():
            check_like(value, like[name], f"{name} of parameter {k} in {REST}")
            if not torch.isfinite(value).all():
                raise TrainingError(f"{name} of parameter {k} in {REST} of the checkpoint is not finite")
        if not 0 <= float(moments["step"]) <= LAST:
            raise TrainingError(f"step of parameter {k} in {REST} of the checkpoint is {float(moments['step'])}")
    return [given[str(k)] for k in range(len(given))]


def _check_random(generator: torch.Generator, given: Any) -> None:
    """Check the position in the generator's table and the count left in it, which PyTorch does not check."""
    check_like(given, generator.get_state(), f"a random generator in {REST}")
    size, count = GENERATOR
    if len(given) == size:
        left, place = (int.from_bytes(bytes(given[a:b].tolist()), "little") for a, b in ((8, 12), (16, 24)))
        if not 1 <= left <= count or place + left > count + 1:
            raise TrainingError(f"a random generator in {REST} of the checkpoint is in a state that cannot be")

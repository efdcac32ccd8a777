"""Hostile checkpoints: nothing is executed, and everything is checked."""

import json
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from outlast import variant
from outlast.envs.errors import StateError

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")
pytest.importorskip("tensorboard", reason="needs tensorboard: outlast[train]")

from outlast.training.base import policy_file  # noqa: E402
from outlast.training.base.config import TrainingConfig  # noqa: E402
from outlast.training.base.errors import TrainingError  # noqa: E402
from outlast.training.base.policy_file import WEIGHTS  # noqa: E402
from outlast.training.policies import checkpoint  # noqa: E402
from outlast.training.policies.checkpoint import REST  # noqa: E402
from outlast.training.policies.player import Player  # noqa: E402
from outlast.training.ppo.trainer import Trainer, capture, restore  # noqa: E402
from tests.fuzz.mutations import memory_limit, zipped  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")
Files = dict[str, bytes]


@pytest.fixture(scope="module")
def trainer() -> Trainer:
    settings = {"batch_size": 16, "n_epochs": 1, "scale_rewards": True}
    return Trainer(TrainingConfig(variant("teams_3"), "scaled", worlds=2, rollout=16, settings=settings))


@pytest.fixture(scope="module")
def files(trainer: Trainer) -> Files:
    """The files of a checkpoint after one update."""
    trainer.update(trainer.collect())
    return capture(trainer, {"plan": {"seed": 0}})


# ---- tensors


NUMBERS = {"a": np.arange(100, dtype=np.float32), "b/c": np.zeros((), np.int64), "d": np.zeros((3, 0), np.uint8)}


def changed(old: str, new: str) -> bytes:
    """The content of a file whose header says something else, with its own length."""
    data = policy_file.tensors_content(NUMBERS, "text")
    size = int.from_bytes(data[:8], "little")
    header = data[8 : 8 + size].decode()
    assert old in header
    header = header.replace(old, new)
    return len(header).to_bytes(8, "little") + header.encode() + data[8 + size :]


def test_what_is_written_is_read_to_the_bit() -> None:
    """Equal content gives equal bytes, whatever the order and the strides."""
    values = np.array([np.nan, -0.0, 1e-45, np.pi], np.float32)
    tensors = NUMBERS | {"e": values, "f": np.arange(12.0).reshape(3, 4).T, "g": np.arange(3, dtype=np.int32)}
    data = policy_file.tensors_content(tensors, "text")
    assert data == policy_file.tensors_content(dict(reversed(tensors.items())), "text")
    text, found = policy_file.parse_tensors(data)
    assert text == "text"
    assert found.keys() == tensors.keys()
    for name, like in tensors.items():
        assert (found[name].dtype, found[name].shape, found[name].tobytes()) == (like.dtype, like.shape, like.tobytes())
        assert found[name].flags.writeable


HUGE = 2**40
FILES: dict[str, tuple[bytes, str]] = {
    "nothing": (b"", "header too small"),
    "a large header": (HUGE.to_bytes(8, "little") + b"{}", "header too large"),
    "a pickle": (pickle.dumps([1] * 9), "header too large"),
    "cut": (changed("F32", "F32")[:-1], "not fully covered"),
    "more": (changed("F32", "F32") + b"x", "not fully covered"),
    "a terabyte": (
        changed('100],"data_offsets":[8,408', f'{HUGE}],"data_offsets":[8,{4 * HUGE + 8}'),
        "invalid offset",
    ),
    "product": (changed("100]", f"{HUGE},{HUGE}]"), "overflow"),
    "a wide type": (changed("F32", "F64"), "invalid shape"),
    "an unused type": (changed("F32", "U32"), "a is of type uint32: float16, float32"),
    "half": (changed('F32","shape":[100', 'BF16","shape":[200'), "of type .BF16.: float16, float32"),
    "no text": (changed('{"outlast":"text"}', '{"outlast":3}'), "invalid"),
}


@pytest.mark.parametrize("what", FILES)
def test_tensors_are_no_larger_than_their_file(what: str) -> None:
    data, reason = FILES[what]
    with memory_limit(2**20), pytest.raises(ValueError, match=reason):
        policy_file.parse_tensors(data)


# ---- the state of a run


def rest_with(files: Files, change: Callable[[Any], Any]) -> Files:
    rest = checkpoint.load_tree(files, REST)
    return files | {REST: checkpoint.tree_content(change(rest) or rest)}


def moment(rest: Any, name: str, value: Any) -> None:
    rest["learners"][0]["optimiser"]["0"][name] = value


def rewards(rest: Any, **values: Any) -> None:
    rest["rewards"].update({name: torch.tensor(value, dtype=torch.float64) for name, value in values.items()})


def figures(rest: Any, values: list[float]) -> None:
    rest["opponents"]["figures"]["0"] = torch.tensor(values, dtype=torch.float64)


def past(rest: Any, number: Any, **changes: Any) -> None:
    rest["opponents"]["past"][str(number)] = {"name": "past@16", "drawn": True, "weights": []} | changes


def random_at(rest: Any, left: int, place: int) -> None:
    state = rest["learners"][0]["minibatches"].numpy()
    state[8:12], state[16:24] = np.array([left], "<i4").view(np.uint8), np.array([place], "<i8").view(np.uint8)


UNFIT = "does not fit the run"
NO_REWARDS = "rewards in rest.safetensors of the checkpoint does not fit the run"
NO_PLAYERS = "lane in rest.safetensors .* names players that do not exist"
NO_POOL = "opponents in rest.safetensors .* do not fit the run"
RESTS: dict[str, tuple[Callable[[Any], Any], str]] = {
    "nothing": (lambda rest: {"updates": 1}, UNFIT),
    "a list": (lambda rest: [1], UNFIT),
    "updates": (lambda rest: rest.update(updates="1"), UNFIT),
    "epochs": (lambda rest: rest["learners"][0].update(epochs=-1), UNFIT),
    "more": (lambda rest: rest.update(more=torch.zeros(3)), UNFIT),
    "more of opponents": (lambda rest: rest["opponents"].update(a=torch.zeros(3)), NO_POOL),
    "no moment": (lambda rest: rest["learners"][0]["optimiser"]["0"].pop("step"), f"optimiser 0 in .* {UNFIT}"),
    "a shape": (lambda rest: moment(rest, "exp_avg", torch.zeros(3)), r"optimiser 0 exp_avg .*\(3,\): it must be"),
    "a type": (lambda rest: moment(rest, "step", torch.zeros((), dtype=torch.int64)), "step .* is torch.int64"),
    "a time": (lambda rest: moment(rest, "step", torch.tensor(float("nan"))), "optimiser 0 step .* is not finite"),
    "the past": (lambda rest: moment(rest, "step", torch.tensor(-1.0)), "step of parameter 0 .* is -1"),
    "a parameter": (lambda rest: rest["learners"][0]["optimiser"].pop("1"), f"optimiser in .* {UNFIT}"),
    "a generator": (lambda rest: random_at(rest, 624, 624), "in an invalid state"),
    "no rewards": (lambda rest: rest.update(rewards=None), NO_REWARDS),
    "more rewards": (lambda rest: rewards(rest, more=1.0), NO_REWARDS),
    "fewer rewards": (lambda rest: rest["rewards"].pop("mean"), NO_REWARDS),
    "sums": (lambda rest: rewards(rest, sums=[0.0] * 7), r"rewards sums .* \(7,\): .* \(8,\)"),
    "no sums": (lambda rest: rest["rewards"].update(sums=0.0), "rewards sums in rest.safetensors .* is no tensor"),
    "a large sum": (lambda rest: rewards(rest, sums=[0.0] * 7 + [1e300]), "rewards sums .* beyond -1e\\+30 to"),
    "no number": (lambda rest: rewards(rest, mean=np.nan), "rewards mean .* is not finite"),
    "variance": (lambda rest: rewards(rest, variance=-1.0), "rewards variance .* beyond 0 to 1e\\+60"),
    "no lane": (lambda rest: rest.update(lane=None), f"lane in .* {UNFIT}"),
    "an opponent": (lambda rest: rest["lane"]["opponent"].fill_(3), NO_PLAYERS),
    "a side": (lambda rest: rest["lane"]["own"].fill_(9), NO_PLAYERS),
    "lives": (lambda rest: rest["lane"].update(life=torch.zeros(1)), "lane life in .* must be"),
    "no pool": (lambda rest: rest.update(opponents=[1]), NO_POOL),
    "a rating": (lambda rest: figures(rest, [np.inf, 0, 0, 0]), "opponents 0 in rest.safetensors .* is not finite"),
    "a high rating": (lambda rest: figures(rest, [1e9, 0, 0, 0]), NO_POOL),
    "games": (lambda rest: figures(rest, [0, 0, -1, 0]), NO_POOL),
    "fewer games": (lambda rest: figures(rest, [0, 1, 2, 1]), NO_POOL),
    "a past": (lambda rest: past(rest, 0), NO_POOL),
    "a name of a past": (lambda rest: past(rest, 7, name="scripted"), NO_POOL),
    "many pasts": (lambda rest: [past(rest, k) for k in range(7, 1007)], "it is too small for 1000 past selves"),
    "a number of a past": (lambda rest: past(rest, "07"), NO_POOL),
    "past weights": (lambda rest: past(rest, 7, weights=[{}]), "past@16 in .* does not hold the weights"),
    "size": (lambda rest: rest["learners"][0].update(minibatches=torch.zeros(9, dtype=torch.uint8)), r"uint8 \(9,\)"),
}


@pytest.mark.parametrize("what", RESTS)
@pytest.mark.by_day(20)
def test_a_run_does_not_go_on_with_what_cannot_be(trainer: Trainer, files: Files, what: str) -> None:
    before = [weight.clone() for weight in trainer.policies[0].parameters()], trainer.learners[0].generator.get_state()
    (change, reason), whole = RESTS[what], what in ("nothing", "a list")
    with pytest.raises(TrainingError, match=reason):
        restore(trainer, rest_with(files, lambda rest: change(rest) if whole else (change(rest), rest)[1]))
    assert all(torch.equal(*pair) for pair in zip(before[0], trainer.policies[0].parameters(), strict=True))
    assert torch.equal(before[1], trainer.learners[0].generator.get_state())
    restore(trainer, files)
    assert trainer.steps == checkpoint.header_of(files)["steps"]


@pytest.mark.parametrize(
    "extreme", [{"sums": [1e30] * 8}, {"variance": 1e60}, {"variance": 0.0}, {"count": 1e60}, {"mean": -1e30}]
)
def test_a_run_goes_on_with_rewards_at_their_limits(trainer: Trainer, files: Files, extreme: dict[str, Any]) -> None:
    restore(trainer, rest_with(files, lambda rest: rewards(rest, **extreme)))
    rollout = trainer.collect()
    assert np.isfinite(rollout.advantages).all()
    restore(trainer, files)


PLACES: dict[str, tuple[dict[str, Any], str, str]] = {
    "nowhere": ({"a/b": np.zeros(3)}, "{}", "its tensor a/b has no place"),
    "in a list": ({"a/7/b": np.zeros(3)}, '{"a":[{}]}', "its tensor a/7/b has no place"),
    "of a list": ({"a/0": np.zeros(3)}, '{"a":[0]}', "its tensor a/0 has no place"),
    "in a text": ({"a/b": np.zeros(3)}, '{"a":"b"}', "its tensor a/b has no place"),
    "of a number": ({"a": np.zeros(3)}, "3", "its tensor a has no place"),
    "where something is": ({"a": np.zeros(3)}, '{"a":1}', "its tensor a has no place"),
    "in a tensor": ({"a": np.zeros(3), "a/b": np.zeros(3)}, "{}", "its tensor a/b has no place"),
    "no text": ({"a": np.zeros(3)}, "", "Expecting value"),
    "twice": ({}, '{"a":1,"a":2}', "it has 'a' twice"),
    "deep": ({}, "[" * 200_000, "recursion|nested"),
    "a long number": ({}, "9" * 5000, "integer string"),
}


@pytest.mark.parametrize("what", PLACES)
def test_each_tensor_has_a_place(trainer: Trainer, files: Files, what: str) -> None:
    tensors, text, reason = PLACES[what]
    with pytest.raises(TrainingError, match=f"rest.safetensors of the checkpoint does not fit the run.*{reason}"):
        restore(trainer, files | {REST: policy_file.tensors_content(tensors, text)})


@pytest.mark.parametrize("name", [WEIGHTS, REST])
def test_what_is_no_safetensors_is_refused(trainer: Trainer, files: Files, name: str, tmp_path: Path) -> None:
    for content in (b"", pickle.dumps({"a": 1}), files[name][:-1], files[name] + b"x"):
        with pytest.raises(TrainingError, match=rf"{name} of the checkpoint (is|does) not"):
            restore(trainer, files | {name: content})
    checkpoint.write_checkpoint(tmp_path / "a.zip", files | {WEIGHTS: b"x"})
    with pytest.raises(TrainingError, match=r"a\.zip is not a checkpoint: policy.safetensors in it is not a policy: "):
        Player(tmp_path / "a.zip")


def test_weights_of_something_else_are_refused(trainer: Trainer, files: Files) -> None:
    (weights,) = checkpoint.policies_in(files)
    first, few = weights["actor.first.weight"], {name: weights[name] for name in [*weights][1:]}
    for given, reason in (
        ({"x": torch.zeros(3)}, "does not hold the weights of this policy"),
        (few, "does not hold the weights of this policy"),
        (weights | {"x": torch.zeros(3)}, "does not hold the weights of this policy"),
        (weights | {"actor.last.bias": torch.zeros(3)}, r"actor.last.bias in policy.safetensors of .* \(3,\)"),
        (weights | {"actor.first.weight": first.double()}, "actor.first.weight .* is torch.float64 .*: it must be"),
        (weights | {"actor.first.weight": first.half()}, "actor.first.weight .* is torch.float16 .*: it must be"),
        (weights | {"actor.first.weight": first * 1e38}, "are NaN or beyond 1000"),
        (weights | {"actor.first.weight": first * np.nan}, "are NaN or beyond 1000"),
    ):
        with pytest.raises(TrainingError, match=reason):
            restore(trainer, files | {WEIGHTS: checkpoint.policies_content([given])})
    with pytest.raises(TrainingError, match="the checkpoint has 2 policies, but the run 1"):
        restore(trainer, files | {WEIGHTS: checkpoint.policies_content([weights, weights])})
    for tensors in ({}, {"a": np.zeros(3)}, {"1.a": np.zeros(3)}):
        with pytest.raises(TrainingError, match=r"its tensors are not called 0\.NAME"):
            restore(trainer, files | {WEIGHTS: policy_file.tensors_content(tensors)})
    with pytest.raises(StateError, match=r"worlds.npz of the checkpoint is not a saved state"):
        restore(trainer, files | {"worlds.npz": b"x"})


HEADERS: dict[str, tuple[dict[str, Any], str]] = {
    "steps": ({"steps": -1}, "its steps cannot be -1"),
    "preset": ({"preset": ["paper"]}, "its preset cannot be"),
    "no shape": ({"observations": {"own": 7}}, "its observations cannot be"),
    "large": ({"observations": {"own": [60_000]}}, "the saved weights are too small for the observations"),
    "small": ({"observations": {"own": [3]}}, "observations that do not fit each other"),
    "masks": ({"observations": {"own": [9], "others": [3, 9], "others_mask": [4]}}, "its observations cannot be"),
    "actions": ({"actions": [3, 0]}, "its actions cannot be"),
    "other actions": ({"actions": [3, 3]}, "actor.last.weight in policy.safetensors"),
    "no fields": ({"fields": {"own": {}}}, "its fields cannot be"),
    "field": ({"fields": {"own": {"id": 1}}}, "its fields cannot be"),
    "size of a field": ({"fields": {"own": {"id": [-9, 1.0]}}}, "its fields cannot be"),
    "scale": ({"fields": {"own": {"id": [9, 0.0]}}}, "its fields cannot be"),
    "few fields": ({"fields": {"own": {"id": [3, 1.0]}}}, "rows of own have 9 numbers, but its fields 3"),
    "plan": ({"plan": [1]}, "its plan cannot be"),
    "version": ({"version": 2}, "has version 2: 1 is needed"),
}


@pytest.mark.parametrize("what", HEADERS)
def test_policies_are_not_what_they_cannot_be(tmp_path: Path, files: Files, what: str) -> None:
    changes, reason = HEADERS[what]
    header = {key: value for key, value in (json.loads(files["run.json"]) | changes).items() if value is not None}
    checkpoint.write_checkpoint(tmp_path / "a.zip", files | {"run.json": json.dumps(header).encode()})
    with memory_limit(2**22), pytest.raises(TrainingError, match=reason) as caught:
        Player(tmp_path / "a.zip")
    assert str(tmp_path / "a.zip") in str(caught.value)


def test_a_packed_checkpoint_is_refused(tmp_path: Path, files: Files) -> None:
    (tmp_path / "steps_1.zip").write_bytes(zipped(files, zipfile.ZIP_DEFLATED))
    for load in (checkpoint.read_checkpoint, Player):
        with pytest.raises(TrainingError, match=r"steps_1.zip is not a checkpoint: '.*' is compressed"):
            load(tmp_path / "steps_1.zip")

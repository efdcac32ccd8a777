"""Hostile checkpoints: nothing is executed, and everything is checked."""

import io
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

from outlast.training import checkpoint, resume  # noqa: E402
from outlast.training.config import TrainingConfig  # noqa: E402
from outlast.training.errors import TrainingError  # noqa: E402
from outlast.training.player import Player  # noqa: E402
from outlast.training.safe_torch import BROKEN, load_tensors  # noqa: E402
from outlast.training.trainer import Trainer  # noqa: E402
from tests.fuzz.mutations import memory_limit, unzipped, zipped  # noqa: E402

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
    return resume.capture(trainer, {"plan": {"seed": 0}})


# ---- tensors


def saved(content: Any) -> bytes:
    buffer = io.BytesIO()
    torch.save(content, buffer)
    return buffer.getvalue()


def test_tensors_are_those_that_torch_reads() -> None:
    rng = np.random.default_rng(0)
    for kind in ("float32", "float64", "int64", "int32", "uint8"):
        base = torch.from_numpy(rng.integers(0, 99, (6, 5)).astype(kind))
        content = {"a": base, "b": (base.T, base[2:4, 1:]), 7: [base[0, 0], base[:0], None, True, 2**40, -1.5, "x"]}
        ours, theirs = (read(saved(content)) for read in (load_tensors, lambda data: torch.load(io.BytesIO(data))))
        for one, other in zip(flat(ours), flat(theirs), strict=True):
            assert type(one) is type(other)
            assert torch.equal(one, other) if isinstance(one, torch.Tensor) else one == other
            assert getattr(one, "dtype", None) == getattr(other, "dtype", None)


@pytest.mark.parametrize("default", [2, 4, 5])
def test_what_is_written_can_be_read_whatever_the_default_of_torch(
    monkeypatch: pytest.MonkeyPatch, default: int
) -> None:
    save = torch.save
    monkeypatch.setattr(
        torch, "save", lambda *files, pickle_protocol=default: save(*files, pickle_protocol=pickle_protocol)
    )
    (found,) = load_tensors(checkpoint.tensor_bytes([torch.arange(12.0).reshape(3, 4)[1:, ::2]]))
    assert found.tolist() == [[4, 6], [8, 10]]


def flat(content: Any) -> list[Any]:
    if isinstance(content, dict):
        return [*content, *flat(list(content.values()))]
    return [part for each in content for part in flat(each)] if isinstance(content, (list, tuple)) else [content]


class Opens:
    """Unpickling creates a file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return open, (str(self.path), "w")


class Large:
    """Unpickling allocates a terabyte."""

    def __reduce__(self) -> Any:
        return bytearray, (10**12,)


NEST = b")" + b"".join(b"q%ch%c\x86" % (k, k) for k in range(50, 100))  # a tuple of the one before, twice
LONG = b"\x8a\xff" + b"\x7f" * 255  # an integer


def with_pickle(content: bytes, change: Callable[[bytes], bytes]) -> bytes:
    inner = unzipped(content)
    name = next(name for name in inner if name.endswith("data.pkl"))
    return zipped(inner | {name: change(inner[name])})


def put(old: bytes, new: bytes) -> Callable[[bytes], bytes]:
    def change(code: bytes) -> bytes:
        assert old in code
        return code.replace(old, new, 1)

    return change


def test_pickles_name_nothing_but_tensors(tmp_path: Path) -> None:
    """A hundred numbers in 400 bytes, which a pickle describes wrongly."""
    plain = saved(torch.zeros(100))
    for evil, reason in ((Opens(tmp_path / "made"), "the name .* open"), (Large(), "the name .* bytearray")):
        with memory_limit(2**20), pytest.raises(BROKEN, match=reason):
            load_tensors(with_pickle(plain, lambda _, evil=evil: pickle.dumps(evil, 2)))
    assert not (tmp_path / "made").exists()
    size, text = b"Kd\x85", b"X\x03\x00\x00\x00abc\x85"  # a tuple of 100, and one of a text
    changes: tuple[tuple[Callable[[bytes], bytes], str], ...] = (
        (put(b"FloatStorage", b"DoubleStorage"), "a storage of 100 numbers in 400 bytes"),
        (put(b"FloatStorage", b"HalfStorage"), "the name torch HalfStorage"),
        (put(b"Kdt", b"Ket"), "a storage of 101 numbers in 400 bytes"),
        (put(b"Kdt", b"J\xff\xff\xff\xfft"), "a storage of -1 numbers in 400 bytes"),
        (put(size, b"J\xff\xff\xff\x7f\x85"), "a tensor of size"),
        (put(size, b"J\xff\xff\xff\xff\x85"), "not whole numbers"),
        (put(size, b"(]NaJ\x00\x00\x00\x10t"), "2 sizes and 1 strides"),
        (put(size, b"]Na\x85"), "not whole numbers"),  # a list of 2**28 was made where it was multiplied
        (put(size, text), "not whole numbers"),
        (put(size, b"(" + b"K\x02" * 3000 + b"t"), "3000 sizes and 1 strides"),
        (put(size, LONG + b"\x85"), "more than 63 bits"),
        (put(size, b"J\x00\x00\x00\x10K\x00\x86"), "2 sizes"),
        (put(b"Kdt", NEST + b"t"), "a storage that is none"),  # printed, it has 2**50 brackets
        (put(size, NEST), "2 sizes and 1 strides"),
        (put(size, NEST + b"\x85"), "not whole numbers"),
        (put(b"K\x00Kd", b"K\x01Kd"), "out of bounds"),
        (lambda code: code[:-1], "exhausted"),
        (lambda _: b"\x80\x02.", "out of range"),
        (lambda _: b"\x80\x04\x8c\x02os\x94.", "the instruction SHORT_BINUNICODE"),
        (lambda _: pickle.dumps([1] * 9, 4), "the instruction"),
    )
    for change, reason in changes:
        with memory_limit(2**20), pytest.raises(BROKEN, match=reason):
            load_tensors(with_pickle(plain, change))
    with memory_limit(2**26), pytest.raises(BROKEN, match="more than 262144 instructions"):
        load_tensors(with_pickle(plain, lambda code: code[:2] + b"(" * 300_000 + code[2:]))
    for content in (b"", b"x" * 99, pickle.dumps(1), zipped({"a/b": b""})):
        with pytest.raises(BROKEN):
            load_tensors(content)


# ---- the state of a run


def rest_with(files: Files, change: Callable[[Any], Any]) -> Files:
    rest = torch.load(io.BytesIO(files["rest.pt"]))
    return files | {"rest.pt": saved(change(rest) or rest)}


def moment(rest: Any, name: str, value: Any) -> None:
    rest["learners"][0]["optimiser"]["state"][0][name] = value


def rewards(rest: Any, **values: Any) -> None:
    rest["rewards"].update({name: torch.tensor(value, dtype=torch.float64) for name, value in values.items()})


def figures(rest: Any, values: list[float]) -> None:
    rest["opponents"]["figures"][0] = torch.tensor(values, dtype=torch.float64)


def past(rest: Any, number: int, **changes: Any) -> None:
    rest["opponents"]["past"][number] = {"name": "past@16", "drawn": True, "weights": []} | changes


def random_at(rest: Any, left: int, place: int) -> None:
    state = rest["learners"][0]["minibatches"].numpy()
    state[8:12], state[16:24] = np.array([left], "<i4").view(np.uint8), np.array([place], "<i8").view(np.uint8)


NO_REWARDS = "rewards in rest.pt of the checkpoint is not what a run goes on with"
RESTS: dict[str, tuple[Callable[[Any], Any], str]] = {
    "nothing": (lambda rest: {"updates": 1}, "is not what a run goes on with"),
    "a list": (lambda rest: [1], "is not what a run goes on with"),
    "updates": (lambda rest: rest.update(updates="1"), "is not what a run goes on with"),
    "a shape": (lambda rest: moment(rest, "exp_avg", torch.zeros(3)), r"exp_avg of parameter 0 .*\(3,\): .* is needed"),
    "a type": (lambda rest: moment(rest, "step", torch.zeros((), dtype=torch.int64)), "step .* is torch.int64"),
    "a time": (lambda rest: moment(rest, "step", torch.tensor(float("nan"))), "step of parameter 0 .* is not finite"),
    "the past": (lambda rest: moment(rest, "step", torch.tensor(-1.0)), "step of parameter 0 .* is -1"),
    "a name": (lambda rest: moment(rest, "more", torch.zeros(3)), "is not of an optimiser of this policy"),
    "a parameter": (
        lambda rest: rest["learners"][0]["optimiser"]["state"].pop(1),
        "is not of an optimiser of this policy",
    ),
    "a generator": (lambda rest: random_at(rest, 624, 624), "in a state that cannot be"),
    "left": (lambda rest: random_at(rest, -1, 5), "in a state that cannot be"),
    "no rewards": (lambda rest: rest.update(rewards=None), NO_REWARDS),
    "rewards": (lambda rest: rest.update(rewards=[1.0]), NO_REWARDS),
    "more rewards": (lambda rest: rewards(rest, more=1.0), NO_REWARDS),
    "fewer rewards": (lambda rest: rest["rewards"].pop("mean"), NO_REWARDS),
    "sums": (lambda rest: rewards(rest, sums=[0.0] * 7), r"rewards sums .* \(7,\): .* \(8,\) is needed"),
    "no sums": (lambda rest: rest["rewards"].update(sums=0.0), "rewards sums in rest.pt .* is no tensor"),
    "a kind of mean": (lambda rest: rest["rewards"].update(mean=torch.tensor(0.0)), "mean .* is torch.float32"),
    "many means": (lambda rest: rewards(rest, mean=[0.0, 0.0]), r"rewards mean .* \(2,\): .* \(\) is needed"),
    "a large sum": (lambda rest: rewards(rest, sums=[0.0] * 7 + [1e300]), "rewards sums .* beyond -1e\\+30 to"),
    "an endless sum": (lambda rest: rewards(rest, sums=[np.inf] * 8), "rewards sums .* is not finite"),
    "no number": (lambda rest: rewards(rest, mean=np.nan), "rewards mean .* is not finite"),
    "variance": (lambda rest: rewards(rest, variance=-1.0), "rewards variance .* beyond 0 to 1e\\+60"),
    "a large variance": (lambda rest: rewards(rest, variance=1e61), "rewards variance .* beyond 0 to 1e\\+60"),
    "count": (lambda rest: rewards(rest, count=-1.0), "rewards count .* beyond 0 to 1e\\+60"),
    "no lane": (
        lambda rest: rest.update(lane=None),
        "lane in rest.pt of the checkpoint is not what a run goes on with",
    ),
    "an opponent": (
        lambda rest: rest["lane"]["opponent"].fill_(3),
        "lane in rest.pt .* names players that there are not",
    ),
    "a side": (lambda rest: rest["lane"]["own"].fill_(9), "lane in rest.pt .* names players that there are not"),
    "no side": (lambda rest: rest["lane"]["own"].fill_(-1), "lane in rest.pt .* names players that there are not"),
    "lives": (lambda rest: rest["lane"].update(life=torch.zeros(1)), "lane life in rest.pt .* is needed"),
    "a memory": (lambda rest: rest["lane"].update(memory=torch.zeros(8, 5)), "lane memory in rest.pt .* is needed"),
    "no pool": (lambda rest: rest.update(opponents=[1]), "opponents in rest.pt .* are not what a run goes on with"),
    "a rating": (lambda rest: figures(rest, [np.inf, 0, 0, 0]), "opponents 0 in rest.pt .* is not finite"),
    "a high rating": (lambda rest: figures(rest, [1e9, 0, 0, 0]), "opponents in rest.pt .* are not what a run goes on"),
    "games": (lambda rest: figures(rest, [0, 0, -1, 0]), "opponents in rest.pt .* are not what a run goes on with"),
    "wins": (lambda rest: figures(rest, [0, 2, 1, 1]), "opponents in rest.pt .* are not what a run goes on with"),
    "fewer games": (
        lambda rest: figures(rest, [0, 1, 2, 1]),
        "opponents in rest.pt .* are not what a run goes on with",
    ),
    "a past": (lambda rest: past(rest, 0), "opponents in rest.pt .* are not what a run goes on with"),
    "a name of a past": (
        lambda rest: past(rest, 7, name="scripted"),
        "opponents in rest.pt .* are not what a run goes on with",
    ),
    "a long name": (
        lambda rest: past(rest, 7, name="past@" + "9" * 5000),
        "opponents in rest.pt .* are not what a run",
    ),
    "many pasts": (
        lambda rest: [past(rest, k) for k in range(7, 1007)],
        "is not what a run goes on with: it is too small for 1000 past selves",
    ),
    "past weights": (lambda rest: past(rest, 7, weights=[{}]), "past@16 in rest.pt .* does not hold the weights"),
    "size": (
        lambda rest: rest["learners"][0].update(minibatches=torch.zeros(9, dtype=torch.uint8)),
        r"uint8 \(9,\): .*5056",
    ),
}


@pytest.mark.parametrize("what", RESTS)
@pytest.mark.by_day(20)
def test_a_run_does_not_go_on_with_what_cannot_be(trainer: Trainer, files: Files, what: str) -> None:
    before = [weight.clone() for weight in trainer.policies[0].parameters()], trainer.learners[0].generator.get_state()
    (change, reason), whole = RESTS[what], what in ("nothing", "a list")
    with pytest.raises(TrainingError, match=reason):
        resume.restore(trainer, rest_with(files, lambda rest: change(rest) if whole else (change(rest), rest)[1]))
    assert all(torch.equal(*pair) for pair in zip(before[0], trainer.policies[0].parameters(), strict=True))
    assert torch.equal(before[1], trainer.learners[0].generator.get_state())
    resume.restore(trainer, files)
    assert trainer.steps == checkpoint.header_of(files)["steps"]


@pytest.mark.parametrize(
    "extreme", [{"sums": [1e30] * 8}, {"variance": 1e60}, {"variance": 0.0}, {"count": 1e60}, {"mean": -1e30}]
)
def test_a_run_goes_on_with_rewards_at_their_limits(trainer: Trainer, files: Files, extreme: dict[str, Any]) -> None:
    resume.restore(trainer, rest_with(files, lambda rest: rewards(rest, **extreme)))
    rollout = trainer.collect()
    assert np.isfinite(rollout.advantages).all()
    resume.restore(trainer, files)


def test_weights_of_something_else_are_refused(trainer: Trainer, files: Files) -> None:
    weights = torch.load(io.BytesIO(files["policy.pt"]))
    for changed, reason in (
        ({"x": torch.zeros(3)}, "does not hold the weights of this policy"),
        ([1], "does not hold the weights of this policy"),
        (weights | {"actor.last.bias": torch.zeros(3)}, r"actor.last.bias in policy.pt of the checkpoint is .*\(3,\)"),
        (weights | {"actor.first.weight": weights["actor.first.weight"] * 1e38}, "beyond 1000, or that are none"),
        (weights | {"actor.first.weight": weights["actor.first.weight"] * np.nan}, "beyond 1000, or that are none"),
        (weights | {"actor.last.bias": 3}, "actor.last.bias in policy.pt of the checkpoint is no tensor"),
    ):
        with pytest.raises(TrainingError, match=reason):
            resume.restore(trainer, files | {"policy.pt": saved(changed)})
    with pytest.raises(StateError, match=r"worlds.npz of the checkpoint is not a saved state"):
        resume.restore(trainer, files | {"worlds.npz": b"x"})


HEADERS: dict[str, tuple[dict[str, Any], str]] = {
    "steps": ({"steps": -1}, "its steps cannot be -1"),
    "preset": ({"preset": ["paper"]}, "its preset cannot be"),
    "no shape": ({"observations": {"own": 7}}, "its observations cannot be"),
    "negative": ({"observations": {"own": [-7]}}, "its observations cannot be"),
    "huge": ({"observations": {"own": [10**9]}}, "its observations cannot be"),
    "large": ({"observations": {"own": [60_000]}}, "what is saved is too small for the observations"),
    "small": ({"observations": {"own": [3]}}, "observations that no scenario has"),
    "masks": ({"observations": {"own": [9], "others": [3, 9], "others_mask": [4]}}, "its observations cannot be"),
    "actions": ({"actions": [3, 0]}, "its actions cannot be"),
    "many actions": ({"actions": [60_000]}, "what is saved is too small for the observations"),
    "other actions": ({"actions": [3, 3]}, "actor.last.weight in policy.pt"),
    "no fields": ({"fields": {"own": {}}}, "its fields cannot be"),
    "field": ({"fields": {"own": {"id": 1}}}, "its fields cannot be"),
    "size of a field": ({"fields": {"own": {"id": [-9, 1.0]}}}, "its fields cannot be"),
    "large fields": ({"fields": {"own": {"id": [60_000, 1.0], "x": [60_000, 1.0]}}}, "its fields cannot be"),
    "scale": ({"fields": {"own": {"id": [9, 0.0]}}}, "its fields cannot be"),
    "infinite scale": ({"fields": {"own": {"id": [9, np.inf]}}}, "its fields cannot be"),
    "few fields": ({"fields": {"own": {"id": [3, 1.0]}}}, "rows of own have 9 numbers, and fields of 3"),
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

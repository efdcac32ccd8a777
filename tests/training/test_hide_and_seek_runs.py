"""Research on hide and seek: actions taken away, checkpoints against each other, memories."""

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.envs.scenarios.hide_and_seek import HIDE_2V2
from outlast.training.research.__main__ import main
from outlast.training.research.hide_and_seek import ABLATIONS, ablated, changes, read_off
from tests.helpers.outputs import rows_of

SMALL: dict[str, Any] = {"worlds": 4, "rollout": 16, "policies": "side", "quiet": True}


def test_a_run_is_played_with_and_without_tools(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outlast.train("hide_small", tmp_path / "run", steps=1, **SMALL)
    out = tmp_path / "table.csv"
    assert main(["tool-use", "hide_small", str(tmp_path / "run"), "--episodes", "8", "--out", str(out)]) == 0
    assert [row["who"] for row in rows_of(out)] == [*ABLATIONS][:3]  # without ramps, nothing is said of them
    assert "errors apart" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "agents"), [("hiders without grab and lock", [0, 1]), ("seekers without ramps", [2, 3])]
)
def test_only_one_side_lacks_something(name: str, agents: list[int]) -> None:
    env = outlast.make_vec(ablated(HIDE_2V2, ABLATIONS[name]), 2, seed=0, action_masks=True)
    env.reset()
    names = [key for key, _ in env.action_columns]
    first = int(env.action_sizes[: names.index("grab")].sum())
    for _ in range(120):
        *_, info = env.step(env.action_space.sample())
        mask = info["action_mask"][:, :, first : first + 5]
        assert "ramps" in name or (mask[:, agents] == [1, 0, 0, 1, 0]).all()
    if "ramps" in name:
        assert env.numbers()["climbing_ticks"][0].tolist() == [12, 12, 0, 0]


def test_checkpoints_play_each_other(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run"
    outlast.train("hide_small", run, steps=64, every=32, **SMALL)
    out, figure = tmp_path / "table.csv", tmp_path / "figure.png"
    arguments = ["phases", "hide_small", str(run), "--episodes", "8", "--out", str(out), "--figure", str(figure)]
    assert main(arguments) == 0
    found = {(row["hiders"], row["seekers"], row["figure"]): float(row["mean"]) for row in rows_of(out)}
    steps = sorted({hiders for hiders, _, _ in found}, key=int)
    assert sum(figure == "ticks_seen" for *_, figure in found) == len(steps) ** 2 > 1
    for each in steps:  # hiders are paid 1 for each of 144 ticks in which they are hidden, and -1 for others
        assert found[each, each, "return0"] == pytest.approx(144 - 2 * found[each, each, "ticks_seen"], abs=0.02)
        assert found[each, each, "return1"] == -found[each, each, "return0"]
    assert figure.read_bytes().startswith(b"\x89PNG")
    assert "later seekers: seen more" in capsys.readouterr().out
    for path in sorted(run.glob("steps_*"))[1:]:
        path.unlink()
    assert main(arguments) != 0
    assert "has 1 checkpoint: train it with --every" in capsys.readouterr().err


def test_later_checkpoints_are_compared_against_the_same_opponent() -> None:
    pairs = itertools.product((1, 2, 3), repeat=2)
    cells = {(hiders, seekers): {"ticks_seen": (10.0 * seekers - 2.0 * hiders, 1.0)} for hiders, seekers in pairs}
    assert changes(cells, 1) == (9, 0, 9)  # later seekers see ten ticks more
    assert changes(cells, 0) == (0, 0, 9)  # two and four ticks are below three errors of 1.4


def test_what_a_memory_holds_is_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for memory in (8, 0):
        outlast.train("hide_small", tmp_path / str(memory), steps=1, memory=memory, **SMALL | {"rollout": 128})
    out, counts = tmp_path / "table.csv", np.random.default_rng(0).integers(0, 7, 400)
    assert main(["object-counting", str(tmp_path / "8"), "--episodes", "17", "--out", str(out)]) == 0
    assert [row["weights"] for row in rows_of(out)] == ["trained", "random"]
    assert main(["object-counting", str(tmp_path / "0")]) != 0
    assert main(["object-counting", str(tmp_path / "8"), "--episodes", "15"]) != 0
    errors = capsys.readouterr().err
    assert "has no memory to read: train it with --memory" in errors
    assert "--episodes 15: 16 are needed, half of them" in errors
    assert read_off(np.c_[counts / 7, counts % 2], counts)[0] == 1
    right, _, guessed, explained = read_off(np.c_[counts * 1e-5, np.ones(400)], counts)  # below the noise
    assert (right, explained) == (pytest.approx(guessed, abs=0.05), pytest.approx(0, abs=0.05))

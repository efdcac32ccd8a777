"""tool-use: the test of hide and seek that takes actions away."""

import csv
from pathlib import Path

import pytest

import outlast
from outlast.envs.scenarios.hide_and_seek import HIDE_2V2
from outlast.training.research.__main__ import main
from outlast.training.research.tool_use import ABLATIONS, ablated


def test_a_run_is_played_with_and_without_tools(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    outlast.train("hide_small", str(tmp_path / "run"), steps=1, worlds=4, rollout=16, policies="side", quiet=True)
    out = tmp_path / "table.csv"
    assert main(["tool-use", "hide_small", str(tmp_path / "run"), "--episodes", "8", "--out", str(out)]) == 0
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [row["who"] for row in rows] == [*ABLATIONS][:3]  # without ramps, nothing is said of them
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
        for i in range(4):
            if i in agents and "grab" in name:
                assert (mask[:, i] == [1, 0, 0, 1, 0]).all()
    if "ramps" in name:
        assert env.numbers()["climbing_ticks"][0].tolist() == [12, 12, 0, 0]

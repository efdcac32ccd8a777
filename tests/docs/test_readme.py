"""The README: its Python blocks run, its errors are raised, and it is short."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from outlast.envs.scenarios.parse import named

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.S)
MOST_WORDS = 900  # a page that is read in a few minutes


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.strip().splitlines()[-1][:30])
def test_python_blocks_run(block, tmp_path):
    file = tmp_path / "block.py"
    file.write_text(block)
    done = subprocess.run([sys.executable, str(file)], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    if "lengths" in block:
        assert re.fullmatch(r"\d+ episodes ended, after \d+\.\d+ steps on average\n", done.stdout)


def test_commands_can_take_the_file_of_the_mechanic(tmp_path, monkeypatch):
    (tmp_path / "swamp.py").write_text(next(block for block in BLOCKS if "class Swamp" in block))
    assert "outlast play swamp.py" in README
    monkeypatch.setattr(sys, "path", [*sys.path])
    assert named(str(tmp_path / "swamp.py"))["swamp"].drag == 0.2


def test_the_order_of_an_example_without_after_is_refused_as_shown():
    block = next(block for block in BLOCKS if "class Swamp" in block).replace(', after="motors"', "")
    done = subprocess.run([sys.executable, "-c", block], capture_output=True, text=True)
    assert "ambiguous" in done.stderr
    assert "motors.drive" in done.stderr
    assert "swamp.wade" in done.stderr


def test_it_is_short():
    assert len(README.split()) <= MOST_WORDS


@pytest.mark.parametrize(
    ("sentence", "page", "table", "column"),
    [
        (r"steps (\d+) to (\d+) times as many worlds", "performance", "original", "times faster"),
        (r"is reached in \[(\d+) to (\d+) CPU seconds\]", "training", "training_race", "CPU s"),
    ],
)
def test_figures_are_those_of_the_measured_tables(sentence, page, table, column):
    text = (ROOT / f"docs/{page}.md").read_text()
    lines = re.search(rf"<!-- table {table} of .*?-->\n(.*?)<!-- end -->", text, re.S)[1].splitlines()
    head, _, *rows = ([cell.strip() for cell in line.strip("|").split("|")] for line in lines)
    values = [round(float(row[head.index(column)])) for row in rows if "mean" not in row[0]]
    assert [int(figure) for figure in re.search(sentence, README).groups()] == [min(values), max(values)]

"""The README: its Python blocks run, its tick table is the engine's, its errors are raised."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from outlast.components import Phase

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", README, re.S)


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.strip().splitlines()[-1][:30])
def test_python_blocks_run(block, tmp_path):
    file = tmp_path / "block.py"
    file.write_text(block.replace("num_worlds=256", "num_worlds=2").replace("range(300)", "range(3)"))
    done = subprocess.run([sys.executable, str(file)], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr


def test_the_tick_table_names_every_phase_and_its_text():
    for phase in Phase:
        assert re.search(rf"\b{phase.name}\b", README), phase.name
        assert phase.postcondition in README, phase.postcondition


def test_the_order_of_an_example_without_after_is_refused_as_shown():
    block = next(block for block in BLOCKS if "class Swamp" in block).replace(', after="motors"', "")
    done = subprocess.run([sys.executable, "-c", block], capture_output=True, text=True)
    assert "ambiguous" in done.stderr
    assert "motors.drive" in done.stderr
    assert "swamp.wade" in done.stderr


def test_too_many_agents_are_refused_as_shown():
    import outlast

    with pytest.raises(ValueError, match=r"93 bodies .* 64 cells"):
        outlast.make_vec(outlast.variant("ffa_3").replace(n_agents=70), 1)

"""Tests of curriculum.py. Run it: python -m pytest docs/examples/test_curriculum.py."""

import csv
from types import SimpleNamespace

import numba
import numpy as np
import pytest

from outlast import levels
from outlast.levels import Level

for library in ("torch", "tensorboard", "matplotlib"):
    pytest.importorskip(library, reason="python -m pip install 'outlast[train]'")

from curriculum import HEALTH, KEPT, MAZES, NEW, PLANS, Learnable, held_out, main  # noqa: E402

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="worlds without compiled systems take minutes")


def asked(choose, solved, key=0):
    """What is chosen after these episodes: of each level, by its number, whether it was solved."""
    pairs = [(Level(key=(number, 0, 1)), end) for number, ends in solved.items() for end in ends]
    deaths = np.array([1 - end for _, end in pairs], int)
    rng = np.random.default_rng(key)
    progress = SimpleNamespace(played=[level for level, _ in pairs], statistics={"deaths_zone": deaths}, rng=rng)
    return [level.key[0] for level in choose(progress)]


def test_at_first_all_levels_are_new():
    chosen = asked(Learnable(), {})
    assert len(set(chosen)) == len(chosen) == NEW
    assert chosen == asked(Learnable(), {}) != asked(Learnable(), {}, key=1)


def test_levels_that_are_solved_now_and_then_are_played_again():
    choose = Learnable()
    chosen = asked(choose, {1: [1, 1, 1, 1], 2: [0, 1, 0, 1], 3: [0, 0, 0, 0], 4: [0, 0, 0, 1]})
    assert chosen[:4] == [2, 4, 1, 2]
    assert len(chosen) - NEW == KEPT
    assert 3 not in chosen
    chosen = asked(choose, {2: [1] * 9, **{k: [0, 1] for k in range(10, 10 + KEPT)}})
    assert set(chosen[:KEPT]) == {*range(10, 10 + KEPT)}


def test_held_out_levels_are_in_files(tmp_path):
    tests = held_out(tmp_path)
    assert [levels.load(tmp_path / f"{name}.json", tests[name][0]) for name in ("mazes", "plans")] == [
        those for _, those in tests.values()
    ]
    assert [scenario for scenario, _ in tests.values()] == [MAZES, PLANS]
    (_, mazes), (_, plans) = tests.values()
    assert {level.numbers["agents_health"] for level in mazes} == {HEALTH}
    assert len({level.numbers["walls_layout"] for level in plans}) == 4


@pytest.mark.nightly
def test_both_ways_of_training_are_measured_and_drawn(tmp_path):
    main(["--steps", "1000", "--worlds", "4", "--runs", str(tmp_path / "runs"), "--out", str(tmp_path)])
    with (tmp_path / "curriculum.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(row["levels"], row["agent-steps"]) for row in rows] == [("drawn", "1024"), ("chosen", "1024")]
    assert all(0 <= float(row[name]) <= 1 for row in rows for name in ("mazes", "plans"))
    assert (tmp_path / "curriculum.png").stat().st_size > 1000

"""Tests of elites.py. Run it: python -m pytest docs/examples/test_elites.py."""

import numba
import pytest
from elites import GAME, SIZE, cells_of, fill, text

import outlast

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="worlds without compiled systems take minutes")


@pytest.mark.nightly
def test_levels_lead_to_the_behaviour_that_they_are_kept_for():
    elites = fill(0, worlds=16)
    assert 1 < len(elites) <= 16
    env = outlast.make_vec(GAME, len(elites), seed=99)
    env.set_levels([level for _, level in elites.values()])
    found = outlast.rollout(env, outlast.policies.scripted_policy(env), keep=True).arrays()
    env.close()
    assert list(map(tuple, cells_of(found))) == [*elites]
    assert found["length"].tolist() == [length for length, _ in elites.values()]


def test_the_grid_as_text():
    lines = text({(0, 0): (700, None), (SIZE - 1, SIZE - 1): (1234, None)}).splitlines()
    assert len(lines) == SIZE
    assert lines[0].endswith(" 12")
    assert lines[-1].startswith("  7 ")
    assert sum(line.count(".") for line in lines) == SIZE**2 - 2

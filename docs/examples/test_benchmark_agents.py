"""Tests of benchmark_agents.py. Run it: python -m pytest docs/examples/test_benchmark_agents.py."""

from pathlib import Path

import numba
import pytest

import outlast

pytest.importorskip("torch", reason="needs torch: outlast[train]")

from benchmark_agents import train_sb3

from outlast.training.benchmark.agents import Made
from outlast.training.benchmark.matches import play
from outlast.training.benchmark.tasks import Game

pytestmark = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="worlds without compiled systems take minutes")
EXAMPLE = Path(__file__).with_name("benchmark_agents.py")
SHORT = outlast.variant("ffa_2").replace(safe_zone_damage=20, safe_zone_stand=20, safe_zone_shrink=10)


@pytest.mark.parametrize("name", ["striker", "sb3"])
def test_agents_play(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if name == "sb3":
        pytest.importorskip("stable_baselines3")
        train_sb3("ffa_2-v1", seed=0, steps=1)  # one rollout
    game = Game("trained", SHORT.titled_as(outlast.variant("ffa_2")), (), 0)
    found = play(game, [Made(name, f"{EXAMPLE}:{name}", 0)], 4, tmp_path / "self.rec")
    assert found["games"] == 4

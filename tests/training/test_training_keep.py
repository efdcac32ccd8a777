"""What `outlast plot --keep` keeps of runs: curves, and policies that play."""

import contextlib
from pathlib import Path

import pytest

from outlast import load_policy, make_vec, variant
from outlast.envs.errors import TrainingError

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")
pytest.importorskip("stable_baselines3", reason="needs stable_baselines3: outlast[train]")
pytest.importorskip("matplotlib", reason="needs matplotlib: outlast[plot]")

from outlast.training import checkpoint  # noqa: E402
from outlast.training.train import Plan, Run  # noqa: E402
from tests.training.test_training_plot import outlast_plot  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")


def test_policies_are_kept_and_play(tmp_path: Path) -> None:
    """What is kept of a checkpoint plays as that does, and is a run's no longer: it cannot be resumed."""
    folder, kept = tmp_path / "run", tmp_path / "kept"
    plan = Plan(
        variant("ffa_1").replace(safe_zone_damage=50, safe_zone_stand=5),
        steps=4096,
        worlds=8,
        rollout=512,
        threads=1,
        settings={"n_epochs": 1},
    )
    Run(plan, folder).go()
    for _ in range(2):  # the second time from what was kept
        assert outlast_plot(folder, "--out", tmp_path / "out", "--keep", kept) == 0
        folder = kept
    (policy,) = kept.glob("*.zip")
    whole = checkpoint.newest(tmp_path / "run")
    assert policy.stat().st_size < whole.stat().st_size / 3
    players = [load_policy(path) for path in (policy, whole)]
    with contextlib.closing(make_vec(players[0].scenario(variant("ffa_1")), 8, seed=1)) as env:
        observations = env.reset()[0]
        one, other = (player(observations) for player in players)
    assert (one == other).all()
    with pytest.raises(TrainingError, match=r"it has no rest\.pt"):
        checkpoint.read(policy)

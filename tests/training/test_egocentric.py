"""Observations in the frame of the agent: against a naive form, and wherever the world is turned and moved to."""

import json
import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import outlast
from outlast.envs.rollout.policies import scripted_policy

torch = pytest.importorskip("torch", reason="needs torch: outlast[train]")
pytest.importorskip("tensorboard", reason="needs tensorboard: outlast[train]")

from outlast.training.base.errors import TrainingError  # noqa: E402
from outlast.training.base.observation_layout import layout_of  # noqa: E402
from outlast.training.policies.packer import Packer  # noqa: E402
from outlast.training.policies.player import Player  # noqa: E402
from outlast.training.runs.run import TrainingConfig, TrainingRun  # noqa: E402

pytestmark = pytest.mark.usefixtures("one_torch_thread")


def naive(row: Any, fields: Any, me: Any, own: bool) -> Any:
    """One row in the frame of an agent that is at (x, y), moves by (vx, vy) and looks along angle."""
    x, y, vx, vy, angle = me
    found = row.copy()

    def put(first: str, second: str, ahead: float, left: float) -> None:
        found[fields[first].start] = math.cos(angle) * ahead + math.sin(angle) * left
        found[fields[second].start] = math.cos(angle) * left - math.sin(angle) * ahead

    def value(name: str) -> float:
        return float(row[fields[name].start])

    for one, two in (("x", "y"), ("next_x", "next_y")):
        if one in fields:
            put(one, two, -x if own else value(one) - x, -y if own else value(two) - y)
    if "vx" in fields:
        put("vx", "vy", value("vx") - vx * (not own), value("vy") - vy * (not own))
    if "angle" in fields:
        turned = value("angle") - angle * (not own)
        found[fields["angle"].start] = math.atan2(math.sin(turned), math.cos(turned))
    return found


@pytest.mark.parametrize("name", ["ffa_2", "teams_3", "ffa_4"])
def test_rows_are_those_of_the_naive_form(name: str) -> None:
    env = outlast.make_vec(name, 4, seed=0)
    env.reset(seed=0)
    policy = scripted_policy(env)
    for _ in range(60):
        env.step(policy(env.observe()))
    seen, layout = env.observe(), layout_of(env)
    found = Packer(layout, leaky=False, egocentric=True)(seen)
    columns = layout.field_columns()
    widths = {kind.key: kind.features for kind in layout.kinds}
    own_fields = env.fields["own"]
    rows = iter(found.entities.numpy())
    for agent, (w, a) in enumerate(np.ndindex(4, env.num_agents)):
        own = seen["own"][w, a]
        me = [float(own[own_fields[key].start]) for key in ("x", "y", "vx", "vy", "angle")]
        for key, width in layout.alone.items():
            expected = naive(seen[key][w, a].ravel(), env.fields[key], me, key == "own")
            start = min(columns[key].values())
            np.testing.assert_allclose(found.own[agent, start : start + width], expected, rtol=1e-5, atol=2e-5)
        for key, width in widths.items():
            for k in np.flatnonzero(seen[f"{key}_mask"][w, a]):
                expected = naive(seen[key][w, a, k], env.fields[key], me, False)
                start = min(columns[key].values())
                row = next(rows)[start : start + width]
                np.testing.assert_allclose(row, expected, rtol=1e-5, atol=2e-5)
    assert next(rows, None) is None


def test_a_saved_policy_plays_and_one_without_fields_is_refused(tmp_path: Path) -> None:
    small = outlast.variant("ffa_2").replace(agents_health=10)
    TrainingRun(
        TrainingConfig(small, preset="fast", steps=384, worlds=8, rollout=192, threads=1), tmp_path / "run"
    ).train()
    (file,) = tmp_path.glob("run/steps_*384.zip")
    player, env = Player(file), outlast.make_vec(small, 3, seed=1)
    player.check(env)
    seen = env.reset(seed=1)[0]
    assert player(seen).shape == (3, 2, len(env.action_sizes))
    broken = tmp_path / "broken.zip"
    with zipfile.ZipFile(file) as whole, zipfile.ZipFile(broken, "w") as other:
        for name in whole.namelist():
            content = whole.read(name)
            if name == "run.json":
                header = json.loads(content)
                own = header["fields"]["own"]
                header["fields"]["own"] = {"heading" if key == "angle" else key: field for key, field in own.items()}
                content = json.dumps(header).encode()
            other.writestr(name, content)
    with pytest.raises(TrainingError, match="preset fast needs the fields x, y, vx, vy, angle of 'own'"):
        Player(broken)

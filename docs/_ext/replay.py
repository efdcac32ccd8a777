"""Makes pages of the site that play recordings: replay.html, with commands as in docs/seeing.md, and trained agents."""

import importlib.util
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[2]
SCRIPTED = "teams_4 --worlds 1 --steps 700 --policy scripted --seed 1"
FLAWLESS = {"ffa_2": "ffa_2+health_cap+rivalry+steering", "teams_3": "teams_3+health_cap+team_share+bounty+steering"}
TRAINED = {  # pages of trained agents, which need PyTorch; each is one file of some 100 to 300 kB
    f"trained-{name}": f"{game} --policy {game}/pool-0 --worlds 2 --steps 300 --seed 1 --record-policy"
    for name, game in FLAWLESS.items()
} | {"trained-layouts": "ffa_4 --layout rooms --policy ffa_4/fast-0 --worlds 1 --steps 400 --seed 1 --record-policy"}


def make(app: Sphinx, error: Exception | None) -> None:
    """Write the pages that play beside the other pages."""
    if error or app.builder.format != "html":
        return
    trained = TRAINED if importlib.util.find_spec("torch") else {}
    for name, rollout in {"replay": SCRIPTED, **trained}.items():
        with tempfile.TemporaryDirectory() as folder:
            recording, page = str(Path(folder) / "game.rec"), str(Path(app.outdir) / f"{name}.html")
            for command in (
                ["rollout", *shlex.split(rollout), "--quiet", "--record", recording],
                ["replay", recording, "--quiet", "--html", page],
            ):  # in processes of their own: Sphinx has imported parts of outlast without PyTorch
                done = subprocess.run(
                    [sys.executable, "-m", "outlast", *command], cwd=ROOT, capture_output=True, text=True
                )
                if done.returncode:
                    raise RuntimeError(f"outlast {' '.join(command)} failed: {done.stderr}")


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the extension; called by Sphinx."""
    app.connect("build-finished", make)
    return {"parallel_read_safe": True}

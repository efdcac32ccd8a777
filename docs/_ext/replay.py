"""Makes replay.html of the site, a page that plays a recording, with the commands of docs/seeing.md."""

import contextlib
import io
import shlex
import tempfile
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

from outlast.envs.cli.main import main

ROLLOUT = shlex.split("rollout teams_4 --worlds 1 --steps 700 --policy scripted --seed 1 --quiet --record")


def make(app: Sphinx, error: Exception | None) -> None:
    """Write replay.html beside the other pages."""
    if error or app.builder.format != "html":
        return
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        recording = str(Path(folder) / "fight.rec")
        page = str(Path(app.outdir) / "replay.html")
        for command in ([*ROLLOUT, recording], ["replay", recording, "--quiet", "--html", page]):
            if main(command):
                raise RuntimeError(f"outlast {' '.join(command)} failed")


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the extension; called by Sphinx."""
    app.connect("build-finished", make)
    return {"parallel_read_safe": True}

"""Write the tables of models and of the benchmark's anchors anew: a row for each file in results/.

    python -m perf.training.models

A policy that the table does not have with the same checksum plays 320 games against `scripted`, in ten seconds. The
share that it wins of these is in the table, and all else is read from the files.
"""

import contextlib
import csv
import hashlib
import io
from dataclasses import asdict
from pathlib import Path
from typing import Any

from outlast.envs.rollout.models import TABLE, Model, models
from outlast.envs.storage.kept_results import RESULTS
from outlast.training import policy_file
from outlast.training.benchmark import suite
from outlast.training.episode import recorded_scenario
from outlast.training.evaluation.contenders import contenders
from outlast.training.evaluation.evaluation import Evaluation
from outlast.training.files import write_files

GAMES = 320


def model_of(path: Path) -> Model:
    """Return what the table says about a file of results/policies."""
    name, content = path.relative_to(RESULTS / "policies").with_suffix("").as_posix(), path.read_bytes()
    header, found = policy_file.read_header(path, ("preset", "steps")), checksum(content)
    known = models().get(name)
    wins = known.wins if known and known.sha256 == found else wins_of(path)
    return Model(name, header["preset"], header["steps"], wins, len(content), found)


def wins_of(path: Path) -> float:
    """Return the share of games that a policy wins against `scripted` in the game of its training."""
    game, _ = recorded_scenario(policy_file.read_header(path, ("scenario", "modules")))
    playing = Evaluation(game, contenders({"model": path, "scripted": "scripted"}), episodes=GAMES)
    with contextlib.closing(playing):
        return round(playing.play_pair((0, 1)).estimates(0)["wins"][0], 4)


def main() -> None:
    """Write the tables."""
    policies = sorted((RESULTS / "policies").rglob("*.safetensors"))
    write(TABLE, [asdict(model_of(path)) for path in policies])
    anchors = sorted((RESULTS / "anchors").glob("*.safetensors"))
    write(suite.TABLE, [{"task": path.stem, "sha256": checksum(path.read_bytes())} for path in anchors])


def write(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write a table, whose heads are the keys of its rows."""
    text = io.StringIO()
    table = csv.DictWriter(text, rows[0], lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_files({path: text.getvalue().encode()})


def checksum(content: bytes) -> str:
    """Return the SHA-256 of a file, hexadecimal."""
    return hashlib.sha256(content).hexdigest()


if __name__ == "__main__":
    main()

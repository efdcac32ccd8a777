"""Write the table of models anew: a row for each file in results/policies.

    python -m perf.training.models

A file that the table does not have with the same checksum plays 320 games against `scripted`, ten seconds each. The
share that it wins of these is in the table, and all else is read from the file.
"""

import contextlib
import csv
import hashlib
import io
from dataclasses import asdict, fields
from pathlib import Path

from outlast.envs.rollout.models import RESULTS, TABLE, Model, models
from outlast.envs.storage.atomic_write import atomic_write
from outlast.training import policy_file
from outlast.training.episode import recorded_scenario
from outlast.training.evaluation.contenders import contenders
from outlast.training.evaluation.evaluation import Evaluation

GAMES = 320


def model_of(path: Path) -> Model:
    """Return what the table says about a file of results/policies."""
    name, content = path.relative_to(RESULTS / "policies").with_suffix("").as_posix(), path.read_bytes()
    header, checksum = policy_file.read_header(path, ("preset", "steps")), hashlib.sha256(content).hexdigest()
    known = models().get(name)
    wins = known.wins if known and known.sha256 == checksum else wins_of(path)
    return Model(name, header["preset"], header["steps"], wins, len(content), checksum)


def wins_of(path: Path) -> float:
    """Return the share of games that a policy wins against `scripted` in the game of its training."""
    game, _ = recorded_scenario(policy_file.read_header(path, ("scenario", "modules")))
    playing = Evaluation(game, contenders({"model": path, "scripted": "scripted"}), episodes=GAMES)
    with contextlib.closing(playing):
        return round(playing.play_pair((0, 1)).estimates(0)["wins"][0], 4)


def main() -> None:
    """Write the table."""
    text = io.StringIO()
    rows = csv.DictWriter(text, [field.name for field in fields(Model)], lineterminator="\n")
    rows.writeheader()
    for path in sorted((RESULTS / "policies").rglob("*.safetensors")):
        rows.writerow(asdict(model_of(path)))
    with atomic_write(TABLE) as place:
        place.write_text(text.getvalue(), encoding="utf-8")


if __name__ == "__main__":
    main()

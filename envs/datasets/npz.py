"""Samples as a folder of .npz files, read by numpy.load without pickle."""

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from ..recording.replay import Replay
from ..storage.atomic_write import atomic_write
from .batches import batches, manifest
from .samples import Wish


def export(target: Path, replay: Replay, wish: Wish) -> int:
    """Write shard_000000.npz ... and manifest.json into a new folder; returns the number of agent-steps.

    Each file holds the columns of Samples, "observations/KEY", and "final/KEY" with a row for each sample that is last.
    """
    about, shards, count = manifest(replay), list[dict[str, object]](), 0
    with atomic_write(target) as folder:
        folder.mkdir()
        for number, batch in enumerate(batches(replay, wish)):
            named = {f"observations/{key}": array for key, array in batch.observations.items()}
            named |= {f"final/{key}": array for key, array in batch.final.items()}
            file = f"shard_{number:06d}.npz"
            _save(folder / file, batch.columns | named)
            shards.append({"file": file, "samples": len(batch), "last": int(batch.columns["last"].sum())})
            count += len(batch)
        text = json.dumps(about | {"samples": count, "shards": shards}, indent=1)
        (folder / "manifest.json").write_text(text + "\n", encoding="utf-8")
    return count * int(replay.recording.num_agents)


def _save(path: Path, arrays: dict[str, np.ndarray[Any, Any]]) -> None:
    """As numpy.savez_compressed, at level 1: most of what agents see is zero, and fits into a tenth or less.

    Level 1 writes at half the speed of no compression, and numpy's own level at a fifth.
    """
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for key, array in arrays.items():
            with file.open(f"{key}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, array, allow_pickle=False)

"""Datasets: the samples of a recording in files for other programs; this module itself writes folders of .npz files."""

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import RecordingError
from ..recording import Replay
from ..storage.outputs import atomic_write, check_file, written_to
from .samples import Selection, manifest, read_shards

MINARI = "minari:"
NOTHING = "; no dataset was written"


def export_dataset(path: str, replay: Replay, selection: Selection, flat: bool = False) -> int:
    """Write the selected samples, and return the number of agent-steps.

    path: a folder, for .npz shards and a manifest; NAME.parquet; or minari:NAME-v0. The name must not exist, and
    the dataset appears only when it is complete. flat: for NAME.parquet, a column for each number. Raises
    RecordingError, ReplayError.
    """
    check_new(path)
    target = Path(path)
    with written_to(path, RecordingError, NOTHING):
        if path.startswith(MINARI):
            from .minari import export_minari  # imported here, since its library is optional

            return export_minari(path.removeprefix(MINARI), replay, selection)
        if target.suffix == ".parquet":
            from .parquet import export_parquet

            return export_parquet(target, replay, selection, flat)
        return _export_npz(target, replay, selection)


def check_new(path: str) -> None:
    """Check that a dataset can be written, as far as possible before the replay.

    Raises:
        RecordingError: A dataset of that name exists, the name is not possible, or a library is missing.
    """
    target = Path(path)
    with written_to(path, RecordingError, NOTHING):
        if path.startswith(MINARI):
            from .minari import new_place

            new_place(path.removeprefix(MINARI))
        elif target.suffix not in ("", ".parquet"):
            raise RecordingError(
                f"{path}: export to {target.suffix} is not possible; give a folder without an ending for .npz files, "
                "NAME.parquet or minari:NAME-v0"
            )
        else:
            check_file(target, "datasets", RecordingError, new=True)
            if target.suffix == ".parquet":
                from . import parquet  # noqa: F401  # for the error if a library is missing


def _export_npz(target: Path, replay: Replay, selection: Selection) -> int:
    """Write shard_000000.npz ... and manifest.json into a new folder, and return the number of agent-steps.

    Each file holds the columns of DatasetSamples, "observations/KEY", and "final/KEY" with a row for each sample that
    is last.
    """
    about, shards, count, agent_steps = manifest(replay), list[dict[str, object]](), 0, 0
    with atomic_write(target, new=True) as folder:
        folder.mkdir()
        for number, batch in enumerate(read_shards(replay, selection)):
            named = {f"observations/{key}": array for key, array in batch.observations.items()}
            named |= {f"final/{key}": array for key, array in batch.final.items()}
            file = f"shard_{number:06d}.npz"
            _save(folder / file, batch.columns | named)
            shards.append({"file": file, "samples": len(batch), "last": int(batch.columns["last"].sum())})
            count += len(batch)
            agent_steps += int(batch.present.sum())
        text = json.dumps(about | {"samples": count, "shards": shards}, indent=1)
        (folder / "manifest.json").write_text(text + "\n", encoding="utf-8")
    return agent_steps


def _save(path: Path, arrays: dict[str, np.ndarray[Any, Any]]) -> None:
    """Save arrays as numpy.savez_compressed does, but at level 1.

    Most observed numbers are zero, and shrink to a tenth or less. Level 1 writes at half the speed of no
    compression, and numpy's own level at a fifth.
    """
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for key, array in arrays.items():
            with file.open(f"{key}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, array, allow_pickle=False)

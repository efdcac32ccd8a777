"""Datasets: the samples of a recording in files for other programs: folders of .npz files, Parquet, or Minari."""

import contextlib
import json
import zipfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from ..core.observations import number_names
from ..core.validation import Array
from ..errors import RecordingError, needed
from ..recording import Replay
from ..storage.outputs import atomic_write, check_file, written_to
from .samples import DatasetSamples, Selection, manifest, read_shards

MINARI = "minari:"
NOTHING = "; no dataset was written"
WORLDS = ("world", "episode", "tick")  # columns of .parquet
ENDS = ("terminated", "truncated", "last")
RESERVED = {*WORLDS, "agent", "reward", "alive", *ENDS}


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
            return _export_parquet(target, replay, selection, flat)
        return _export_npz(target, replay, selection)


def check_new(path: str) -> None:
    """Raise RecordingError if a dataset cannot be written, as far as that is known before the replay."""
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
                _arrow()


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
            # as numpy.savez_compressed does, but at level 1, which is five times as fast: most observed
            # numbers are zero, and shrink to a tenth or less anyway
            with zipfile.ZipFile(folder / file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
                for key, array in (batch.columns | named).items():
                    with archive.open(f"{key}.npy", "w", force_zip64=True) as stream:
                        np.lib.format.write_array(stream, array, allow_pickle=False)
            shards.append({"file": file, "samples": len(batch), "last": int(batch.columns["last"].sum())})
            count += len(batch)
            agent_steps += int(batch.present.sum())
        text = json.dumps(about | {"samples": count, "shards": shards}, indent=1)
        (folder / "manifest.json").write_text(text + "\n", encoding="utf-8")
    return agent_steps


def _arrow() -> Any:
    """Import pyarrow, which is optional."""
    with needed("data", ".parquet files need pyarrow", RecordingError):
        import pyarrow
        import pyarrow.parquet

        return pyarrow


def _export_parquet(target: Path, replay: Replay, selection: Selection, flat: bool) -> int:
    """Write a row for each agent-step, and return their number. Agents that are not in an episode have no rows.

    Columns are those of DatasetSamples, `agent`, one for each action, and for each key of the observations two with
    lists of fixed length, "observation_KEY" and "final_KEY"; the latter is null unless the row is the last of its
    episode. The shapes of the lists are in the file's metadata, as JSON under "outlast". With `flat`, two columns for
    each number that an agent observes take the place of the lists: "own_health" and "final_own_health", "others_0_x"
    ...
    """
    about, count = manifest(replay), 0
    names = [column["name"] for column in about["actions"]]
    numbers = _numbers(replay, about["observations"]) if flat else {}
    lists = [(f"observation_{key}", f"final_{key}") for key in about["observations"]]
    taken = RESERVED.union(*([_twice(name) for own in numbers.values() for name in own] if flat else lists))
    if twice := sorted({*names} & taken):
        raise RecordingError(
            f"the action {twice[0]!r} has the name of another column of .parquet; rename it, or write a folder of .npz"
        )
    with atomic_write(target, new=True) as path, contextlib.ExitStack() as files:
        writer = None
        for batch in read_shards(replay, selection):
            table = _table(batch, names, numbers).replace_schema_metadata({"outlast": json.dumps(about)})
            if writer is None:
                file = files.enter_context(path.open("wb"))  # opened here, as Arrow only takes names in UTF-8
                writer = files.enter_context(_arrow().parquet.ParquetWriter(file, table.schema, compression="zstd"))
            writer.write_table(table)
            count += table.num_rows
        if writer is None:
            raise RecordingError("samples are empty: none of the requested worlds took a step in these ticks")
    return count


def _numbers(replay: Replay, shapes: dict[str, list[int]]) -> dict[str, list[str]]:
    """Return, for each key of the observations, the names of its columns. Raises RecordingError if two are the same."""
    fields = replay.worlds.layout.fields
    found = {
        key: [name.replace(".", "_") for name in number_names(key, shape, fields.get(key, {}))]
        for key, shape in shapes.items()
    }
    counts = Counter(name for names in found.values() for each in names for name in _twice(each))
    if twice := [name for name, count in counts.items() if count > 1]:
        raise RecordingError(f"two numbers that agents observe would be called {twice[0]!r}: leave out --flat")
    return found


def _twice(name: str) -> tuple[str, str]:
    """Return the names of the two columns of a number: with the observation of a step, and with the last one."""
    return name, f"final_{name}"


def _table(batch: DatasetSamples, names: list[str], numbers: dict[str, list[str]]) -> Any:
    """Return samples as a table. numbers: the names of columns by key of the observations; empty: lists."""
    pa, columns, agents = _arrow(), batch.columns, batch.columns["actions"].shape[1]
    found = {key: np.repeat(columns[key], agents) for key in WORLDS}
    found["agent"] = np.tile(np.arange(agents, dtype=np.int32), len(batch))
    found |= {name: columns["actions"][:, :, k].ravel() for k, name in enumerate(names)}
    found |= {"reward": columns["rewards"].ravel(), "alive": columns["alive"].ravel()}
    found |= {key: np.repeat(columns[key], agents) for key in ENDS}
    index = np.where(found["last"], np.cumsum(found["last"]) - 1, 0)
    where = pa.array(index, mask=~found["last"])

    def observed(array: Array, key: str) -> dict[str, Any]:
        """Return observations, float32 (n, agents, ...), as columns of n * agents numbers, or lists, by name."""
        if not (size := int(np.prod(array.shape[2:]))):
            return {}
        rows = np.ascontiguousarray(array).reshape(-1, size)
        if numbers:
            return {name: pa.array(rows[:, k]) for k, name in enumerate(numbers[key])}
        return {key: pa.FixedSizeListArray.from_arrays(pa.array(rows.ravel()), size)}

    arrays = {key: pa.array(array) for key, array in found.items()}
    prefix = "" if numbers else "observation_"
    for key, array in batch.observations.items():
        arrays |= {f"{prefix}{name}": column for name, column in observed(array, key).items()}
    for key, array in batch.final.items():  # null but in rows that are the last of their episodes
        for name, column in observed(array, key).items():
            arrays[f"final_{name}"] = column.take(where) if len(column) else pa.nulls(len(where), column.type)
    table = pa.table(arrays)
    return table if batch.present.all() else table.filter(pa.array(batch.present.ravel()))

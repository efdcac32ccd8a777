"""Samples as a Parquet file, with a row for each agent-step."""

import contextlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import RecordingError, install
from ..recording import Replay
from ..storage.atomic_write import atomic_write
from .samples import Samples, Selection, manifest, read_shards

try:
    import pyarrow as pa
    import pyarrow.parquet as pq
except ModuleNotFoundError as error:
    raise ModuleNotFoundError(f".parquet files need pyarrow: {install('data')}", name=error.name) from error

Array = np.ndarray[Any, Any]
WORLDS = ("world", "episode", "tick")
ENDS = ("terminated", "truncated", "last")
RESERVED = {*WORLDS, "agent", "reward", "alive", *ENDS}


def export_parquet(target: Path, replay: Replay, selection: Selection) -> int:
    """Write one file, and return the number of its rows. Agents that an episode lacks have no rows.

    Columns are those of Samples, `agent`, one for each action, and for each key of the observations two with lists of
    fixed length, "observation_KEY" and "final_KEY"; the latter is null unless the row is the last of its episode. The
    shapes of the lists are in the file's metadata, as JSON under "outlast".
    """
    about, count = manifest(replay), 0
    names = [column["name"] for column in about["actions"]]
    if taken := sorted({*names} & RESERVED):
        raise RecordingError(
            f"the action {taken[0]!r} has the name of another column of .parquet; rename it, or write a folder of .npz"
        )
    with atomic_write(target, new=True) as path, contextlib.ExitStack() as files:
        writer = None
        for batch in read_shards(replay, selection):
            table = _table(batch, names).replace_schema_metadata({"outlast": json.dumps(about)})
            if writer is None:
                file = files.enter_context(path.open("wb"))  # opened here, as Arrow only takes names in UTF-8
                writer = files.enter_context(pq.ParquetWriter(file, table.schema, compression="zstd"))
            writer.write_table(table)
            count += table.num_rows
        if writer is None:
            raise RecordingError("there are no samples: no world that was asked for took a step in these ticks")
    return count


def _table(batch: Samples, names: list[str]) -> Any:
    columns, agents = batch.columns, batch.columns["actions"].shape[1]
    found = {key: np.repeat(columns[key], agents) for key in WORLDS}
    found["agent"] = np.tile(np.arange(agents, dtype=np.int32), len(batch))
    found |= {name: columns["actions"][:, :, k].ravel() for k, name in enumerate(names)}
    found |= {"reward": columns["rewards"].ravel(), "alive": columns["alive"].ravel()}
    found |= {key: np.repeat(columns[key], agents) for key in ENDS}
    arrays = {key: pa.array(array) for key, array in found.items()}
    for key, array in batch.observations.items():
        if array[0].size:
            arrays[f"observation_{key}"] = _lists(array)
    for key, array in batch.final.items():
        if int(np.prod(array.shape[1:])):
            arrays[f"final_{key}"] = _sparse(array, found["last"])
    table = pa.table(arrays)
    return table if batch.present.all() else table.filter(pa.array(batch.present.ravel()))


def _lists(array: Array) -> Any:
    """Return float32 (n, agents, ...) as n * agents lists."""
    size = int(np.prod(array.shape[2:]))
    return pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(array).ravel()), size)


def _sparse(array: Array, where: Array) -> Any:
    """Return a list wherever `where` is true, taken from `array` in turn, and null elsewhere."""
    index = np.where(where, np.cumsum(where) - 1, 0)
    return _lists(array).take(pa.array(index, mask=~where)) if len(array) else pa.nulls(len(where), _lists(array).type)

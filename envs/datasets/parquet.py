"""Samples as a Parquet file, with a row for each agent-step."""

import contextlib
import json
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from ..core.observations import number_names
from ..core.validation import Array
from ..errors import RecordingError, needed
from ..recording import Replay
from ..storage.outputs import atomic_write
from .samples import DatasetSamples, Selection, manifest, read_shards

with needed("data", ".parquet files need pyarrow", RecordingError):
    import pyarrow as pa
    import pyarrow.parquet as pq

WORLDS = ("world", "episode", "tick")
ENDS = ("terminated", "truncated", "last")
RESERVED = {*WORLDS, "agent", "reward", "alive", *ENDS}


def export_parquet(target: Path, replay: Replay, selection: Selection, flat: bool = False) -> int:
    """Write one file, and return the number of its rows. Agents that are not in an episode have no rows.

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
                writer = files.enter_context(pq.ParquetWriter(file, table.schema, compression="zstd"))
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
    columns, agents = batch.columns, batch.columns["actions"].shape[1]
    found = {key: np.repeat(columns[key], agents) for key in WORLDS}
    found["agent"] = np.tile(np.arange(agents, dtype=np.int32), len(batch))
    found |= {name: columns["actions"][:, :, k].ravel() for k, name in enumerate(names)}
    found |= {"reward": columns["rewards"].ravel(), "alive": columns["alive"].ravel()}
    found |= {key: np.repeat(columns[key], agents) for key in ENDS}
    arrays = {key: pa.array(array) for key, array in found.items()}
    prefix = "" if numbers else "observation_"
    for key, array in batch.observations.items():
        arrays |= {f"{prefix}{name}": column for name, column in _observed(array, key, numbers).items()}
    index = np.where(found["last"], np.cumsum(found["last"]) - 1, 0)
    where = pa.array(index, mask=~found["last"])
    for key, array in batch.final.items():
        arrays |= {f"final_{name}": _taken(column, where) for name, column in _observed(array, key, numbers).items()}
    table = pa.table(arrays)
    return table if batch.present.all() else table.filter(pa.array(batch.present.ravel()))


def _observed(array: Array, key: str, numbers: dict[str, list[str]]) -> dict[str, Any]:
    """Return observations, float32 (n, agents, ...), as columns of n * agents numbers, or lists, by name."""
    size = int(np.prod(array.shape[2:]))
    if not size:
        return {}
    rows = np.ascontiguousarray(array).reshape(-1, size)
    if numbers:
        return {name: pa.array(rows[:, k]) for k, name in enumerate(numbers[key])}
    return {key: pa.FixedSizeListArray.from_arrays(pa.array(rows.ravel()), size)}


def _taken(column: Any, where: Any) -> Any:
    """Return the entries of a column at the positions `where`, and null where that is null."""
    return column.take(where) if len(column) else pa.nulls(len(where), column.type)

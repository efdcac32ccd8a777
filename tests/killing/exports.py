"""Writers of exports of a recording; what each may leave when it is killed."""

import contextlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

from outlast import make_vec, record
from outlast.envs.storage.atomic_write import is_temporary
from tests.killing.writer import AtomicOutput, Writer, same_bytes


class Export(AtomicOutput):
    """outlast replay, of a recording that is made first. Datasets are not overwritten."""

    @property
    def keeps_existing(self) -> bool:  # type: ignore[override]
        return "--data" in self.arguments

    def prepare(self, folder: Path) -> None:
        with contextlib.closing(make_vec("teams_3", 32, seed=5)) as env, record(env, folder / "a.rec"):
            rng = np.random.default_rng(0)
            env.reset()
            for _ in range(150):
                env.step(rng.integers(0, env.action_sizes, (32, 4, len(env.action_sizes))))


def replayed(name: str, product: str, option: str, equal: Callable[[Path, Path], None], *more: str) -> Export:
    command = ("outlast", "replay", "{folder}/a.rec", option, "{out}", "--quiet", *more)
    return Export(f"replay {name}", product, command, equal)


def same_parquet(path: Path, expected: Path) -> None:
    import pyarrow.parquet as pq

    assert pq.read_table(path).equals(pq.read_table(expected))


def same_shards(path: Path, expected: Path) -> None:
    assert [file.name for file in path.iterdir() if is_temporary(file)] == []
    assert sorted(file.name for file in path.iterdir()) == sorted(file.name for file in expected.iterdir())
    assert (path / "manifest.json").read_text() == (expected / "manifest.json").read_text()
    for file in path.glob("*.npz"):
        one, other = np.load(file), np.load(expected / file.name)
        assert one.files == other.files
        assert all(np.array_equal(one[key], other[key]) for key in one.files)


class Minari(Export):
    """outlast replay --data minari:NAME-v0."""

    def __init__(self) -> None:
        command = ("outlast", "replay", "{folder}/a.rec", "--data", "minari:duel-v0", "--worlds", "0,1", "--quiet")
        super().__init__("replay minari", "minari/duel-v0", command, same_minari)

    def prepare(self, folder: Path) -> None:
        super().prepare(folder)
        (folder / "minari").mkdir()

    def environment(self, folder: Path) -> dict[str, str]:
        return {"MINARI_DATASETS_PATH": str(folder / "minari")}


def same_minari(path: Path, expected: Path) -> None:
    from minari.dataset.minari_dataset import MinariDataset

    one, other = (MinariDataset(folder / "data") for folder in (path, expected))
    assert (one.total_episodes, one.total_steps) == (other.total_episodes, other.total_steps)
    assert len(list(one.iterate_episodes())) == len(list(other.iterate_episodes()))


WRITERS: list[Writer] = [
    replayed("samples.parquet", "data.parquet", "--data", same_parquet),
    replayed("shards", "data", "--data", same_shards),
    replayed("page", "page.html", "--html", same_bytes, "--worlds", "0,1,2"),
    Minari(),
]

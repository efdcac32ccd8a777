"""Models: trained policies that are kept with outlast, by name. models.csv lists them."""

import csv
import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from ..storage.kept_results import kept_file

TABLE = Path(__file__).with_name("models.csv")


@dataclass(frozen=True)
class Model:
    """A trained policy that is kept.

    Attributes:
        name: GAME/KIND-SEED; the seed is that of its training.
        preset: The preset that it was trained with.
        steps: Agent-steps of its training.
        wins: Share of games that it wins against `scripted`, where a draw counts as half.
        size: Bytes of its file.
        sha256: Checksum of its file.
    """

    name: str
    preset: str
    steps: int
    wins: float
    size: int
    sha256: str

    @property
    def seed(self) -> int:
        """The seed of its training."""
        return int(self.name.rpartition("-")[2])

    @property
    def file(self) -> str:
        """The path of its file in the results."""
        return f"policies/{self.name}.safetensors"


@functools.cache
def models() -> Mapping[str, Model]:
    """Return all models by name, in the order of the table."""
    with TABLE.open(encoding="utf-8", newline="") as file:
        rows = [*csv.DictReader(file)]
    found = (
        Model(row["name"], row["preset"], int(row["steps"]), float(row["wins"]), int(row["size"]), row["sha256"])
        for row in rows
    )
    return MappingProxyType({model.name: model for model in found})


def fetched(name: str) -> Path:
    """Return the file of a model, which has the checksum of the table.

    Raises:
        UsageError: The file cannot be had.
    """
    model = models()[name]
    return kept_file(model.file, model.sha256, name)

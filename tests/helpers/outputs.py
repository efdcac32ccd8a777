"""Reads the files and summaries that outlast makes."""

import csv
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from outlast.envs.rollout.summary import Summary


def pictures(folder: Path) -> np.ndarray[Any, Any]:
    """The frames, in RGB, of a film that was written as a folder of pictures."""
    return np.array([cv2.imread(str(file))[..., ::-1] for file in sorted(folder.glob("frame_*.png"))])


def rows_of(path: Path) -> list[dict[str, Any]]:
    """The rows of a table in a .csv file, by its header."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def length(summary: Summary) -> tuple[float, float]:
    """The mean length of the episodes of a rollout, and its standard error."""
    return next((mean, error) for name, mean, error in summary.rows() if name == "length")

"""What is kept of a run, small enough to be shared: its curves, and the policy that came out. Needs no PyTorch."""

import io
import zipfile
from collections.abc import Sequence
from pathlib import Path

from . import header
from .results import Result, keepable

POLICY = "policy.pt"


def files(results: Sequence[Result], folder: Path) -> dict[Path, bytes]:
    """What to write into a folder, by path. Raises TrainingError where another run would be lost."""
    contents = {path: text.encode() for path, text in keepable(results, folder).items()}
    for path, result in zip(list(contents), results, strict=True):
        if source := _newest(result.origin):
            contents[path.with_suffix(".zip")] = policy(source)
    return contents


def policy(checkpoint: Path) -> bytes:
    """A checkpoint without what only its own run needs to go on: it plays, but cannot be resumed."""
    kept, file = header.read(checkpoint, (POLICY,), ())[1], io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name in (header.NAME, POLICY):
            archive.writestr(zipfile.ZipInfo(name), kept[name])  # without the time of day
    return file.getvalue()


def _newest(origin: Path) -> Path | None:
    """The last checkpoint of a run's folder, or the policy beside a kept file."""
    found = sorted(origin.glob("steps_*.zip")) if origin.is_dir() else [origin.with_suffix(".zip")]
    return found[-1] if found and found[-1].exists() else None

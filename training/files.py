"""Reading text and writing files, with errors that name the file."""

from collections.abc import Mapping
from pathlib import Path

from outlast.envs.storage.atomic_write import atomic_write

from .errors import TrainingError


def read_text(path: Path) -> str:
    """Return the content of a text file. Raises TrainingError if it cannot be read."""
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise TrainingError(f"{path} cannot be read: {getattr(error, 'strerror', None) or 'it is no text'}") from error


def write_files(contents: Mapping[Path, bytes]) -> None:
    """Write files, each completely or not at all. Raises TrainingError."""
    for path, content in contents.items():
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(path) as place:
                place.write_bytes(content)
        except OSError as error:
            raise TrainingError(f"{path} cannot be written: {error.strerror}") from error

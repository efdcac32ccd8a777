"""Entries as one file, ENTRY.zip, to hand in and to publish: a manifest with its results, policies and matches."""

import contextlib
import io
import lzma
import re
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

from ..base import policy_file
from ..base.errors import TrainingError
from ..base.files import read_bytes, write_files
from . import manifest, result, scores
from .entry import entries_of
from .games import SUFFIX

PART = r"\w[\w.+-]*"
NAMES = re.compile(rf"manifest\.json|scores\.json|{PART}/{PART}/\d+/(result\.json|{PART}\.(safetensors|npz))")
LARGEST, MOST, MANY = 2**28, 2**30, 100_000  # maximum bytes of an archive and of all it holds, maximum files
BROKEN = zipfile.BadZipFile, zlib.error, lzma.LZMAError, NotImplementedError, RuntimeError, EOFError, OSError
FIRST = (1980, 1, 1, 0, 0, 0)  # the date of all files: equal results give equal bytes


def pack(folder: Path, path: Path, small: bool = False) -> int:
    """Write the results in a folder to an archive, and return its bytes. Raises TrainingError.

    small: Whether to leave out candidates, best responses, the actions of functions, and of all seeds but the first
    also policies and matches. Then most matches cannot be verified.
    """
    own = manifest.read(folder)
    names = [manifest.NAME, *([scores.NAME] if (folder / scores.NAME).exists() else [])]
    functions = {result.AGENT + name for name, agent in own.agents.items() if agent.function}
    for entry in entries_of(own):
        files = [each for suffix in (policy_file.SUFFIX, SUFFIX) for each in sorted(entry.folder.glob(f"*{suffix}"))]
        if small:
            kept = {each.file for each in entry.matches if each.candidate < 0 and each.against not in functions}
            first = entry.first and not entry.agent.function
            files = [each for each in files if first and each.name in kept | {entry.policy().name}]
        if entry.content["policy"] is not None:
            names += [str(each.relative_to(folder)) for each in (entry.folder / result.NAME, *files)]
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in names:
            archive.writestr(zipfile.ZipInfo(name, FIRST), read_bytes(folder / name), zipfile.ZIP_DEFLATED, 9)
    write_files({path: content.getvalue()})
    return len(content.getvalue())


@contextlib.contextmanager
def opened(place: Path) -> Iterator[Path]:
    """Yield a folder of results: `place` itself, or the content of an archive. Raises TrainingError: it is neither."""
    if place.is_dir():
        yield place
        return
    if not place.is_file():
        raise TrainingError(f"{place} does not exist: name a folder of results, or an archive ENTRY.zip")
    with tempfile.TemporaryDirectory() as folder:
        try:
            with zipfile.ZipFile(io.BytesIO(read_bytes(place, LARGEST))) as archive:
                infos = archive.infolist()
                if len(infos) > MANY or sum(info.file_size for info in infos) > MOST:
                    raise TrainingError(f"{place} holds more than {MANY:,} files or {MOST:,} bytes")
                for info in infos:
                    if NAMES.fullmatch(info.filename) is None or Path(folder, info.filename).exists():
                        raise TrainingError(f"{place} holds {info.filename!r:.80}, which no result is called, or twice")
                    write_files({Path(folder, info.filename): archive.read(info)})
        except BROKEN as error:
            raise TrainingError(f"{place} is not an archive of results: {error}") from error
        if not Path(folder, manifest.NAME).exists():
            raise TrainingError(f"{place} does not hold {manifest.NAME}: make an archive by `outlast benchmark pack`")
        yield Path(folder)

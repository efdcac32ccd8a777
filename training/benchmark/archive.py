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
from .games import SUFFIX

PART = r"\w[\w.+-]*"
NAMES = re.compile(rf"manifest\.json|scores\.json|{PART}/{PART}/\d+/(result\.json|{PART}\.(safetensors|npz))")
LARGEST, MOST, MANY = 2**28, 2**30, 100_000  # maximum bytes of an archive and of all it holds, maximum files
BROKEN = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError),
    *(NotImplementedError, RuntimeError, EOFError, OSError),
)  # what reading may raise
FIRST = (1980, 1, 1, 0, 0, 0)  # the date of all files: equal results give equal bytes


def pack(folder: Path, path: Path, small: bool = False) -> int:
    """Write the results in a folder to an archive, and return its bytes. Raises TrainingError.

    small: Whether to leave out what publications need not have: candidates, best responses, the actions of functions,
    and of all seeds but the first also policies and matches. Then most matches cannot be verified.
    """
    own = manifest.read(folder)
    names = [manifest.NAME, *([scores.NAME] if (folder / scores.NAME).exists() else [])]
    functions = {result.AGENT + name for name, agent in own.agents.items() if agent.function}
    for name, task, seed in own.entries():
        found = own.result(name, task, seed)
        files = [*sorted(found.folder.glob(f"*{policy_file.SUFFIX}")), *sorted(found.folder.glob(f"*{SUFFIX}"))]
        if small:
            kept = {each.file for each in found.matches if each.candidate < 0 and each.against not in functions}
            first = seed == own.content["seeds"][0] and not own.agents[name].function
            files = [each for each in files if first and each.name in kept | {found.policy().name}]
        if found.content["policy"] is not None:
            names += [str(each.relative_to(folder)) for each in (found.folder / result.NAME, *files)]
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name in names:
            archive.writestr(zipfile.ZipInfo(name, FIRST), read_bytes(folder / name), zipfile.ZIP_DEFLATED, 9)
    write_files({path: content.getvalue()})
    return len(content.getvalue())


@contextlib.contextmanager
def opened(place: Path) -> Iterator[Path]:
    """Yield a folder of results: `place` itself, or the content of an archive, for as long as the context is open.

    Raises TrainingError: it is neither, or it holds other files than archives do.
    """
    if place.is_dir():
        yield place
        return
    if not place.is_file():
        raise TrainingError(f"{place} does not exist: name a folder of results, or an archive ENTRY.zip")
    with tempfile.TemporaryDirectory() as folder:
        try:
            with zipfile.ZipFile(io.BytesIO(read_bytes(place, LARGEST))) as archive:
                infos = archive.infolist()
                if len({info.filename for info in infos}) < len(infos):
                    raise TrainingError(f"{place} holds two files of one name")
                if len(infos) > MANY or sum(info.file_size for info in infos) > MOST:
                    raise TrainingError(f"{place} holds more than {MANY:,} files or {MOST:,} bytes")
                for info in infos:
                    if NAMES.fullmatch(info.filename) is None:
                        raise TrainingError(f"{place} holds {info.filename!r:.80}, which no result is called")
                    write_files({Path(folder, info.filename): archive.read(info)})
        except BROKEN as error:
            raise TrainingError(f"{place} is not an archive of results: {error}") from error
        if not Path(folder, manifest.NAME).exists():
            raise TrainingError(f"{place} does not hold {manifest.NAME}: make an archive by `outlast benchmark pack`")
        yield Path(folder)

"""Files and folders to write: checked before any work is done for them, locked, and complete or absent in the end.

They are written beside their target and replace it at the end. A process that is killed leaves its temporary file,
`.NAME-XXXXXXXX.tmp` with eight hexadecimal digits: nothing reads it, and it can be deleted.

All writers follow symbolic links: they replace the target of a link, and the link stays.
"""

import contextlib
import errno
import fnmatch
import itertools
import os
import platform
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from outlast.ecs.kernels.file_lock import try_lock, unlock

LONGEST = 200  # bytes of the target's name in that of a temporary file: most file systems allow 255 in all
SHARED = (5, 32)  # errors of Windows: another process has the file open
PATIENCE = 5.0  # seconds to wait until it closes the file
TEMPORARY = re.compile(r"\.(.+)-[0-9a-f]{8}\.tmp")
LOCK, OWNER = ".lock", ".owner"  # names of files: the locked one; without locks, the one that names a process
OLD = 86_400.0  # seconds after which a temporary file is no longer being written


@contextlib.contextmanager
def written_to(path: str | os.PathLike[str], error: type[Exception], more: str = "") -> Iterator[None]:
    """Turn errors of the disk into `error`, which names the path that is written to. more: What follows the reason."""
    try:
        yield
    except FileExistsError as reason:  # another process has written it, see atomic_write
        raise error(f"{path} exists, {reason.strerror}") from reason
    except OSError as reason:
        raise error(f"{path} cannot be written: {reason.strerror or reason}{more}") from reason


def check_file(
    path: str | os.PathLike[str], what: str, error: type[Exception], *, endings: Sequence[str] = (), new: bool = False
) -> Path:
    """Return the path of a file or folder, after checking that it can be written. Leaves no file there.

    what: its content, in the plural, for messages: "events". endings: those of its name that are allowed; empty: all.
    Raises `error` if it has another ending, exists although it must be `new`, is a folder, or cannot be written.
    """
    target = Path(path)
    if endings and target.suffix not in endings:
        raise error(f"{target}: {what} are written as {' or '.join(f'NAME{ending}' for ending in endings)}")
    with written_to(target, error):
        there = target.exists()
        if there and new:
            raise error(f"{target} exists; {what} never overwrite files: give another name, or delete it")
        if target.is_dir():
            raise error(f"{target} cannot be written: it is a folder")
        real = Path(os.path.realpath(target))
        if not real.parent.is_dir():
            folder = real.parent if target.is_symlink() else target.parent
            raise error(f"{target} cannot be written: there is no folder {folder}")
        if not there or target.is_file():  # a device is written to directly
            _probe(real)
    return target


def check_folder(path: str | os.PathLike[str], error: type[Exception]) -> Path:
    """Return the path of a folder that is writable, or can be created with its parents; or raise `error`."""
    target = Path(path)
    try:
        around = next(each for each in (target, *target.absolute().parents) if each.exists() or each.is_symlink())
        if not around.is_dir():
            raise error(f"{target} cannot be a folder: {around} is a file")
        _probe(Path(os.path.realpath(around)) / "probe")
    except OSError as reason:
        raise error(f"{target} cannot be written into: {reason.strerror or reason}") from reason
    return target


def _probe(target: Path) -> None:
    """Create an empty temporary file beside the target, and delete it. Raises OSError."""
    place = temporary_path(target)
    os.close(os.open(place, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600))
    place.unlink()


def temporary_path(target: Path) -> Path:
    """Return a new path beside the target, for a temporary file that will take its place."""
    name = target.name
    if len(os.fsencode(name)) > LONGEST:
        name = os.fsencode(name)[:LONGEST].decode(errors="ignore")
    return target.with_name(f".{name}-{secrets.token_hex(4)}.tmp")


def target_name(path: Path) -> str:
    """Return the name of the file that a temporary file replaces when it is complete; "" for any other file."""
    found = TEMPORARY.fullmatch(path.name)
    return found[1] if found else ""


def remove(path: Path) -> None:
    """Delete a file or a folder, if it exists."""
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            _patiently(lambda: path.unlink(missing_ok=True), path)


def replace(path: Path, target: Path) -> None:
    """Move a file or folder to the target and replace that.

    Windows refuses this while another process has the target open, as `outlast watch` has the checkpoint that it reads.
    Raises OSError, in that case after PATIENCE seconds.
    """
    _patiently(lambda: os.replace(path, target), target)


def _patiently(act: Callable[[], None], path: Path) -> None:
    """Act on a file; on Windows, retry for a while if another process has it open."""
    end = time.monotonic() + PATIENCE
    while True:
        try:
            return act()
        except PermissionError as error:
            if getattr(error, "winerror", None) not in SHARED:
                raise
            if time.monotonic() > end:
                reason = f"{error.strerror}; another program has it open"
                raise PermissionError(error.errno, reason, str(path)) from error
            time.sleep(0.05)


@contextlib.contextmanager
def atomic_write(target: Path, *, new: bool = False) -> Iterator[Path]:
    """Yield a path beside the target, for a file or folder that replaces the target if all goes well.

    Otherwise it is removed. If the target is a link, its target is replaced. If the target is neither a file nor
    a folder, such as a device, it is written to directly.

    new: Whether the target was not there before. If another process has written it, it is not replaced: the content is
    kept as NAME-2, and FileExistsError has that name.
    """
    if target.exists() and not target.is_file() and not target.is_dir():
        yield target
        return
    given, target = target, Path(os.path.realpath(target))
    if not target.parent.is_dir():
        parent = target.parent if given.is_symlink() else given.parent
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(parent))
    path = temporary_path(target)
    try:
        yield path
        if target.is_dir() and not path.is_dir():
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(given))
        if not new:
            replace(path, target)
            return
        for number in itertools.count(1):
            place = target if number == 1 else target.with_stem(f"{target.stem}-{number}")
            with contextlib.suppress(FileExistsError):
                add(path, place)
                break
        if place != target:
            reason = f"as another process has just written it; this is in {place}"
            raise FileExistsError(errno.EEXIST, reason, str(target))
    finally:
        remove(path)


def add(path: Path, target: Path) -> None:
    """Give a file or folder a name. Raises OSError; FileExistsError if the name is taken."""
    try:
        os.link(path, target)  # unlike renaming, this never replaces a file
    except FileExistsError:
        raise
    except OSError:  # a folder, or a file system without hard links
        if target.exists():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(target)) from None
        replace(path, target)
    else:
        remove(path)


class FolderLock:
    """A lock that keeps other processes out of a folder until `release`, or until this process ends for any reason.

    It locks a file in the folder, which it opens for writing, as NFS requires. On file systems without locks, a
    file that names the process keeps others out; if the process is killed, the file stays; it is then ignored on the
    same machine, and must be deleted on others.

    does: what its holder does, for messages. writes: patterns of the names of files that only its holder writes.
    """

    def __init__(self, folder: Path, does: str = "writes into it", writes: Sequence[str] = ()) -> None:
        self.folder, self.does, self.writes = folder, does, writes
        self._handle, self._file, self._owner = -1, folder / LOCK, 0

    def acquire(self) -> None:
        """Create the folder if it is missing, lock it, and remove temporary files of killed processes.

        Files that another process may be writing are kept: those that `writes` does not match, and without locks all of
        them, unless they are old. Raises BlockingIOError if another process or FolderLock has locked it, or OSError.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        if not self._lock():
            self._own()
        self._owner = os.getpid()
        for path in filter(target_name, list(self.folder.iterdir())):
            own = any(fnmatch.fnmatchcase(target_name(path), pattern) for pattern in self.writes)
            if (own and self._handle >= 0) or time.time() - _written(path) > OLD:
                remove(path)

    def _lock(self) -> bool:
        """Lock the file, and return whether files can be locked here. Raises BlockingIOError."""
        self._file = self.folder / LOCK
        while True:
            handle = os.open(self._file, os.O_RDWR | os.O_CREAT, 0o666)
            locked = try_lock(handle)
            with contextlib.suppress(FileNotFoundError):  # the previous holder may have just deleted the file
                if locked and os.path.samestat(self._file.stat(), os.fstat(handle)):
                    self._handle = handle
                    return True
            os.close(handle)
            if locked is None:
                self._file.unlink(missing_ok=True)
                return False
            if not locked:
                raise self._taken("")

    def _own(self) -> None:
        """Create the file that names this process. Raises BlockingIOError."""
        self._file = self.folder / OWNER
        host, other = platform.node(), ""
        with contextlib.suppress(OSError, UnicodeDecodeError):
            other = self._file.read_text(encoding="utf-8")
        if other.startswith(f"{host} ") and not _is_alive(other.removeprefix(f"{host} ")):
            self._file.unlink(missing_ok=True)
        try:
            handle = os.open(self._file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
        except FileExistsError:
            cure = f"; files cannot be locked here, so if process {other} was killed, delete {self._file}"
            raise self._taken(cure) from None
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(f"{host} {os.getpid()}")

    def _taken(self, cure: str) -> BlockingIOError:
        ways = "wait until it ends, stop it, or choose another --out"
        return BlockingIOError(f"{self.folder}: another process {self.does}; {ways}{cure}")

    def release(self) -> None:
        """Unlock the folder; may be called repeatedly."""
        handle, owner, self._handle, self._owner = self._handle, self._owner, -1, 0
        if owner == os.getpid():  # not in a fork, which has the same file open
            if os.name != "nt":  # Windows does not delete open files
                with contextlib.suppress(OSError):  # before unlocking it: afterwards another process may lock it
                    self._file.unlink()
            if handle >= 0:
                unlock(handle)
        if handle >= 0:
            os.close(handle)

    __del__ = release


def is_lock(path: Path) -> bool:
    """Return whether it is a file of a FolderLock, also one that was deleted while a process of NFS had it open."""
    return path.name in (LOCK, OWNER) or path.name.startswith(".nfs")


def _is_alive(pid: str) -> bool:
    """Return whether a process of this machine may have that number."""
    if not pid.isdecimal() or os.name != "posix":  # os.kill would end it on Windows
        return True
    try:
        os.kill(int(pid), 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


def _written(path: Path) -> float:
    """Return the time of the last change of a file, or of the files of a folder; now, if it is gone."""
    try:
        return float(max(each.stat().st_mtime for each in (path, *(path.iterdir() if path.is_dir() else ()))))
    except OSError:
        return time.time()

"""Locks of folders: on local disks, on NFS, on file systems without locks, and as Windows has them."""

import errno
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from outlast.ecs.kernels import file_lock
from outlast.envs.storage import outputs
from outlast.envs.storage.outputs import OLD, OWNER, FolderLock, is_lock, temporary_path

fcntl = pytest.importorskip("fcntl", reason="file systems are pretended by means of POSIX")
real: Callable[[int, int], None] = fcntl.flock
WITHOUT = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)


def nfs(handle: int, operation: int) -> None:
    """Lock as NFS does: files that are open for writing only, and no folders."""
    if fcntl.fcntl(handle, fcntl.F_GETFL) & os.O_ACCMODE == os.O_RDONLY:
        raise OSError(errno.EBADF, "Bad file descriptor")
    real(handle, operation)


class Msvcrt:
    """The locks of Windows, on one byte of a file, by means of those of POSIX."""

    LK_NBLCK, LK_UNLCK = 2, 0

    @staticmethod
    def locking(handle: int, mode: int, count: int) -> None:
        try:
            real(handle, fcntl.LOCK_UN if mode == Msvcrt.LK_UNLCK else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise PermissionError(errno.EACCES, "Permission denied") from None


@pytest.fixture(params=["local", "NFS", "Windows", *WITHOUT])
def system(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A file system on which folders are locked."""

    def cannot(handle: int, operation: int) -> None:
        raise OSError(request.param, os.strerror(request.param))

    if request.param == "Windows":
        monkeypatch.setattr(file_lock, "msvcrt", Msvcrt)
    elif request.param != "local":
        monkeypatch.setattr(fcntl, "flock", nfs if request.param == "NFS" else cannot)
    return request.param


def test_the_second_is_refused_and_no_file_of_the_first_is_lost(tmp_path: Path, system: Any) -> None:
    first = FolderLock(tmp_path / "run", "trains this run", ("steps_*",))
    first.acquire()
    being_written = temporary_path(tmp_path / "run/steps_1.zip")
    being_written.write_text("half")
    with pytest.raises(BlockingIOError, match="run: another process trains this run; wait until it ends, stop it, or"):
        FolderLock(tmp_path / "run", "trains this run", ("steps_*",)).acquire()
    assert being_written.exists()
    first.release()
    first.release()
    second = FolderLock(tmp_path / "run", "trains this run", ("steps_*",))
    second.acquire()
    assert being_written.exists() is (system in WITHOUT)  # nobody knows there that its writer has ended
    os.utime(being_written, times=(0, 0)) if being_written.exists() else None
    second.release()
    second.acquire()
    assert [path for path in (tmp_path / "run").iterdir() if not is_lock(path)] == []
    second.release()


def test_no_file_stays_behind(tmp_path: Path) -> None:
    lock = FolderLock(tmp_path)
    lock.acquire()
    assert [path.name for path in tmp_path.iterdir() if is_lock(path)] == [".lock"]
    lock.release()
    assert [*tmp_path.iterdir()] == []


def test_what_others_write_into_the_folder_is_theirs_until_it_is_old(tmp_path: Path) -> None:
    """As a film of `outlast frames`, which is made in a folder of its own."""
    film = temporary_path(tmp_path / "film.webm")
    film.mkdir()
    (film / "film.webm").write_text("half")
    lock = FolderLock(tmp_path, writes=("steps_*",))
    for age, there in ((0.9 * OLD, True), (1.1 * OLD, False)):
        written = outputs.time.time() - age
        os.utime(film / "film.webm", times=(written, written))
        os.utime(film, times=(0, 0))
        lock.acquire()
        lock.release()
        assert film.exists() is there


@pytest.mark.parametrize("who", ["killed", "alive", "on another machine", "unknown"])
def test_without_locks_only_a_process_that_is_known_to_have_ended_lets_others_in(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, who: str
) -> None:
    def cannot(handle: int, operation: int) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", cannot)
    with subprocess.Popen([sys.executable, "-c", ""]) as ended:
        pass
    host, pid = platform.node(), ended.pid
    text = {"killed": f"{host} {pid}", "alive": f"{host} 1", "on another machine": f"node7 {pid}", "unknown": ""}[who]
    (tmp_path / OWNER).write_text(text)
    lock = FolderLock(tmp_path)
    if who == "killed":
        lock.acquire()
        lock.release()
        assert [*tmp_path.iterdir()] == []
        return
    with pytest.raises(BlockingIOError, match=f"so if process {text} was killed, delete .*{OWNER}"):
        lock.acquire()
    lock.release()
    assert [path.name for path in tmp_path.iterdir()] == [OWNER]


def test_a_file_that_its_last_holder_deletes_meanwhile_is_locked_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise two processes would have a lock, of which one is on a file that is gone."""

    def late(handle: int, operation: int) -> None:
        (tmp_path / ".lock").unlink()
        monkeypatch.undo()
        real(handle, operation)

    monkeypatch.setattr(fcntl, "flock", late)
    lock = FolderLock(tmp_path)
    lock.acquire()
    with pytest.raises(BlockingIOError):
        FolderLock(tmp_path).acquire()
    lock.release()


def test_a_fork_does_not_unlock_it(tmp_path: Path) -> None:
    lock = FolderLock(tmp_path)
    lock.acquire()
    pid = os.fork()
    if not pid:
        lock.release()
        os._exit(0)
    os.waitpid(pid, 0)
    with pytest.raises(BlockingIOError):
        FolderLock(tmp_path).acquire()
    lock.release()

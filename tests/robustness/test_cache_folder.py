"""The compile cache: filled by several processes at once, damaged, on a full disk, not writable, or others' as well."""

import compileall
import contextlib
import errno
import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import outlast
from outlast.ecs import kernel
from outlast.ecs.compilation import cache
from outlast.ecs.compilation.cache import CompiledUnits
from outlast.ecs.kernels import cache_files
from outlast.ecs.kernels.cache_files import cache_folder, cache_folders, is_private, one_at_a_time
from outlast.ecs.kernels.machine_code import Code
from tests.engine.test_compile import ROOT, SCRIPT, in_process

DIGEST = 2  # the index of the digest in the output of a process


def test_one_process_compiles_at_a_time(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    waits = list[float]()
    monkeypatch.setattr(cache_files.time, "sleep", waits.append)
    monkeypatch.setattr(cache_files, "PATIENCE", 0.05)
    for waiting in (False, True, False):
        with one_at_a_time() if waiting else contextlib.nullcontext(), one_at_a_time():
            assert bool(waits) == waiting
        waits.clear()


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform == "win32", reason="limits are those of POSIX")
def test_a_full_disk_costs_no_more_than_the_cache(tmp_path: Path) -> None:
    """The largest allowed file is smaller than the code, so that writing it fails midway."""
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (2_000, 2_000))\n"
    done = worlds_made(limit + SCRIPT.format(game=ROOT, root=ROOT, module="tests.helpers.toy_game"), tmp_path)
    assert done.returncode == 0, done.stderr
    assert "compiled code is not kept" in done.stderr


def worlds_made(script: str, cache: Path) -> subprocess.CompletedProcess[str]:
    """A process that makes worlds."""
    environment = os.environ | {"OUTLAST_CACHE_DIR": str(cache)}
    return subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=250)


def refuse(*_: Any) -> None:
    raise PermissionError(errno.EACCES, "Access is denied")


posix_only = pytest.mark.skipif(os.name != "posix", reason="users, modes and links are those of POSIX")
OWN = f"outlast-{os.geteuid() if os.name == 'posix' else ''}"
CODE = Code("symbol", b"image", {"name": [1, "two"]}, ["malloc"])


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user with a home, a working directory, and a folder of temporary files for all."""
    for name, mode in (("home", 0o755), ("start", 0o755), ("temporary", 0o1777)):
        (tmp_path / name).mkdir()
        (tmp_path / name).chmod(mode)
    for name in ("OUTLAST_CACHE_DIR", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr(cache_files, "START", tmp_path / "start")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    monkeypatch.setattr(cache_files, "WARNED", [])
    return tmp_path


def made(folder: Path, mode: int = 0o755, link: Path | None = None) -> None:
    if link:
        link.mkdir(mode=0o700)
        folder.symlink_to(link)
    else:
        folder.mkdir()
        folder.chmod(mode)


def nothing(here: Path) -> None:
    """Prepare nothing."""


def twice_open(here: Path, link: Path | None = None) -> None:
    """A folder for all, and in it the user's, which is for all, too, or a link."""
    made(here, 0o777)
    made(here / OWN, 0o777, link)


# $OUTLAST_CACHE_DIR ("": none, HERE: a folder that is prepared), how it is prepared, where code goes, and why there
HERE = "HERE"
TEMPORARY = f"temporary/{OWN}"
PLACES: dict[str, tuple[str, Callable[[Path], object], str | None, str]] = {
    "none is named": ("", nothing, "home/.cache/outlast", ""),
    "in the home": ("~/a/b", nothing, "home/a/b", ""),
    "in a home that is not there": ("~nobody at all/a", nothing, TEMPORARY, "home"),
    "relative": ("a/b", nothing, "start/a/b", ""),
    "a new one": (HERE, nothing, "here", ""),
    "an own one": (HERE, made, "here", ""),
    "a link to a private one": (HERE, lambda here: made(here, link=here.with_name("there")), "here", ""),
    "for a group": (HERE, lambda here: made(here, 0o2775), f"here/{OWN}", ""),
    "for all": (HERE, lambda here: made(here, 0o1777), f"here/{OWN}", ""),
    "a file": (HERE, Path.touch, TEMPORARY, "here: File exists"),
    "a link to nothing": (HERE, lambda here: here.symlink_to("nothing"), TEMPORARY, "here: File exists"),
    "all of it for all": (HERE, twice_open, TEMPORARY, "others can write to .*here"),
    "a link in one for all": (HERE, lambda here: twice_open(here, here.with_name("there")), TEMPORARY, "others can"),
    "none can be used": (HERE, lambda here: (here.touch(), made(here.parent / TEMPORARY, 0o777)), None, "here: File"),
}


@posix_only
@pytest.mark.parametrize("case", PLACES)
def test_a_private_folder_is_used_and_others_are_left_alone(
    case: str, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given, prepare, expected, problem = PLACES[case]
    prepare(place / "here")
    monkeypatch.setenv("OUTLAST_CACHE_DIR", str(place / "here") if given == HERE else given)
    before = os.umask(0)  # the folder is private even then
    try:
        found = cache_folders()
    finally:
        os.umask(before)
    assert found.writable == (expected and place / expected)
    assert found.readable == ([found.writable] if found.writable else [])
    assert re.search(problem, found.problem) if problem else not found.problem
    assert all(is_private(folder.stat()) for folder in found.readable)
    assert cache_folder() == cache_folders().writable == found.writable


@posix_only
def test_without_home_and_user_the_cache_is_among_temporary_files(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container that runs with a number that is no user's."""

    def unknown(number: int) -> None:
        raise KeyError(number)

    monkeypatch.delenv("HOME")
    monkeypatch.setattr("pwd.getpwuid", unknown)
    found = cache_folders()
    assert (found.writable, "home" in found.problem) == (place / TEMPORARY, True)


@posix_only
def test_a_read_only_folder_is_read(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever its age, though its use cannot be noted; new code goes to a temporary folder."""
    folder = cache_folder()
    assert folder
    cache_files.write(folder / "a.unit", CODE)
    os.utime(folder / "a.unit", (0, 0))
    access = os.access
    monkeypatch.setattr(os, "access", lambda path, mode: path != folder and access(path, mode))
    monkeypatch.setattr(os, "utime", refuse)
    found = cache_folders()
    assert found.readable == [folder, found.writable]
    assert found.writable == place / TEMPORARY
    assert found.problem == f"{folder} is not writable"
    assert cache_files.read(folder / "a.unit") == CODE


@posix_only
@pytest.mark.parametrize("foreign", ["a group can write it", "all can write it", "another user's"])
def test_code_that_others_could_have_written_counts_as_absent(tmp_path: Path, foreign: str) -> None:
    before = os.umask(0)
    assert cache_files.write(tmp_path / "a.unit", CODE)
    os.umask(before)
    assert (tmp_path / "a.unit").stat().st_mode & 0o777 == 0o644  # all can read it
    assert cache_files.read(tmp_path / "a.unit") == CODE
    if foreign == "another user's" and os.geteuid():
        pytest.skip("only root can give files away")
    if foreign == "another user's":
        os.chown(tmp_path / "a.unit", 70_000, 70_000)
    else:
        (tmp_path / "a.unit").chmod(0o664 if "group" in foreign else 0o646)
    assert cache_files.read(tmp_path / "a.unit") is None
    assert cache_files.write(tmp_path / "a.unit", CODE)
    assert cache_files.read(tmp_path / "a.unit") == CODE


@posix_only
def test_code_of_roots_is_loaded_by_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in an image; nobody else's is."""
    assert cache_files.write(tmp_path / "a.unit", CODE)
    root = os.geteuid() == 0
    monkeypatch.setattr(os, "geteuid", lambda: 70_000)
    assert cache_files.read(tmp_path / "a.unit") == (CODE if root else None)


def link(path: Path) -> None:
    cache_files.write(path.with_name("linked"), CODE)
    path.symlink_to(path.with_name("linked"))


def damaged(path: Path, damage: Callable[[bytes], bytes]) -> None:
    """A file as a full disk or a power cut leaves it."""
    cache_files.write(path, CODE)
    path.write_bytes(damage(path.read_bytes()))


ODD: dict[str, Callable[[Path], Any]] = {
    "half": lambda path: damaged(path, lambda content: content[: len(content) // 2]),
    "zeros": lambda path: damaged(path, lambda content: bytes(len(content))),
    "one bit": lambda path: damaged(path, lambda content: content[:-1] + bytes([content[-1] ^ 1])),
    "another header": lambda path: damaged(path, lambda content: b"[]\n" + content.partition(b"\n")[2]),
    "nothing in it": Path.touch,
    "a FIFO": os.mkfifo,
    "a link": link,
    "a link to itself": lambda path: path.symlink_to(path),
    "deep JSON": lambda path: path.write_text("[" * 200_000),
    "a huge file": lambda path: (path.touch(), os.truncate(path, 2**40)),
    "not UTF-8": lambda path: path.write_bytes(b"\xff\xfe\x00"),
    "a link to nothing": lambda path: path.symlink_to(path.with_name("nothing")),
    "a folder": Path.mkdir,
}


@posix_only
@pytest.mark.parametrize("odd", ODD)
def test_odd_entries_count_as_absent(odd: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache_files, "WARNED", [])
    path = tmp_path / "a.unit"
    ODD[odd](path)
    assert cache_files.read(path) is None
    with pytest.warns(RuntimeWarning, match="Is a directory") if odd == "a folder" else contextlib.nullcontext():
        assert cache_files.write(path, CODE) == (odd != "a folder")
    assert not list(tmp_path.glob("*.tmp"))


@posix_only
@pytest.mark.parametrize("odd", ODD)
def test_a_lock_that_is_odd_keeps_nobody(odd: str, place: Path) -> None:
    folder = cache_folder()
    assert folder
    ODD[odd](folder / cache_files.LOCK)
    with one_at_a_time():
        pass
    assert {path.name for path in folder.iterdir()} - {"linked"} == {cache_files.LOCK}


@pytest.mark.parametrize("label", ["x" * 999, "größe.tick", "zero a.B.c after d", "../../a", "con:*?", "a" * 60 + "/b"])
def test_labels_of_any_kind_have_files(label: str, tmp_path: Path) -> None:
    name = cache_files.file_name(label, "0" * 24)
    assert len(name) <= 143  # the least of usual file systems (eCryptfs)
    assert name.isascii()
    assert cache_files.write(tmp_path / name, CODE)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert cache_files.read(tmp_path / name) == CODE


def test_a_file_that_another_process_has_written_and_opened_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows does not replace it; whatever else cannot be written is worth one warning."""
    monkeypatch.setattr(cache_files, "WARNED", [])
    cache_files.write(tmp_path / "a.unit", CODE)
    monkeypatch.setattr(os, "replace", refuse)
    assert cache_files.write(tmp_path / "a.unit", CODE)
    with pytest.warns(RuntimeWarning, match="not kept for later processes: .*Access is denied"):
        assert not cache_files.write(tmp_path / "b.unit", CODE)
    assert not cache_files.write(tmp_path / "c.unit", CODE)
    assert [path.name for path in tmp_path.iterdir()] == ["a.unit"]


def test_old_units_stay_until_all_are_too_large_together(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As in an image that was built a month ago. What killed processes left goes after a day."""
    folder = cache_folder()
    assert folder
    names = ["a.unit", "b.unit", "tmpabcdefgh.tmp", "tmpijklmnop.tmp", "another program's.tmp"]
    for days, name in enumerate(names):
        (folder / name).write_bytes(bytes(100))
        age = time.time() - 60 * cache_files.DAY - days if name != "tmpijklmnop.tmp" else time.time()
        os.utime(folder / name, (age, age))
    cache_files.prune()
    left = {"a.unit", "b.unit", "tmpijklmnop.tmp", "another program's.tmp"}
    assert {path.name for path in folder.iterdir()} == left
    monkeypatch.setattr(cache_files, "LARGEST", 250)
    cache_files.prune()
    assert {path.name for path in folder.iterdir()} == left - {"b.unit"}


@kernel
def twice(k: int) -> int:
    return 2 * k


@kernel
def thrice(k: int) -> int:
    return 3 * k


@posix_only
def test_without_a_folder_code_is_kept_in_memory(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    PLACES["none can be used"][1](place / "here")
    monkeypatch.setenv("OUTLAST_CACHE_DIR", str(place / "here"))
    monkeypatch.setattr(cache, "ADDRESSES", {})
    expected = r"kept in memory only, as .*here: File exists; others can write.*OUTLAST_CACHE_DIR can name another"
    for function, result in ((twice, 14), (thrice, 21), (twice, 14)):
        units = CompiledUnits((), {"function": function}, {})
        with contextlib.nullcontext() if cache_files.WARNED else pytest.warns(RuntimeWarning, match=expected):
            units.load()
        assert units.function("function")(7) == result


def test_the_progress_is_logged(place: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture) -> None:
    monkeypatch.setattr(cache, "ADDRESSES", {})
    monkeypatch.setattr(cache, "REPORT", 0)
    with caplog.at_level("INFO", "outlast"):
        CompiledUnits((), {"twice": twice, "thrice": thrice}, {}).load()
    assert caplog.messages == ["compiled 1 of 2 systems", "compiled 2 of 2 systems"]


@pytest.mark.nightly
def test_bytecode_without_sources_is_enough(tmp_path: Path) -> None:
    package = Path(outlast.__file__).parent
    for part in ("ecs", "components", "systems", "envs", "training"):
        shutil.copytree(package / part, tmp_path / "outlast" / part)
    for file in package.glob("*.py*"):
        shutil.copy(file, tmp_path / "outlast")
    compileall.compile_dir(tmp_path / "outlast", quiet=1, legacy=True)
    for source in (tmp_path / "outlast").rglob("*.py"):
        source.unlink()
    script = SCRIPT.format(game=str(tmp_path), root=str(ROOT), module="tests.helpers.toy_game")
    before = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import outlast; assert '.pyc' in outlast.__file__"
    done = worlds_made(f"{before}\n{script}", tmp_path / "cache")
    assert done.stdout.split()[DIGEST:] == in_process(tmp_path / "other")[DIGEST:], done.stderr

"""The compile cache: filled by several processes at once, damaged, on a full disk, or not writable."""

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from outlast.ecs import cache_files
from outlast.ecs.cache_files import SUFFIX, cache_folder, claimed
from tests.conftest import COMPILED
from tests.engine.test_compile import ROOT, SCRIPT, in_process

pytestmark = pytest.mark.skipif(not COMPILED, reason="there is no machine code")
DIGEST = 2  # the index of the digest in the output of a process
Warm = tuple[dict[Path, tuple[bytes, int]], str]


COUNTED = """
from outlast.ecs.cache import CompiledUnits

compile_one = CompiledUnits._compile_one

def counted(self, label):
    with open({log!r}, "a") as file:
        file.write(label + chr(10))
    return compile_one(self, label)

CompiledUnits._compile_one = counted
"""


@pytest.mark.nightly
def test_processes_that_begin_together_compile_each_unit_once(tmp_path: Path) -> None:
    """Three agree, and leave code that a fourth one loads."""
    cache, log = tmp_path / "cache", tmp_path / "log"
    with ThreadPoolExecutor(3) as pool:
        outputs = [
            done.stdout.split() for done in pool.map(lambda _: failing(cache, COUNTED.format(log=str(log))), range(3))
        ]
    later = in_process(cache)
    assert later[:2] == ["0", "True"]
    assert {one[DIGEST] for one in outputs} == {later[DIGEST]}
    labels, files = log.read_text().splitlines(), list(cache.iterdir())
    assert len(set(labels)) == len(labels) == len(files)
    assert {path.suffix for path in files} == {SUFFIX}


def test_who_waits_too_long_compiles_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As for a process that was suspended, which keeps its claim."""
    monkeypatch.setattr(cache_files, "PATIENCE", 0.05)
    path = tmp_path / f"a{SUFFIX}"
    with claimed(path, False) as mine, claimed(path, False) as other, claimed(path, True) as patient:
        assert (mine, other, patient) == (True, sys.platform == "win32", True)
    with claimed(path, False) as mine:
        assert mine
    assert list(tmp_path.iterdir()) == []


def halved(content: bytes) -> bytes:
    return content[: len(content) // 2]


DAMAGE: dict[str, Callable[[bytes], bytes]] = {
    "half": halved,
    "nothing": lambda content: b"",
    "zeros": lambda content: bytes(len(content)),
    "one bit of the code": lambda content: content[:-999] + bytes([content[-999] ^ 1]) + content[-998:],
    "no header": lambda content: content.partition(b"\n")[2],
    "another header": lambda content: b"[]\n" + content.partition(b"\n")[2],
}


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Warm:
    """The files of a filled cache with their age, and the digest of the run that filled it."""
    folder = tmp_path_factory.mktemp("cache")
    digest = in_process(folder)[DIGEST]
    files = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder): (path.read_bytes(), path.stat().st_mtime_ns) for path in files}, digest


@pytest.mark.nightly
@pytest.mark.parametrize("damage", DAMAGE)
def test_damaged_files_are_made_anew(warm: Warm, damage: str, tmp_path: Path) -> None:
    """Files as a full disk or a power cut leaves them."""
    files, digest = warm
    for path, (content, age) in files.items():
        target = tmp_path / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(DAMAGE[damage](content))
        os.utime(target, ns=(age, age))
    assert in_process(tmp_path)[DIGEST] == digest
    assert in_process(tmp_path)[:2] == ["0", "True"]  # now loaded from the folder


def failing(cache: Path, before: str = "") -> subprocess.CompletedProcess[str]:
    """A process that runs the code `before` and makes worlds."""
    script = before + SCRIPT.format(game=str(ROOT), root=str(ROOT), module="tests.helpers.toy_game")
    environment = os.environ | {"OUTLAST_CACHE_DIR": str(cache)}
    return subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, timeout=250)


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    done = failing(tmp_path / "file")
    assert done.returncode == 1
    assert str(tmp_path / "file") in done.stderr.splitlines()[-1]


@pytest.mark.nightly
@pytest.mark.skipif(sys.platform == "win32", reason="limits are those of POSIX")
def test_a_full_disk_costs_no_more_than_the_cache(tmp_path: Path) -> None:
    """The largest allowed file is smaller than the code, so that writing it fails midway."""
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (2_000, 2_000))\n"
    done = failing(tmp_path, limit)
    assert done.returncode == 0, done.stderr
    assert "compiled code is not kept" in done.stderr


@pytest.fixture
def homeless(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user without a cache folder; returns the folder of temporary files."""
    (tmp_path / "file").write_text("")
    monkeypatch.delenv("OUTLAST_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


@pytest.mark.skipif(sys.platform != "linux", reason="other variables set the cache folder")
def test_without_a_home_the_cache_is_among_temporary_files(homeless: Path) -> None:
    folder = cache_folder()
    assert folder.parent == homeless
    assert folder.stat().st_mode & 0o777 == 0o700
    assert cache_folder() == folder


@pytest.mark.skipif(sys.platform != "linux", reason="other variables set the cache folder")
@pytest.mark.parametrize("planted", ["writable", "link"])
def test_what_others_may_write_to_is_not_run(homeless: Path, planted: str) -> None:
    folder = cache_folder()
    folder.chmod(0o777)
    if planted == "link":
        folder.rename(homeless / "elsewhere")
        folder.symlink_to(homeless / "elsewhere")
    with pytest.raises(PermissionError, match="OUTLAST_CACHE_DIR"):
        cache_folder()


def test_an_empty_name_of_the_folder_counts_as_none(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OUTLAST_CACHE_DIR", raising=False)
    usual = cache_folder()
    monkeypatch.setenv("OUTLAST_CACHE_DIR", "")
    assert cache_folder() == usual

"""Standard streams that are closed, broken or replaced: nothing that is played, trained or written depends on them."""

import errno
import io
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import outlast
from outlast.envs.cli import main as cli
from outlast.envs.cli.main import main
from outlast.envs.progress import Messages
from tests.conftest import run


class Broken(io.StringIO):
    """A stream that nobody reads: a pipe, or the terminal of a connection that is lost."""

    def __init__(self, code: int = errno.EPIPE, tty: bool = False) -> None:
        super().__init__()
        self.code, self.tty = code, tty

    def isatty(self) -> bool:
        return self.tty

    def write(self, text: str) -> int:
        raise OSError(self.code, os.strerror(self.code))

    def flush(self) -> None:
        self.write("")


class Bare:
    """An object in the place of a stream that can only be written to."""

    def __init__(self) -> None:
        self.text = ""

    def write(self, text: str) -> None:
        self.text += text


def closed() -> io.StringIO:
    stream = io.StringIO()
    stream.close()
    return stream


STREAMS: dict[str, Callable[[], Any]] = {
    "none": lambda: None,
    "closed": closed,
    "broken pipe": Broken,
    "lost terminal": lambda: Broken(errno.EIO, tty=True),
    "full disk": lambda: Broken(errno.ENOSPC),
    "without more than write": Bare,
}


def film(folder: Path) -> None:
    outlast.film("ffa_1", folder / "a.webm", steps=2, size=64)


def replay_page(folder: Path) -> None:
    outlast.rollout("ffa_1", worlds=2, steps=5, record=folder / "a.rec", csv=folder / "a.csv")
    outlast.replay_page(folder / "a.rec", folder / "a.html", quiet=False)


def evaluate(folder: Path) -> None:
    pytest.importorskip("torch", reason="needs torch: outlast[train]")
    outlast.evaluate("ffa_1", ["random"], episodes=2, worlds=2, out=folder, ending_limit=5)


def train(folder: Path) -> None:
    pytest.importorskip("tensorboard", reason="needs tensorboard: outlast[train]")
    pytest.importorskip("torch", reason="needs torch: outlast[train]")
    outlast.train("ffa_1", folder / "run", steps=1, worlds=8, rollout=512, threads=1)


CALLS: dict[Callable[[Path], None], list[str]] = {
    film: ["a.webm"],
    replay_page: ["a.csv", "a.html", "a.rec"],
    evaluate: ["evaluation.json", "figures.csv", "groups.csv", "ratings.csv"],
    train: ["run"],
}


@pytest.mark.parametrize("stream", STREAMS)
@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__name__)
@pytest.mark.by_day(5)
def test_calls_work_whatever_the_streams_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Callable[[Path], None], stream: str
) -> None:
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, STREAMS[stream]())
    call(tmp_path)
    monkeypatch.undo()
    assert sorted(path.name for path in tmp_path.iterdir()) == CALLS[call]


@pytest.mark.parametrize("stream", STREAMS)
@pytest.mark.parametrize("words", [("rollout", "ffa_1", "--worlds=2", "--steps=5"), ("rollout", "no_such_game")])
def test_commands_return_their_status_whatever_stderr_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], stream: str
) -> None:
    """Also on a closed standard output; that on a full disk is the only one that is an error."""
    shown = STREAMS[stream]() or io.StringIO()
    monkeypatch.setattr(sys, "stderr", shown)
    assert main(words) == (2 if "no_such_game" in words else 0)
    monkeypatch.setattr(sys, "stdout", Broken())
    assert main(words) == (2 if "no_such_game" in words else 0)
    monkeypatch.setattr(sys, "stdout", Broken(errno.ENOSPC))
    assert main(words) == 2


def test_the_error_of_a_full_disk_names_standard_output(capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", Broken(errno.ENOSPC))
    assert run(capsys, "variants") == (2, "", "outlast: stdout: No space left on device\n")


@pytest.mark.skipif(sys.platform == "win32", reason="pipes are others there")
@pytest.mark.parametrize("name", ["stdout", "stderr"])
def test_a_pipe_that_is_closed_breaks_no_command(tmp_path: Path, name: str) -> None:
    """The pipe of a real process, which Python would also complain about at its end, with status 120."""
    words = ["rollout", "ffa_1", "--worlds=2", "--steps=5", "--csv", str(tmp_path / "a.csv")]
    reader, writer = os.pipe()
    os.close(reader)
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE} | {name: writer}
    done = subprocess.run([sys.executable, "-m", "outlast", *words], text=True, **streams)  # type: ignore[call-overload]
    os.close(writer)
    assert done.returncode == 0
    assert "Traceback" not in f"{done.stdout}{done.stderr}"
    assert (tmp_path / "a.csv").read_text().startswith("world,")


SMALL = ("--size=64", "--every=5")


@pytest.mark.parametrize(
    ("words", "unit"),
    [
        (("rollout", "ffa_1", "--worlds=2", "--steps=20"), "40 of 40 world-steps"),
        (("frames", "ffa_1", "--steps=20", *SMALL, "--out={folder}/pictures"), "5 of 5 frames"),
        (("replay", "{folder}/a.rec"), "21 of 21 ticks"),
        (("replay", "{folder}/a.rec", "--html={folder}/a.html"), "21 of 21 ticks"),
        (("replay", "{folder}/a.rec", *SMALL, "--out={folder}/a.apng"), "5 of 5 frames"),
    ],
)
def test_the_progress_in_a_log_is_whole_lines(capsys: Any, tmp_path: Path, words: tuple[str, ...], unit: str) -> None:
    outlast.rollout("ffa_1", worlds=2, steps=20, record=tmp_path / "a.rec")
    status, _, err = run(capsys, *(word.format(folder=tmp_path) for word in words))
    lines = err.splitlines()
    assert status == 0
    assert len(lines) == 2  # at the beginning, and at the end
    assert lines[-1].startswith(unit)
    assert not {"\r", "\x1b"} & {*err}


def test_messages_are_equal_if_their_stream_is_the_same() -> None:
    """So that a bar makes room for a message on the same terminal; see tqdm.external_write_mode."""
    one, other = io.StringIO(), io.StringIO()
    assert Messages(Messages(one)) == one
    assert Messages(one) == Messages(one) != Messages(other)


def test_streams_are_the_callers_again_behind_a_command() -> None:
    before = sys.stdout, sys.stderr
    with cli.standard_streams():
        assert sys.stdout is not before[0]
    assert (sys.stdout, sys.stderr) == before

"""What the terminal shows of a run: on a terminal, in a log, in a narrow place."""

import io
import logging
import math
import re

import pytest

from outlast.envs import progress
from outlast.envs.cli.options import messages_shown
from outlast.envs.progress import Progress, large
from outlast.training.base.run_summary import GROUPS, Figure, headline
from outlast.training.runs.live_view import LiveView, fitted

TAGS = {
    "time/collected_per_second": 90_123.0,
    "time/updated_per_second": 36_500.0,
    "time/fps": 24_000.0,
    "rollout/steps": 812.4,
    "rollout/reward0": 400.0,
    "rollout/reward1": 420.0,
    "rollout/kills0": 0.25,
    "rollout/kills1": 0.5,
    "rollout/heals_used": 2.7,
    "behaviour/near": 0.1,
    "train/epochs": 3.25,
    "train/approx_kl": 0.0113,
    "train/entropy": 4.211,
    "wins/scripted": 0.118,
    "games/scripted": 310.0,
    "wins/past": 0.55,
}


class Terminal(io.StringIO):
    """As much of a terminal as progress bars need."""

    def isatty(self) -> bool:
        return True

    def rows(self) -> list[str]:
        """What is on it, down to the last row that is not empty; and the row that the cursor is in."""
        rows, row, column = [""], 0, 0
        for code, text in re.findall(r"(\x1b\[\d*[AKJ]|[\r\n])|([^\x1b\r\n]+)", self.getvalue()):
            if text:
                rows[row] = rows[row][:column].ljust(column) + text + rows[row][column + len(text) :]
                column += len(text)
            elif code == "\r":
                column = 0
            elif code == "\n":
                row, column = row + 1, 0
                rows += [""] * (row == len(rows))
            elif code.endswith("A"):
                row -= int(code[2:-1] or 1)
                assert row >= 0, "above the terminal"
            else:
                rows[row] = rows[row][:column]
                rows = rows[: row + 1] if code.endswith("J") else rows
        self.row = row
        return rows


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("LINES", "24")
    return Terminal()


# ---- the figures


def test_figures_are_those_of_the_tags_in_order() -> None:
    found = headline(TAGS)
    assert [(figure.name, figure.text) for figure in found] == [
        ("collecting", "90.1k/s"),
        ("updating", "36.5k/s"),
        ("length", "812"),
        ("return", "400.0 / 420.0"),
        ("kills", "0.75"),
        ("heals used", "2.70"),
        ("scripted", "12 % (310)"),
        ("past", "55 %"),
        ("epochs", "3.2"),
        ("KL", "0.0113"),
        ("entropy", "4.21"),
    ]
    assert {figure.group for figure in found} == set(GROUPS)
    assert headline({}) == []


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_none_are_left_out(value: float) -> None:
    assert headline({"rollout/steps": value, "wins/past": value, "rollout/kills0": value}) == []
    assert headline({"wins/past": 0.5, "games/past": value}) == [Figure("wins", "past", 0.5, "50 %")]


def test_ratings_stand_beside_wins() -> None:
    tags = {"wins/past": 0.5, "games/past": 310.0, "rating/past": 1040.4, "rating/self": 905.6}
    assert [figure.text for figure in headline(tags)] == ["50 % (310, Elo 1040)", "906"]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0, "0"), (999.4, "999"), (999.6, "1.00k"), (9996, "10.0k"), (36_549, "36.5k"), (1.5e6, "1.50M"), (2e12, "2000G")],
)
def test_large_numbers_are_short(value: float, text: str) -> None:
    assert large(value) == text


def test_a_line_has_as_many_figures_as_there_is_room_for() -> None:
    figures = [Figure("episodes", "length", 1, "812"), Figure("episodes", "kills", 1, "0.75")]
    assert fitted("episodes", figures, 40) == "episodes  length 812 · kills 0.75"
    assert fitted("episodes", figures, 32) == "episodes  length 812"
    assert fitted("episodes", figures, 13) == "episodes  len"
    assert fitted("episodes", figures, 0) == ""


# ---- on a terminal


def test_the_terminal_shows_a_bar_and_a_line_for_each_group(terminal: Terminal) -> None:
    view = LiveView(1_000_000, 10_000_000, file=terminal)
    view.now("collecting")
    assert re.fullmatch(r" 10% \|\S+ +\| 1.00M of 10.0M \[.* left, .*, collecting\]", terminal.rows()[0])
    view.update(4_500_000, 10_000_000, TAGS)
    view.now("epoch 3")
    bar, *lines = terminal.rows()
    assert (bar[:4], bar[-9:]) == (" 45%", " epoch 3]")
    assert len(bar) == 99
    assert lines == [
        "speed     collecting 90.1k/s · updating 36.5k/s",
        "episodes  length 812 · return 400.0 / 420.0 · kills 0.75 · heals used 2.70",
        "wins      scripted 12 % (310) · past 55 %",
        "learning  epochs 3.2 · KL 0.0113 · entropy 4.21",
    ]
    assert terminal.row == 0


def test_numbers_that_an_update_does_not_have_stay(terminal: Terminal) -> None:
    view = LiveView(0, 100, file=terminal)
    view.update(10, 100, TAGS)
    view.update(20, 100, {"train/epochs": 1.0})
    assert [line.split()[:3] for line in terminal.rows()[2::2]] == [
        ["episodes", "length", "812"],
        ["learning", "epochs", "1.0"],
    ]


def test_closing_leaves_it_and_goes_on_below(terminal: Terminal) -> None:
    view = LiveView(0, 100, file=terminal)
    view.update(100, 100, TAGS)
    view.now("epoch 2")
    view.close()
    terminal.write("done")
    rows = terminal.rows()
    assert (rows[0][:4], rows[5]) == ("100%", "done")
    assert "epoch" not in rows[0]
    assert len(rows) == 6
    view.close()
    view.update(100, 100, TAGS)
    view.now("nothing")
    assert terminal.rows() == rows


@pytest.mark.parametrize(("columns", "lines"), [(200, 50), (72, 10), (60, 24), (30, 10), (12, 4), (5, 2), (2, 1)])
def test_it_stays_within_any_terminal(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch, columns: int, lines: int
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("LINES", str(lines))
    view = LiveView(0, 10_000_000, file=terminal)
    view.update(4_500_000, 10_000_000, TAGS)
    view.now("collecting")
    assert all(len(row) < columns for row in terminal.rows())
    assert len(terminal.rows()) <= max(1, lines - 1)
    view.close()
    assert len(terminal.rows()) <= max(1, lines - 1) + 1


def test_messages_are_written_above_it(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stderr", terminal)
    with messages_shown():
        view = LiveView(0, 100)
        view.update(10, 100, TAGS)
        logging.getLogger("outlast.training").warning("no room for a film")
        view.now("epoch 1")
        rows = terminal.rows()
        view.close()
    assert rows[0] == "outlast: no room for a film"
    assert (rows[1][:4], rows[2][:5], len(rows)) == (" 10%", "speed", 6)


# ---- elsewhere


def test_a_log_gets_a_line_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    file = io.StringIO()
    view = LiveView(1_000_000, 2_000_000, file=file)
    for k in range(1, 8):
        clock[0] += progress.EVERY / 3
        view.now("collecting")
        view.update(1_000_000 + 100_000 * k, 2_000_000, TAGS)
    view.close()
    view.close()
    lines = file.getvalue().splitlines()
    assert [line.split()[0] for line in lines] == ["1.10M", "1.40M", "1.70M"]  # and nothing twice
    assert lines[0] == (
        "1.10M of 2.00M agent-steps; 10.0k/s, 01:30 left; speed: collecting 90.1k/s, updating 36.5k/s; episodes: "
        "length 812, return 400.0 / 420.0, kills 0.75, heals used 2.70; wins: scripted 12 % (310), past 55 %; "
        "learning: epochs 3.2, KL 0.0113, entropy 4.21"
    )
    assert "\x1b" not in file.getvalue()


def test_what_is_slow_or_has_no_end_is_shown_without_a_rate_or_a_total(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [100.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    file = io.StringIO()
    for total in (4, 0):
        with Progress(total, "matches", file=file) as shown:
            clock[0] += 60
            shown.add(note="between friends")
    assert file.getvalue().splitlines() == ["1 of 4 matches; 03:00 left; between friends", "1 matches; between friends"]


def test_the_end_is_in_the_log() -> None:
    file = io.StringIO()
    view = LiveView(0, 100, file=file)
    view.update(10, 100, {})
    view.update(100, 100, {})
    view.close()
    assert [line.split()[0] for line in file.getvalue().splitlines()] == ["10", "100"]


@pytest.mark.parametrize("kind", [io.StringIO, Terminal])
def test_quiet_is_quiet(kind: type[io.StringIO]) -> None:
    file = kind()
    view = LiveView(0, 100, quiet=True, file=file)
    view.now("collecting")
    view.update(50, 100, TAGS)
    view.close()
    assert file.getvalue() == ""

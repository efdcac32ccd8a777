"""Tables of commands: as wide as needed in pipes and files, and in terminals no wider than these."""

import io
import shutil
import sys
from typing import Any

import pytest

import outlast
from outlast.envs.cli.main import main
from outlast.envs.scenarios.number_table import scenario_rows
from outlast.envs.text_table import terminal_width, text_table

WORDS = [("a", "1 to 100000", "of the first"), ("b-c", "masked, revealed", "what it is, at some length"), ("d", "", "")]
NUMBERS = [("one", "two", "1.0", "2,000.5 ± 3"), ("three", "four", "11.25", "-")]


class Stream(io.StringIO):
    """Standard output that is a terminal, or is not."""

    def __init__(self, terminal: bool) -> None:
        super().__init__()
        self.terminal = terminal

    def isatty(self) -> bool:
        return self.terminal


@pytest.mark.parametrize(
    ("stdout", "columns", "width"),
    [
        (Stream(terminal=True), None, 97),
        (Stream(terminal=False), None, None),
        (None, None, None),
        (Stream(terminal=True), "60", 60),
        (Stream(terminal=False), "60", 60),
        (Stream(terminal=False), "0", None),
        (Stream(terminal=False), "wide", None),
    ],
)
def test_the_width_is_that_of_the_terminal(
    monkeypatch: pytest.MonkeyPatch, stdout: Any, columns: str | None, width: int | None
) -> None:
    monkeypatch.setattr(shutil, "get_terminal_size", lambda: type("Size", (), {"columns": 97}))
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns is not None:
        monkeypatch.setenv("COLUMNS", columns)
    monkeypatch.setattr(sys, "stdout", stdout)
    assert terminal_width() == width


def test_without_a_limit_a_row_is_a_line() -> None:
    assert text_table(WORDS, ("name", "values", "meaning")).split("\n") == [
        "name  values            meaning",
        "a     1 to 100000       of the first",
        "b-c   masked, revealed  what it is, at some length",
        "d",
    ]
    assert text_table(NUMBERS, left=2).split("\n") == [
        "one    two     1.0  2,000.5 ± 3",
        "three  four  11.25            -",
    ]
    assert text_table([], width=10) == ""


def test_words_are_wrapped_or_written_below_their_row() -> None:
    assert text_table(WORDS, width=30).split("\n") == [
        "a    1 to 100000",
        "    of the first",
        "b-c  masked, revealed",
        "    what it is, at some length",
        "d",
    ]
    beside = [("name", 5 * "some more words "), ("other", "few")]
    assert text_table(beside, width=40).split("\n") == [
        "name   some more words some more words",
        "       some more words some more words",
        "       some more words",
        "other  few",
    ]


def test_numbers_without_room_go_on_below_with_the_words_of_their_rows() -> None:
    assert text_table(NUMBERS, ("policy", "against", "a", "b"), left=2, width=24).split("\n") == [
        "policy  against      a",
        "one     two        1.0",
        "three   four     11.25",
        "",
        "policy  against            b",  # a number that has no room even so
        "one     two      2,000.5 ± 3",
        "three   four               -",
    ]


@pytest.mark.parametrize("width", [80, 100, 132, 300])
def test_the_numbers_of_a_game_fit(
    width: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    assert main(["numbers", "teams_4"]) == 0
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= width
    squeezed = "".join(out.split())
    for row in scenario_rows(outlast.variant("teams_4")):
        assert "".join(row.about.split()) in squeezed
        for cell in row[:4]:
            assert all(word in out for word in cell.replace(",", " ").split())


@pytest.mark.parametrize("command", [("variants",), ("benchmark", "tasks")])
def test_lists_fit(
    command: tuple[str, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main([*command]) == 0
    assert max(map(len, capsys.readouterr().out.splitlines())) <= 80

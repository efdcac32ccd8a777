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
        (Stream(terminal=False), "wide", None),
    ],
)
def test_the_width_is_that_of_the_terminal(monkeypatch: Any, stdout: Any, columns: str | None, width: Any) -> None:
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


@pytest.mark.parametrize("width", [80, 100, 132, 300])
def test_the_numbers_of_a_game_fit(width: int, capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    assert main(["numbers", "teams_4"]) == 0
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= width
    squeezed = "".join(out.split())
    for row in scenario_rows(outlast.variant("teams_4")):
        assert "".join(row.about.split()) in squeezed
        for cell in row[:4]:
            assert all(word in out for word in cell.replace(",", " ").split())

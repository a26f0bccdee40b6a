"""Tables fit the terminal they are shown in, and colours are for terminals alone."""

import io

import pytest
from rich.cells import cell_len

from vprbench.terminal.console import format_table, make_console

COLUMNS = ["method", "R@1 %", "R@5 %", "rates"]
ROWS = [["sad", "12.5", "30.1", "x" * 60], ["a method of many words, " * 2, "1.0", "2.0", "1,000"]]


@pytest.fixture(autouse=True)
def no_columns(monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)


def longest(text):
    return max(map(cell_len, text.splitlines()))


def test_a_table_that_is_too_wide_loses_the_columns_that_matter_least_and_names_them_unless_it_may_be_wide(monkeypatch):
    shown = format_table(COLUMNS, ROWS)
    assert shown.splitlines()[0].split() == ["method", "R@1", "%", "R@5", "%"]
    assert shown.splitlines()[-1].startswith("left out: rates ")
    assert longest(shown) <= 100
    assert "left out: rates " in format_table(COLUMNS, ROWS, least=["rates", "R@5 %"])
    assert "left out: R@5 %, rates " in format_table(COLUMNS, ROWS, least=["R@5 %"])
    wide = format_table(COLUMNS, ROWS, wide=True)
    assert ("x" * 60 in wide, "left out" in wide, longest(wide) > 100) == (True, False, True)
    monkeypatch.setenv("COLUMNS", "200")
    assert "left out" not in format_table(COLUMNS, ROWS)
    monkeypatch.setenv("COLUMNS", "20")
    assert make_console().width == 100


def test_of_two_columns_the_widest_is_cut_short_and_a_name_is_not_obeyed():
    shown = format_table(["name", "description"], [["sad", "word " * 40]])
    assert longest(shown) == 100
    assert shown.endswith("\N{HORIZONTAL ELLIPSIS}")
    assert r"[red]\x1b[2J\n" in format_table(["a"], [["[red]\x1b[2J\n"]])


@pytest.mark.parametrize(("terminal", "none", "coloured"), [(True, "", True), (True, "1", False), (False, "", False)])
def test_colours_are_for_terminals_that_want_them(terminal, none, coloured, monkeypatch):
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("NO_COLOR", none)
    stream = io.StringIO()
    monkeypatch.setattr(stream, "isatty", lambda: terminal)
    make_console(stream).print("word", style="red")
    assert ("\x1b[31m" in stream.getvalue()) == coloured

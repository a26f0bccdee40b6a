"""What a person sees: lines, a bar or a live table of a long run, and tables and colours that fit the terminal."""

import contextlib
import io
import logging
import re

import pytest
from rich.cells import cell_len
from rich.console import Console
from stopped_clock import Clock

from vprbench import progress
from vprbench.progress import show_progress
from vprbench.terminal import streams
from vprbench.terminal.console import format_table, make_console
from vprbench.terminal.live import LiveTable
from vprbench.terminal.streams import results_only_on_stdout


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self):
        return True


@pytest.fixture(autouse=True)
def clock(monkeypatch):
    """Let no time pass but what a test spends, before a terminal of 80 columns."""
    clock = Clock()
    clock.spend(1000)
    clock.replaces_those_of([progress], monkeypatch)
    for name, value in (("TERM", "xterm"), ("COLUMNS", "80"), ("LINES", "24")):
        monkeypatch.setenv(name, value)
    return clock


def shown(clock, reports, stream, title="sad on nordland"):
    """Return what appears for these reports: seconds since the last one, stage, share done."""
    with show_progress(title, stream):
        for seconds, stage, done in reports:
            clock.spend(seconds)
            progress.report(stage, done)
    return stream.getvalue()


def test_a_stage_has_a_line_and_a_long_one_its_share_and_the_time_left(clock, capsys):
    for reports, lines in (
        ([(0, "fit", 0), (1, "query", 0.1), (1, "fit", 0)], ["fit", "query", "fit"]),
        ([(0, "query", 0), (12, "query", 0.25)], ["query", "query 25 %, 36 s left"]),  # 12 s for a quarter
        ([(0, "fit", 0), (500, "query", 0), (10, "query", 0.5)], ["fit", "query", "query 50 %, 10 s left"]),
        ([(0, "fit", 0), (60, "fit", 0.0), (60, "fit", 1.0)], ["fit"]),
    ):
        text = shown(clock, reports, io.StringIO())
        assert text.splitlines() == [f"sad on nordland: {line}" for line in lines]
        assert capsys.readouterr().out == ""


def test_a_bar_names_each_stage_shows_the_share_done_stands_below_log_lines_and_is_gone_at_the_end(clock, monkeypatch):
    stream = Terminal()
    monkeypatch.setattr("sys.stderr", stream)
    with show_progress("sad on [red]nordland"):
        for seconds, stage, done in ((0, "fit", 0.0), (0.15, "fit", 0.5), (0, "query", 0.0)):
            clock.spend(seconds)
            progress.report(stage, done)
        streams._StderrHandler().handle(logging.makeLogRecord({"msg": "a word\nvprbench: no"}))
    text = stream.getvalue()
    assert re.search(r"sad on \[red\]nordland: fit .* 50%.*nordland: query .* 0%", text, re.DOTALL)
    (line,) = (line for line in text.splitlines() if "a word" in line)
    assert r"a word\nvprbench: no" in line
    assert "query" not in line
    assert text.endswith("\x1b[2K")  # the line of the bar is erased


def test_a_reader_that_has_gone_ends_no_run(clock, monkeypatch):
    class Gone(io.StringIO):
        def write(self, _):
            raise BrokenPipeError

    shown(clock, [(0, "fit", 0.5)], Gone())
    monkeypatch.setattr("sys.stdout", Gone())
    with results_only_on_stdout() as say:
        say("an answer")


def test_prints_beside_the_answer_go_to_standard_error_and_names_in_progress_are_not_obeyed(clock, capsys):
    with results_only_on_stdout() as say:
        print("a plug-in's word")
        say("the answer")
    assert capsys.readouterr() == ("the answer\n", "a plug-in's word\n")
    text = shown(clock, [(0, "\x1b[2Jfit", 0)], io.StringIO(), "a\nvprbench: b")
    assert text == "a\\nvprbench: b: \\x1b[2Jfit\n"


def test_a_process_whose_progress_nobody_sees_and_an_inner_title_draw_nothing(clock, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setenv(progress.QUIET, "1")
        assert shown(clock, [(0, "fit", 0.5)], Terminal()) == ""
    outer = io.StringIO()
    with contextlib.suppress(KeyError), show_progress("outer", outer):
        assert shown(clock, [(0, "fit", 0.5)], Terminal()) == ""
        raise KeyError
    progress.report("fit", 0.7)
    assert outer.getvalue() == "outer: fit\n"


def test_runs_are_shown_with_their_time_and_cells_with_their_results_and_the_rest_is_counted():
    table = LiveTable(["SAD", "HOG"], ["Route"], 6)
    for seed in range(3):
        table.begin(seed, f"SAD on Route, seed {seed}")
    table.show("SAD", "Route", "12.5 %")
    table.end(0)
    table.end(2, failed=True)
    stream = io.StringIO()
    Console(file=stream, width=120).print(table.__rich__())
    text = stream.getvalue()
    assert "0 s  SAD on Route, seed 1" in text
    assert "seed 0" not in text
    assert [line.split() for line in text.splitlines()[1:3]] == [["SAD", "12.5", "%"], ["HOG", "\N{MIDDLE DOT}"]]
    assert "2 of 6, 1 running, 3 waiting, 1 failed" in text


COLUMNS = ["method", "R@1 %", "R@5 %", "rates"]
ROWS = [["sad", "12.5", "30.1", "x" * 60], ["a method of many words, " * 2, "1.0", "2.0", "1,000"]]


def longest(text):
    return max(map(cell_len, text.splitlines()))


def test_a_table_that_is_too_wide_loses_the_columns_that_matter_least_and_names_them_unless_it_may_be_wide(monkeypatch):
    monkeypatch.delenv("COLUMNS")
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


def test_of_two_columns_the_widest_is_cut_short_and_a_name_is_not_obeyed(monkeypatch):
    monkeypatch.delenv("COLUMNS")
    shown = format_table(["name", "description"], [["sad", "word " * 40]])
    assert longest(shown) == 100
    assert shown.endswith("\N{HORIZONTAL ELLIPSIS}")
    assert r"[red]\x1b[2J\n" in format_table(["a"], [["[red]\x1b[2J\n"]])


@pytest.mark.parametrize(("terminal", "none", "coloured"), [(True, "", True), (True, "1", False), (False, "", False)])
def test_colours_are_for_terminals_that_want_them(terminal, none, coloured, monkeypatch):
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("NO_COLOR", none)
    stream = Terminal() if terminal else io.StringIO()
    make_console(stream).print("word", style="red")
    assert ("\x1b[31m" in stream.getvalue()) == coloured

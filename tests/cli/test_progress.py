"""What a person sees of a long run: lines in a file, a bar in a terminal, and nothing between the results."""

import contextlib
import io
import logging
import re

import pytest
from stopped_clock import Clock

from vprbench import progress
from vprbench.progress import show_progress
from vprbench.terminal import streams
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


@pytest.mark.parametrize(
    ("reports", "lines"),
    [
        ([(0, "fit", 0), (1, "query", 0.1), (1, "fit", 0)], ["fit", "query", "fit"]),
        ([(0, "query", 0), (12, "query", 0.25)], ["query", "query 25 %, 36 s left"]),  # 12 s for a quarter
        ([(0, "fit", 0), (500, "query", 0), (10, "query", 0.5)], ["fit", "query", "query 50 %, 10 s left"]),
        ([(0, "fit", 0), (60, "fit", 0.0), (60, "fit", 1.0)], ["fit"]),
    ],
)
def test_a_stage_has_a_line_and_a_long_one_its_share_and_the_time_left(clock, capsys, reports, lines):
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

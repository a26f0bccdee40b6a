"""What a person sees of a long run: lines in a file, a bar in a terminal, and nothing between the results."""

import contextlib
import io
import logging

import pytest
from stopped_clock import Clock

from vprbench import progress
from vprbench.progress import progress_shown
from vprbench.terminal import streams
from vprbench.terminal.streams import results_only_on_stdout

Reports = list[tuple[float, str, float]]  # seconds since the last one, stage, share done


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
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("LINES", "24")
    return clock


def shown(clock, reports, stream, title="sad on nordland"):
    """Return what appears for these reports."""
    with progress_shown(title, stream):
        for seconds, stage, done in reports:
            clock.spend(seconds)
            progress.report(stage, done)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("reports", "lines"),
    [
        ([(0, "fit", 0), (1, "query", 0.1), (1, "fit", 0)], ["fit", "query", "fit"]),
        ([(0, "query", 0), (5, "query", 0.2), (4.9, "query", 0.4)], ["query"]),
        ([(0, "query", 0), (12, "query", 0.25)], ["query", "query 25 %, 36 s left"]),  # 12 s for a quarter
        ([(0, "fit", 0), (500, "query", 0), (10, "query", 0.5)], ["fit", "query", "query 50 %, 10 s left"]),
        ([(0, "fit", 0), (60, "fit", 0.0), (60, "fit", 1.0)], ["fit"]),
    ],
)
def test_a_stage_has_a_line_and_a_long_one_its_share_and_the_time_left(clock, capsys, reports, lines):
    told = shown(clock, reports, io.StringIO())
    assert told.splitlines() == [f"sad on nordland: {line}" for line in lines]
    assert capsys.readouterr().out == ""


def test_a_bar_names_each_stage_shows_the_share_done_and_is_gone_at_the_end(clock, capsys):
    reports = [(0, "fit", 0.0), (0.15, "fit", 0.5), (0, "query", 0.0)]  # drawn ten times a second at most
    text = shown(clock, reports, Terminal())
    assert text.index("sad on nordland: fit  50 %") < text.index("nordland: query   0 %")
    assert text.endswith("\x1b[2K")  # the line of the bar is erased
    assert capsys.readouterr().out == ""


class Gone(io.StringIO):
    """A stream whose reader has gone."""

    def write(self, _):
        raise BrokenPipeError


@pytest.mark.parametrize("terminal", [False, True])
def test_a_reader_that_has_gone_ends_no_run(terminal, clock, monkeypatch):
    stream = Gone()
    monkeypatch.setattr(stream, "isatty", lambda: terminal)
    shown(clock, [(0, "fit", 0.5)], stream)
    monkeypatch.setattr("sys.stdout", stream)
    with results_only_on_stdout() as say:
        say("an answer")


def test_what_is_printed_beside_the_answer_goes_to_standard_error_and_names_in_progress_are_not_obeyed(clock, capsys):
    with results_only_on_stdout() as say:
        print("a plug-in's word")
        say("the answer")
    assert capsys.readouterr() == ("the answer\n", "a plug-in's word\n")
    told = shown(clock, [(0, "\x1b[2Jfit", 0)], io.StringIO(), "a\nvprbench: b")
    assert told == "a\\nvprbench: b: \\x1b[2Jfit\n"


def test_a_log_line_stands_above_a_bar_and_a_warning_is_coloured_in_a_terminal(monkeypatch):
    stream = Terminal()
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.delenv("NO_COLOR", raising=False)
    handler = streams._StderrHandler()
    handler.setFormatter(streams._LineFormatter())
    with progress_shown("sad on nordland"):
        progress.report("fit", 0.5)
        handler.handle(logging.makeLogRecord({"msg": "a word", "levelno": logging.WARNING}))
    lines = stream.getvalue().splitlines()
    (warning,) = (line for line in lines if "a word" in line)
    assert "\x1b[33ma word\x1b[0m" in warning
    assert "fit" not in warning


def test_a_process_whose_progress_nobody_sees_and_an_inner_title_draw_nothing_and_nobody_listens_after_a_block(
    clock, monkeypatch
):
    with monkeypatch.context() as patch:
        patch.setenv(progress.QUIET, "1")
        assert shown(clock, [(0, "fit", 0.5)], Terminal()) == ""
    outer = io.StringIO()
    with progress_shown("outer", outer):
        assert shown(clock, [(0, "fit", 0.5)], Terminal()) == ""
    assert outer.getvalue() == "outer: fit\n"
    stream = io.StringIO()
    with contextlib.suppress(KeyError), progress_shown("sad on nordland", stream):
        raise KeyError
    progress.report("fit", 0.5)
    assert stream.getvalue() == ""
    heard = []
    with progress.listening(lambda _, done: heard.append(("outer", done))):
        progress.report("fit", 0.1)
        with progress.listening(lambda _, done: heard.append(("inner", done))):
            progress.report("fit", 0.2)
        progress.report("fit", 0.3)
    assert heard == [("outer", 0.1), ("inner", 0.2), ("outer", 0.3)]

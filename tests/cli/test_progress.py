"""What a person sees of a long run: lines in a file, a bar in a terminal, and nothing between the results."""

import contextlib
import io
import logging

import pytest
from stopped_clock import Clock

from vprbench import progress
from vprbench.progress import answers_alone, progress_shown

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
    monkeypatch.setattr("tqdm.std.time", clock.seconds)
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
    assert text.index("sad on nordland: fit  50 % |") < text.index("nordland: query   0 %")
    assert text.split("\r")[-1].strip() == ""
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
    with answers_alone() as say:
        say("an answer")


def test_what_is_printed_beside_the_answer_goes_to_standard_error_and_names_in_progress_are_not_obeyed(clock, capsys):
    with answers_alone() as say:
        print("a plug-in's word")
        say("the answer")
    assert capsys.readouterr() == ("the answer\n", "a plug-in's word\n")
    told = shown(clock, [(0, "\x1b[2Jfit", 0)], io.StringIO(), "a\nvprbench: b")
    assert told == "a\\nvprbench: b: \\x1b[2Jfit\n"


def test_a_process_that_is_read_marks_stages_and_warnings_which_stand_above_a_bar_elsewhere(clock, monkeypatch, capsys):
    monkeypatch.setenv(progress.MARKED, "1")
    lines = shown(clock, [(0, "fit\n", 0), (0.1, "fit\n", 0.5), (1, "fit\n", 0.75)], io.StringIO()).splitlines()
    assert [progress.marked(line) for line in lines] == [("fit\\n", 0.0), ("fit\\n", 0.75)]
    handler = progress._Lines()
    handler.setFormatter(progress._OneLine())
    for level in (logging.WARNING, logging.INFO):
        handler.handle(logging.makeLogRecord({"msg": "a\ttab", "levelno": level}))
    assert [progress.marked(line) for line in capsys.readouterr().err.splitlines()] == ["a\ttab", None]
    stream = Terminal()
    monkeypatch.delenv(progress.MARKED)
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.delenv("NO_COLOR", raising=False)
    handler = progress._Lines()
    handler.setFormatter(progress._OneLine())
    with progress_shown("sad on nordland"):
        progress.report("fit", 0.5)
        handler.handle(logging.makeLogRecord({"msg": "a word", "levelno": logging.WARNING}))
    assert "\r\x1b[33ma word\x1b[0m\n\r" in stream.getvalue()


def test_progress_that_is_shown_elsewhere_or_to_an_inner_listener_draws_nothing_and_nobody_listens_after_a_block(clock):
    told = []
    with progress.shown_by(lambda *each: told.append(each)):
        assert shown(clock, [(0, "fit", 0.5)], Terminal()) == ""
    assert told == [("fit", 0.5)]
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

"""What a person sees of a long run: lines in a file, a bar in a terminal, and nothing between the results."""

from __future__ import annotations

import contextlib
import io
import logging

import pytest
from stopped_clock import Clock

from vprbench import progress
from vprbench.progress import answers_alone, progress_shown


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    """Let no time pass but what a test spends, before a terminal of 80 columns."""
    clock = Clock()
    clock.spend(1000)
    clock.replaces_those_of([progress], monkeypatch)
    monkeypatch.setattr("tqdm.std.time", clock.seconds)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("LINES", "24")
    return clock


def lines_of(clock: Clock, reports: list[tuple[float, str, float]]) -> list[str]:
    """Return the lines that appear for reports of (seconds since the last one, stage, share done)."""
    stream = io.StringIO()
    with progress_shown("sad on nordland", stream):
        for seconds, stage, done in reports:
            clock.spend(seconds)
            progress.report(stage, done)
    return stream.getvalue().splitlines()


# Lines


@pytest.mark.parametrize(
    ("reports", "lines"),
    [
        ([(0, "fit", 0), (1, "query", 0.1), (1, "timing", 0)], ["fit", "query", "timing"]),
        ([(0, "fit", 0), (1, "query", 0), (1, "fit", 0)], ["fit", "query", "fit"]),
        ([(0, "query", 0), (5, "query", 0.2), (4.9, "query", 0.4)], ["query"]),
        ([(0, "query", 0), (12, "query", 0.25)], ["query", "query 25 %, 36 s left"]),  # 12 s for a quarter
        ([(0, "fit", 0), (500, "query", 0), (10, "query", 0.5)], ["fit", "query", "query 50 %, 10 s left"]),
        ([(0, "fit", 0), (60, "fit", 0.0)], ["fit"]),
        ([(0, "fit", 0), (60, "fit", 1.0)], ["fit"]),
    ],
    ids=["each stage", "a stage again", "within ten seconds", "later", "from its start", "no share", "finished"],
)
def test_a_stage_has_a_line_and_a_long_one_its_share_and_the_time_left(
    clock: Clock, capsys: pytest.CaptureFixture[str], reports: list[tuple[float, str, float]], lines: list[str]
) -> None:
    assert lines_of(clock, reports) == [f"sad on nordland: {line}" for line in lines]
    assert capsys.readouterr().out == ""


# The bar


def drawn(*reports: tuple[str, float]) -> str:
    stream = Terminal()
    with progress_shown("sad on nordland", stream):
        for stage, done in reports:
            progress.report(stage, done)
    return stream.getvalue()


def test_a_bar_names_each_stage_starts_again_with_it_and_is_gone_at_the_end(
    capsys: pytest.CaptureFixture[str],
) -> None:
    text = drawn(("fit", 1.0), ("query", 0.0))
    assert text.index("nordland: fit") < text.index("nordland: query   0 %")
    assert text.split("\r")[-1].strip() == ""
    assert capsys.readouterr().out == ""


def test_a_bar_shows_the_share_done(clock: Clock) -> None:
    stream = Terminal()
    with progress_shown("sad on nordland", stream):
        progress.report("fit", 0.0)
        clock.spend(0.15)  # a bar is drawn ten times a second at most
        progress.report("fit", 0.5)
    assert "sad on nordland: fit  50 % |" in stream.getvalue()


class Gone(io.StringIO):
    """A stream whose reader has gone."""

    def write(self, _: str) -> int:
        raise BrokenPipeError


@pytest.mark.parametrize("terminal", [False, True])
def test_a_reader_that_has_gone_ends_no_run(terminal: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Gone()
    monkeypatch.setattr(stream, "isatty", lambda: terminal)
    with progress_shown("sad on nordland", stream):
        progress.report("fit", 0.5)
    monkeypatch.setattr("sys.stdout", stream)
    with answers_alone() as say:
        say("an answer")


def test_what_is_printed_beside_the_answer_goes_to_standard_error(capsys: pytest.CaptureFixture[str]) -> None:
    with answers_alone() as say:
        print("a plug-in's word")
        say("the answer")
    assert capsys.readouterr() == ("the answer\n", "a plug-in's word\n")


def test_names_in_progress_are_not_obeyed() -> None:
    stream = io.StringIO()
    with progress_shown("a\nvprbench: b", stream):
        progress.report("\x1b[2Jfit", 0)
    assert stream.getvalue() == "a\\nvprbench: b: \\x1b[2Jfit\n"


# To a process that reads it


def test_a_process_that_is_read_marks_its_stages_and_warnings(
    clock: Clock, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(progress.MARKED, "1")
    lines = lines_of(clock, [(0, "fit\n", 0), (0.1, "fit\n", 0.5), (1, "fit\n", 0.75)])
    assert [progress.marked(line) for line in lines] == [("fit\\n", 0.0), ("fit\\n", 0.75)]
    handler = progress._Lines()
    handler.setFormatter(progress._OneLine())
    for level in ("WARNING", "INFO"):
        handler.handle(logging.makeLogRecord({"msg": "a\ttab", "levelno": getattr(logging, level)}))
    assert [progress.marked(line) for line in capsys.readouterr().err.splitlines()] == ["a\ttab", None]


def test_progress_that_is_shown_elsewhere_draws_nothing() -> None:
    told: list[tuple[str, float]] = []
    stream = Terminal()
    with progress.shown_by(lambda *each: told.append(each)), progress_shown("sad on nordland", stream):
        progress.report("fit", 0.5)
    assert (told, stream.getvalue()) == ([("fit", 0.5)], "")


def test_a_warning_stands_above_a_bar_and_is_coloured(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Terminal()
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.delenv("NO_COLOR", raising=False)
    handler = progress._Lines()
    handler.setFormatter(progress._OneLine())
    with progress_shown("sad on nordland"):
        progress.report("fit", 0.5)
        handler.handle(logging.makeLogRecord({"msg": "a word", "levelno": logging.WARNING}))
    assert "\r\x1b[33ma word\x1b[0m\n\r" in stream.getvalue()


# Listening


def test_nobody_listens_after_a_block_even_if_it_failed() -> None:
    stream = io.StringIO()
    with contextlib.suppress(KeyError), progress_shown("sad on nordland", stream):
        raise KeyError
    progress.report("fit", 0.5)
    assert stream.getvalue() == ""


def test_an_inner_listener_hides_the_outer_one_for_a_while() -> None:
    outer: list[float] = []
    inner: list[float] = []
    with progress.listening(lambda _, done: outer.append(done)):
        progress.report("fit", 0.1)
        with progress.listening(lambda _, done: inner.append(done)):
            progress.report("fit", 0.2)
        progress.report("fit", 0.3)
    assert (outer, inner) == ([0.1, 0.3], [0.2])

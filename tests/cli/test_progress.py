"""What a person sees of a long run: lines in a file, a bar in a terminal, and nothing between the results."""

from __future__ import annotations

import io

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


def test_each_stage_has_a_line(clock: Clock) -> None:
    reports = [(0, "fit", 0), (1, "query", 0.1), (1, "timing", 0)]
    assert lines_of(clock, reports) == [f"sad on nordland: {stage}" for stage in ("fit", "query", "timing")]


def test_a_stage_that_comes_again_has_a_line_again(clock: Clock) -> None:
    assert len(lines_of(clock, [(0, "fit", 0), (1, "query", 0), (1, "fit", 0)])) == 3


def test_within_ten_seconds_a_stage_has_no_second_line(clock: Clock) -> None:
    assert len(lines_of(clock, [(0, "query", 0), (5, "query", 0.2), (4.9, "query", 0.4)])) == 1


def test_after_ten_seconds_a_stage_has_a_second_line(clock: Clock) -> None:
    assert len(lines_of(clock, [(0, "query", 0), (10, "query", 0.2)])) == 2


def test_a_long_stage_has_a_line_every_ten_seconds(clock: Clock) -> None:
    reports = [(0, "query", 0.0), *[(1, "query", 0.01 * second) for second in range(1, 36)]]
    assert len(lines_of(clock, reports)) == 4  # at 0, 10, 20 and 30 s


def test_a_line_tells_the_share_done_and_the_time_left(clock: Clock) -> None:
    lines = lines_of(clock, [(0, "query", 0), (12, "query", 0.25)])
    assert lines[1] == "sad on nordland: query 25 %, 36 s left"  # 12 s for a quarter


def test_the_time_left_counts_from_the_start_of_the_stage(clock: Clock) -> None:
    lines = lines_of(clock, [(0, "fit", 0), (500, "query", 0), (10, "query", 0.5)])
    assert lines[-1].endswith("50 %, 10 s left")


def test_a_stage_without_a_known_share_has_no_time_left(clock: Clock) -> None:
    assert lines_of(clock, [(0, "fit", 0), (60, "fit", 0.0)]) == ["sad on nordland: fit"]


def test_a_finished_stage_says_nothing_of_time_left(clock: Clock) -> None:
    assert lines_of(clock, [(0, "fit", 0), (60, "fit", 1.0)]) == ["sad on nordland: fit"]


def test_lines_are_plain_text(clock: Clock) -> None:
    text = "\n".join(lines_of(clock, [(0, "query", 0), (12, "query", 0.25), (12, "query", 0.5)]))
    assert "\r" not in text
    assert "\x1b" not in text


def test_lines_never_reach_the_standard_output(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    lines_of(clock, [(0, "fit", 0), (12, "fit", 0.25)])
    assert capsys.readouterr().out == ""


# The bar


def drawn(*reports: tuple[str, float]) -> str:
    stream = Terminal()
    with progress_shown("sad on nordland", stream):
        for stage, done in reports:
            progress.report(stage, done)
    return stream.getvalue()


def test_a_terminal_gets_a_bar_on_its_own_stream() -> None:
    assert "sad on nordland: fit" in drawn(("fit", 0.0))


def test_a_bar_shows_the_share_done(clock: Clock) -> None:
    stream = Terminal()
    with progress_shown("sad on nordland", stream):
        progress.report("fit", 0.0)
        clock.spend(0.15)  # a bar is drawn ten times a second at most
        progress.report("fit", 0.5)
    assert "sad on nordland: fit  50 % |" in stream.getvalue()


def test_a_bar_names_each_stage() -> None:
    text = drawn(("fit", 0.0), ("query", 0.0))
    assert text.index("nordland: fit") < text.index("nordland: query")


def test_a_bar_is_gone_at_the_end() -> None:
    assert drawn(("fit", 0.5)).split("\r")[-1].strip() == ""


def test_a_bar_starts_again_with_each_stage() -> None:
    assert "query   0 %" in drawn(("fit", 1.0), ("query", 0.0))


def test_a_bar_never_reaches_the_standard_output(capsys: pytest.CaptureFixture[str]) -> None:
    drawn(("fit", 0.5), ("query", 0.5))
    assert capsys.readouterr().out == ""


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


# Listening


def test_nobody_needs_to_listen() -> None:
    progress.report("fit", 0.5)


def test_nobody_listens_after_the_block() -> None:
    stream = io.StringIO()
    with progress_shown("sad on nordland", stream):
        pass
    progress.report("fit", 0.5)
    assert stream.getvalue() == ""


def test_nobody_listens_after_a_block_that_failed() -> None:
    stream = io.StringIO()
    with pytest.raises(KeyError), progress_shown("sad on nordland", stream):
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

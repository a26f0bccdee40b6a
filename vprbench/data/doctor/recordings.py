"""Checks of event recordings: times that run backwards, gaps, hot pixels, polarity, and positions of other times."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vprbench import progress
from vprbench.api.dataset import Dataset
from vprbench.api.events import Events, Recording, hot_pixels
from vprbench.errors import BadInput
from vprbench.text import format_count, join_names

from .finding import Finding, Level

_LATE_US = 10_000  # sensors send packets whose events are not all in order
_GAP_US = 500_000  # without any event
_LISTED = 100  # gaps
_HOT_FACTOR = 10.0
_ONE_POLARITY = 0.98  # share of the events
_COVERED = 0.9  # share of a recording with positions


class _Seen:
    """What is kept of a recording that is read once, in bounded memory."""

    def __init__(self, of: Recording) -> None:
        self.of = of
        self.totals = np.zeros((2, of.height * of.width), np.int64)  # falling, rising
        self.gaps: list[str] = []
        self.first_us: int | None = None
        self.last_us = self.backwards = self.most_us = 0

    def add(self, events: Events) -> None:
        """Take the next chunk of the recording, of one event at least."""
        t = events.t
        if self.first_us is None:
            self.first_us = self.last_us = int(t[0])
        steps = np.diff(t, prepend=self.last_us)
        self.last_us = int(t[-1])
        self.backwards += int((steps < 0).sum())
        self.most_us = max(self.most_us, -int(steps.min()))
        gaps = np.flatnonzero(steps > _GAP_US)[: _LISTED - len(self.gaps)]
        self.gaps += [f"{steps[i] / 1e6:.2f} s before {t[i] / 1e6:.2f} s" for i in gaps]
        np.add.at(self.totals, (events.p.astype(np.int64), events.y.astype(np.int64) * self.of.width + events.x), 1)


def check_recordings(dataset: Dataset) -> Iterator[Finding]:
    """Read every recording of a dataset and say what is wrong with it."""
    for number, recording in enumerate(dataset.recordings):
        progress.report("reading recordings", number / len(dataset.recordings))
        seen = _Seen(recording)
        try:
            for events in recording.events():
                if len(events.t):
                    seen.add(events)
        except (BadInput, IndexError) as error:
            yield Finding("error", "events", f"the recording of {recording.name} cannot be read to its end: {error}")
        if seen.first_us is not None:
            yield from _check_times(seen)
            yield from _check_pixels(seen, removed=dataset.protocol.get("hot_factor") is not None)
            yield from _check_positions(recording, seen.first_us, seen.last_us)


def _check_times(seen: _Seen) -> Iterator[Finding]:
    name = seen.of.name
    if seen.backwards:
        text = f"time runs backwards {format_count(seen.backwards, 'time')} in {name}, by up to {seen.most_us:,} us"
        advice = "sort the events by time, or join the parts of the recording in their order"
        yield Finding("error" if seen.most_us > _LATE_US else "note", "time", text, advice)
    if seen.gaps:
        text = f"{format_count(len(seen.gaps), 'gap')} without any event in {name}: {join_names(seen.gaps)}"
        yield Finding("warning", "gaps", text, "data were lost: leave out the places of these times")


def _check_pixels(seen: _Seen, removed: bool) -> Iterator[Finding]:
    totals, width, name = seen.totals.sum(0), seen.of.width, seen.of.name
    number = totals.sum()
    hot = np.flatnonzero(hot_pixels(totals.reshape(-1, width), _HOT_FACTOR))
    if len(hot):
        where = join_names(
            f"({pixel % width}, {pixel // width})" for pixel in hot[np.argsort(-totals[hot], kind="stable")]
        )
        text = (
            f"{format_count(len(hot), 'pixel')} sent {totals[hot].sum() / number:.1%} of {name} (column, row): {where}"
        )
        advice = "let the dataset remove them (dataset.hot_factor): they send whatever the camera sees"
        yield Finding("note" if removed else "warning", "hot pixels", text, "" if removed else advice)
    rising = seen.totals[1].sum() / number
    if not 1 - _ONE_POLARITY <= rising <= _ONE_POLARITY:
        text = f"{rising:.1%} of the {number:,} events of {name} are rising"
        yield Finding("warning", "polarity", text, "look at how it is written: -1 and 1, read as truth, are both true")


def _check_positions(recording: Recording, first: int, last: int) -> Iterator[Finding]:
    """Find positions that do not ascend in time, and positions of other times than the events, in microseconds."""
    times, name = recording.positions_us, recording.name
    if times is None:
        return
    if (np.diff(times) <= 0).any():
        yield Finding("error", "clocks", f"the times of the positions of {name} do not ascend", "sort them by time")
        return
    share = max(0.0, (min(last, int(times[-1])) - max(first, int(times[0]))) / max(1, last - first))
    if share < _COVERED:
        theirs, ours = (f"{a / 1e6:.1f} to {b / 1e6:.1f} s" for a, b in (times[[0, -1]], (first, last)))
        text = f"positions of {name} are of {theirs}, events of {ours}: {share:.0%} of these have positions"
        level: Level = "warning" if share > _COVERED / 2 else "error"
        yield Finding(level, "clocks", text, "bring both to one unit and one zero")

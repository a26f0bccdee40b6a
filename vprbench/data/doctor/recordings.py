"""Checks of event recordings: times that run backwards, gaps, hot pixels, polarity, and clocks out of step."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from vprbench import progress
from vprbench.api.dataset import Dataset
from vprbench.api.events import Events, Micros, Recording, hot_pixels
from vprbench.errors import BadInput
from vprbench.text import plural, some

from . import offsets
from .finding import Finding, Level
from .traverse import middles_of

_LATE_US = 10_000  # sensors send packets whose events are not all in order
_GAP_US = 500_000  # without any event
_LISTED = 100  # gaps
_HOT_FACTOR = 10.0
_ONE_POLARITY = 0.98  # share of the events
_CELLS = 8  # rows and columns of the small picture of a frame's net polarity
_BIN_US = 500_000
_REACH = 40  # bins by which the clock of the positions may be off
_AGREE, _BETTER = 0.5, 0.1  # correlation of speed and rate of events under another clock, and by how much it is better
_COVERED = 0.9  # share of a recording with positions


class _Seen:
    """What is kept of a recording that is read once, in bounded memory."""

    def __init__(self, of: Recording) -> None:
        self.of = of
        middle = np.zeros(0, np.int64) if of.middle_us is None else of.middle_us
        self._edges = (middle[1:] + middle[:-1]) // 2  # between frames
        self.net = np.zeros((len(middle), _CELLS**2), np.float32)  # of each frame, rising less falling
        self.totals = np.zeros((2, of.height * of.width), np.int64)  # falling, rising
        self.rates: Counter[int] = Counter()  # events by the number of the bin
        self.gaps: list[str] = []
        self.first_us = self.last_us = self.backwards = self.most_us = 0

    def add(self, events: Events) -> None:
        """Take the next chunk of the recording, of one event at least."""
        t, y, x = events.t, events.y.astype(np.int64), events.x.astype(np.int64)
        if not self.rates:
            self.first_us = self.last_us = int(t[0])
        steps = np.diff(t, prepend=self.last_us)
        self.last_us = int(t[-1])
        self.backwards += int((steps < 0).sum())
        self.most_us = max(self.most_us, -int(steps.min()))
        gaps = np.flatnonzero(steps > _GAP_US)[: _LISTED - len(self.gaps)]
        self.gaps += [f"{steps[i] / 1e6:.2f} s before {t[i] / 1e6:.2f} s" for i in gaps]
        for number, count in zip(*np.unique(t // _BIN_US, return_counts=True), strict=True):
            self.rates[int(number)] += int(count)
        np.add.at(self.totals, (events.p.astype(np.int64), y * self.of.width + x), 1)
        if len(self.net):
            cell = y * _CELLS // self.of.height * _CELLS + x * _CELLS // self.of.width
            np.add.at(self.net, (np.searchsorted(self._edges, t), cell), np.where(events.p, 1, -1))


def of_recordings(dataset: Dataset) -> Iterator[Finding]:
    """Read every recording of a dataset and say what is wrong with it."""
    seen = [_Seen(recording) for recording in dataset.recordings]
    for number, one in enumerate(seen):
        progress.report("reading recordings", number / len(seen))
        try:
            for events in one.of.events():
                if len(events.t):
                    one.add(events)
        except (BadInput, IndexError) as error:
            yield Finding("error", "events", f"the recording of {one.of.name} cannot be read to its end: {error}")
        if one.rates:
            yield from _times(one)
            yield from _pixels(one, removed=dataset.protocol.get("hot_factor") is not None)
            yield from _clock(one)
    if seen:
        yield from _inverted(dataset, seen)


def _times(seen: _Seen) -> Iterator[Finding]:
    name = seen.of.name
    if seen.backwards:
        text = f"time runs backwards {plural(seen.backwards, 'time')} in {name}, by up to {seen.most_us:,} us"
        advice = "sort the events by time, or join the parts of the recording in their order"
        yield Finding("error" if seen.most_us > _LATE_US else "note", "time", text, advice)
    if seen.gaps:
        text = f"{plural(len(seen.gaps), 'gap')} without any event in {name}: {some(seen.gaps)}"
        yield Finding("warning", "gaps", text, "data were lost: leave out the places of these times")


def _pixels(seen: _Seen, removed: bool) -> Iterator[Finding]:
    totals, width, name = seen.totals.sum(0), seen.of.width, seen.of.name
    number = totals.sum()
    hot = np.flatnonzero(hot_pixels(totals.reshape(-1, width), _HOT_FACTOR))
    if len(hot):
        where = some(f"({pixel % width}, {pixel // width})" for pixel in hot[np.argsort(-totals[hot], kind="stable")])
        text = f"{plural(len(hot), 'pixel')} sent {totals[hot].sum() / number:.1%} of {name} (column, row): {where}"
        advice = "let the dataset remove them (dataset.hot_factor): they send whatever the camera sees"
        yield Finding("note" if removed else "warning", "hot pixels", text, "" if removed else advice)
    rising = seen.totals[1].sum() / number
    if not 1 - _ONE_POLARITY <= rising <= _ONE_POLARITY:
        text = f"{rising:.1%} of the {number:,} events of {name} are rising"
        yield Finding("warning", "polarity", text, "look at how it is written: -1 and 1, read as truth, are both true")


def _inverted(dataset: Dataset, seen: Sequence[_Seen]) -> Iterator[Finding]:
    """Find reference traverses whose light falls where that of the queries rises at the same places."""
    middles = middles_of(dataset)
    asked = np.flatnonzero(middles >= 0)
    nets = [one.net - one.net.sum(0) / max(1, len(one.net)) for one in seen]  # without what a camera favours
    *references, query = [offsets.of_places(net, np.arange(len(net)), len(net)) for net in nets]
    for one, net in zip(seen, references, strict=False):
        if (len(net), len(query)) == (dataset.n_places, len(middles)):
            likeness = offsets.under(query[asked], middles[asked], net)
            won, stretches, sure = offsets.stretches_won(0 * likeness, likeness)
            if sure:
                told = f"likeness {likeness.mean():.2f}; {won} of {stretches} stretches agree"
                text = f"light falls in {one.of.name} where it rises in {seen[-1].of.name} ({told})"
                advice = "the polarity of one of them is inverted, or they run in opposite directions"
                yield Finding("warning", "polarity", text, advice)


def _clock(seen: _Seen) -> Iterator[Finding]:
    """Find positions of other times than the events, and a speed that fits the rate of events at another time."""
    times, name, (first, last) = seen.of.positions_us, seen.of.name, (seen.first_us, seen.last_us)
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
    late, there, here = _offset(seen, times)
    if late and there > max(_AGREE, here + _BETTER):
        text = f"positions of {name} come {late:+.1f} s late: speed and events a second correlate with {there:.2f} then"
        advice = f"subtract {late:.1f} s from the times of the positions"
        yield Finding("warning", "clocks", f"{text}, with {here:.2f} as they are", advice)


def _offset(seen: _Seen, times: Micros) -> tuple[float, float, float]:
    """Return by how many seconds positions come late, and how speed and rate correlate then and as they are."""
    first, last = min(seen.rates) + 1, max(seen.rates)  # of the bins that are whole
    if seen.of.positions_metres is None or last - first < 2 * _REACH:
        return 0.0, 0.0, 0.0
    rate = np.log1p([seen.rates[number] for number in range(first, last)])
    edges = np.arange(first - _REACH, last + _REACH + 1) * _BIN_US
    along = [np.interp(edges, times, axis, np.nan, np.nan) for axis in seen.of.positions_metres.T]
    speed = np.linalg.norm(np.diff(along), axis=0)
    agreement = np.zeros(2 * _REACH + 1)
    for shift in range(len(agreement)):
        then = speed[shift : shift + len(rate)]
        known = np.isfinite(then)
        if known.mean() > 0.5 and min(then[known].std(), rate[known].std()) > 0:
            agreement[shift] = np.corrcoef(then[known], rate[known])[0, 1]
    best = int(agreement.argmax())
    return (best - _REACH) * _BIN_US / 1e6, float(agreement[best]), float(agreement[_REACH])

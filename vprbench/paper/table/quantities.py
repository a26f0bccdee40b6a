"""The quantities of Table II: each knows its head and unit, whose runs it shows, and how they become a number."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import mean, median
from typing import ClassVar, Literal

from vprbench.metrics.accuracy import hits_at, recall_at
from vprbench.metrics.intervals import WiderInterval
from vprbench.metrics.registry import METRICS, Metric
from vprbench.paper.plan import PlannedColumn, Row
from vprbench.paper.selection import DEVICES, Device
from vprbench.paper.table.best import (
    Contestant,
    best_rate,
    best_recall,
    best_training,
    disturbed,
    mean_recall,
    rate,
)
from vprbench.paper.table.reasons import Reason, of_accuracy, of_rates, of_times, other_timing, reason, short
from vprbench.runs.notes import DISTURBED, FAILED_AUDITS, NoteKind
from vprbench.runs.recall_intervals import recall_interval
from vprbench.runs.record import Run

TRAINING_TIME = (  # of the table, the page and the README
    "Wall time from the first reference image to the finished map, without waiting for images to be read or rendered; "
    "in brackets with waiting for them."
)
_APART: frozenset[NoteKind] = DISTURBED | {
    "offline",
    "described",
    "resumed",
    "fitted",
}  # told by a mark, or with the training alone


@dataclass(frozen=True)
class Numbers:
    """What the runs of one cell gave, in the quantity's unit."""

    values: Sequence[float]  # one a seed
    value: float  # of all seeds
    total: float | None = None  # with the steps that `value` leaves out
    at_boundary: float | None = None  # of the step alone that the paper timed
    interval: WiderInterval | None = None  # 95 %, 0 to 1

    @property
    def compared(self) -> float:
        """Return what stands beside a published number."""
        return self.value if self.at_boundary is None else self.at_boundary


@dataclass(frozen=True)
class Quantity(ABC):
    """A column of the table."""

    name: str  # in the CSV, and of what the paper printed
    head: str
    unit: str
    device: Device | None = None  # whose runs it shows; None: those of the device with the most seeds
    audited: ClassVar[bool] = False  # notes of failed audits are told here, and not elsewhere
    of_answers: ClassVar[bool] = False  # some of the queries alone have a number too

    @property
    def heading(self) -> str:
        """The head of its column, with the unit."""
        return f"{self.head} {self.unit}".rstrip()

    def source(self, row: Row) -> Literal["measured", "quoted", "none"]:
        """Return where a row's number comes from; none: the row has no such step."""
        return "measured"

    def shown(self, row: Row, runs: tuple[Run, ...]) -> tuple[Run, ...]:
        """Return the runs of a row that measured the quantity."""
        return runs

    @abstractmethod
    def numbers(self, row: Row, runs: Sequence[Run]) -> Numbers | None:
        """Return what the runs of a row gave; None if it is undefined."""

    def best(self, rows: Sequence[Contestant]) -> str | None:
        """Return the row that a test separates from all others; None if no row is, or if there is no test."""
        return None

    def contends(self, row: Row) -> bool:
        """Tell whether a row is compared with the others."""
        return True

    def disturbed(self, runs: Sequence[Run]) -> bool:
        """Tell whether a busy machine or too few laps make the number doubtful."""
        return any(map(disturbed, runs))

    def lacking(self, runs: Sequence[Run]) -> Reason:
        """Return why none of a row's runs measured the quantity."""
        return self.undefined(runs)

    def undefined(self, runs: Sequence[Run]) -> Reason:
        """Return why runs of a row give no number."""
        return Reason("undefined", "no query has a right place")

    def set_apart(self, runs: Mapping[str, Sequence[Run]]) -> Mapping[str, Reason]:
        """Return by row how it was measured otherwise than the others of a column."""
        return {}

    def differences(self, row: Row, planned: PlannedColumn, real: str | None, run: Run) -> Iterator[Reason]:
        """Yield why the number and the paper's cannot be compared; `real` is the dataset behind a rendered column."""
        yield from of_accuracy(planned, real, run)

    def remarks(self, row: Row, runs: Sequence[Run]) -> Iterator[Reason]:
        """Yield what a reader of a number has to know, from the notes of its runs among others."""
        yield from _told(runs, [kind for kind in _kinds(runs) - _APART if (kind in FAILED_AUDITS) == self.audited])

    def text(self, value: float) -> str:
        """Return a number with two digits or all that stand before the point."""
        if value == 0 or not math.isfinite(value):
            return f"{value:g}"
        return f"{value:,.{max(0, 1 - exponent(value, 1))}f}"


@dataclass(frozen=True)
class Recall(Quantity):
    """R@1, the expected value under ties, with its interval."""

    of_answers: ClassVar[bool] = True

    def numbers(self, row: Row, runs: Sequence[Run]) -> Numbers | None:
        """Return R@1 of the runs with its interval; None if no query has a right place."""
        if mean_recall(runs) is None:
            return None
        values = [100 * float(hits_at(run.outcome, 1).mean()) for run in runs]
        return Numbers(values, mean(values), interval=recall_interval(runs))

    def best(self, rows: Sequence[Contestant]) -> str | None:
        """Compare the hits of all pairs of seeds."""
        return best_recall(rows)

    def disturbed(self, runs: Sequence[Run]) -> bool:
        """Say no: answers do not hang on the machine."""
        return False

    def remarks(self, row: Row, runs: Sequence[Run]) -> Iterator[Reason]:
        """Yield the lowest and highest R@1 if it hangs on ties, then the notes."""
        recalls = [recall for run in runs if (recall := recall_at(run.outcome, 1)) is not None]
        if any(recall.hangs_on_ties for recall in recalls):
            low, high = (100 * mean(getattr(r, way) for r in recalls) for way in ("pessimistic", "optimistic"))
            yield reason("ties", low, high)
        yield from super().remarks(row, runs)

    def text(self, value: float) -> str:
        """Return a number with one decimal."""
        return f"{value:.1f}"


@dataclass(frozen=True)
class OfMetric(Recall):
    """One of `METRICS`: the mean over the seeds, in no contest."""

    metric: Metric = METRICS["recall_at_1"]

    def undefined(self, runs: Sequence[Run]) -> Reason:
        """Return why a cost is not known, or that answers leave an accuracy undefined."""
        told = (run.energy["how"].get(self.metric.name) for run in runs if run.energy is not None)
        why = next(filter(None, told), None) if self.metric.cost is not None else None
        if why is None:
            return Reason("undefined", "undefined for the answers of this row")
        return short("undefined", f"{self.metric.words} n/a: {why}")

    def numbers(self, row: Row, runs: Sequence[Run]) -> Numbers | None:
        """Return the metric in its unit; None if it is undefined for all runs."""
        values = [self.metric.shown(value) for run in runs if (value := self.metric.of(run)) is not None]
        return Numbers(values, mean(values)) if values else None

    def best(self, rows: Sequence[Contestant]) -> str | None:
        """Name no row: there is no test."""
        return None

    def remarks(self, row: Row, runs: Sequence[Run]) -> Iterator[Reason]:
        """Yield the notes."""
        return Quantity.remarks(self, row, runs)

    def text(self, value: float) -> str:
        """Return a number with the digits of the metric."""
        return self.metric.rounded_text(value)


@dataclass(frozen=True)
class Training(Quantity):
    """Minutes of training without waiting for images: the median over the seeds."""

    device: Device = "cpu"

    def source(self, row: Row) -> Literal["measured", "quoted", "none"]:
        """Quote the paper for networks that come trained."""
        return "measured" if row.learns_here else "none" if row.training == "none" else "quoted"

    def shown(self, row: Row, runs: tuple[Run, ...]) -> tuple[Run, ...]:
        """Return the runs that trained."""
        return tuple(run for run in runs if run.fit_compute_seconds is not None)

    def lacking(self, runs: Sequence[Run]) -> Reason:
        """Return what was used in the place of a training."""
        return reason("loaded" if any(run.network is not None for run in runs) else "kept")

    def numbers(self, row: Row, runs: Sequence[Run]) -> Numbers:
        """Return the minutes without waiting for images, and the wall time as the total."""
        values = [run.training_compute_seconds / 60 for run in runs if run.training_compute_seconds is not None]
        wall = median(run.training_seconds / 60 for run in runs if run.training_seconds is not None)
        return Numbers(values, median(values), wall)

    def best(self, rows: Sequence[Contestant]) -> str | None:
        """Compare all pairs of seeds."""
        return best_training(rows)

    def contends(self, row: Row) -> bool:
        """Leave out rows that only build a map."""
        return row.training != "map"

    def differences(self, row: Row, planned: PlannedColumn, real: str | None, run: Run) -> Iterator[Reason]:
        """Yield why the times cannot be compared."""
        return of_times(planned, real, run, self.device)

    def remarks(self, row: Row, runs: Sequence[Run]) -> Iterator[Reason]:
        """Yield what kind of training it is."""
        if row.training == "map":
            yield reason("map")
        yield from _told(runs, ["resumed", "fitted"])


@dataclass(frozen=True)
class Rate(Quantity):
    """Queries per second, encode and match together, 1 / median of the streaming laps: the mean over the seeds."""

    device: Device = "cpu"
    audited: ClassVar[bool] = True

    def shown(self, row: Row, runs: tuple[Run, ...]) -> tuple[Run, ...]:
        """Return the runs that were timed."""
        return tuple(run for run in runs if run.timing is not None)

    def numbers(self, row: Row, runs: Sequence[Run]) -> Numbers:
        """Return the rates, and that of the step that the paper timed of the row."""
        values = list(map(rate, runs))
        alone = None if row.boundary is None else mean(rate(run, row.boundary) for run in runs)
        return Numbers(values, mean(values), at_boundary=alone)

    def best(self, rows: Sequence[Contestant]) -> str | None:
        """Compare the laps of all pairs of seeds."""
        return best_rate(rows)

    def lacking(self, runs: Sequence[Run]) -> Reason:
        """Return that the runs were not timed."""
        return reason("untimed")

    def set_apart(self, runs: Mapping[str, Sequence[Run]]) -> Mapping[str, Reason]:
        """Return the rows that were timed otherwise than most."""
        return other_timing(runs)

    def differences(self, row: Row, planned: PlannedColumn, real: str | None, run: Run) -> Iterator[Reason]:
        """Yield why the times cannot be compared, and what is known of how the paper timed the row."""
        yield from of_times(planned, real, run, self.device)
        yield from of_rates(row, planned)


RECALL = Recall("recall_at_1", "R@1", "%")
TRAINING = (Training("train_cpu", "train CPU", "min", "cpu"), Training("train_gpu", "train GPU", "min", "cuda"))
RATES = (Rate("query_cpu", "query CPU", "Hz", "cpu"), Rate("query_gpu", "query GPU", "Hz", "cuda"))
#: Those of the paper, in its order.
QUANTITIES: tuple[Quantity, ...] = (RECALL, TRAINING[0], RATES[0], TRAINING[1], RATES[1])


def quantities(metrics: Sequence[str], devices: Collection[Device] = DEVICES) -> tuple[Quantity, ...]:
    """Return the columns of a table: those of the paper, times on these devices, and `metrics` by their names."""
    shown = (one for one in QUANTITIES if one.device is None or one.device in devices)
    more = (METRICS[name] for name in dict.fromkeys(metrics) if name != RECALL.name)
    return (*shown, *(OfMetric(one.name, one.words, one.unit, metric=one) for one in more))


def exponent(value: float, decimals: int) -> int:
    """Return the power of ten of a number that is rounded to so many decimals behind its first digit: 9.96 is 10."""
    return int(f"{value:.{decimals}e}".partition("e")[2])


def _kinds(runs: Sequence[Run]) -> frozenset[NoteKind]:
    return frozenset(note.kind for run in runs for note in run.notes)


def _told(runs: Sequence[Run], kinds: Sequence[NoteKind]) -> Iterator[Reason]:
    return (short("note", note.text) for run in runs for note in run.notes if note.kind in kinds)

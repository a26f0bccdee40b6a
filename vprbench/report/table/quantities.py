"""The quantities of a table: which fact of the frame of runs each shows, in which unit and over the seeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import mean, median
from typing import Literal

from vprbench.metrics.catalogue import METRICS, Metric
from vprbench.report.plan import Row
from vprbench.report.selection import DEVICES, Device, MethodRuns
from vprbench.report.table.best import find_best_rate, find_most_accurate
from vprbench.text import format_two_digits

TRAINING_TIME = (  # of the table, the page and the README
    "Wall time from the first reference image to the finished map, without waiting for images to be read or rendered; "
    "in brackets with waiting for them."
)

Kind = Literal[
    "accuracy",  # of the answers, on the device with the most seeds
    "training",  # the step whose time is published, quoted of networks that come trained
    "fit",  # of every row, whatever it does there
    "rate",
    "memory",
]
TIMES: tuple[Kind, ...] = ("training", "fit", "rate")


@dataclass(frozen=True)
class Quantity:
    """A column of the table: a fact of the frame of runs (`vprbench.runs.frame`), over the seeds of a row."""

    name: str  # in the CSV, and in that of published numbers
    head: str
    unit: str
    fact: str  # column of the frame of runs; a run without a time is not shown
    kind: Kind = "accuracy"
    device: Device | None = None  # whose runs it shows; None: those of the device with the most seeds
    in_unit: Callable[[float], float] = float
    over_seeds: Callable[[Sequence[float]], float] = mean
    text: Callable[[float], str] = format_two_digits
    total: str | None = None  # the fact that takes in the steps that `fact` leaves out
    best: Callable[[Sequence[MethodRuns]], str | None] = lambda rows: None  # the row that a test separates from all
    metric: Metric | None = None  # of an accuracy or a cost

    @property
    def heading(self) -> str:
        """The head of its column, with the unit."""
        return f"{self.head} {self.unit}".rstrip()

    def find_source(self, row: Row) -> Literal["measured", "quoted", "none"]:
        """Return where a row's number comes from; none: the row has no such step."""
        if self.kind != "training" or row.learns_here:
            return "measured"
        return "none" if row.training == "none" else "quoted"


def _make_accuracy(name: str) -> Quantity:
    one = METRICS[name]
    best = (lambda rows: None) if one.per_query is None else partial(find_most_accurate, metric=one)
    shown = (one.name, one.words, one.unit, one.name)
    return Quantity(*shown, in_unit=one.shown, text=one.rounded_text, best=best, metric=one)


def _make_training(name: str, head: str, device: Device) -> Quantity:
    return Quantity(
        *(name, head, "min", "fit_compute_seconds", "training", device),
        in_unit=lambda seconds: seconds / 60,
        over_seeds=median,
        total="fit_seconds",
    )


def _make_rate(name: str, head: str, device: Device) -> Quantity:
    return Quantity(name, head, "Hz", "streaming_total_hz", "rate", device, best=find_best_rate)


RECALL = _make_accuracy("recall_at_1")
TRAINING = (_make_training("train_cpu", "train CPU", "cpu"), _make_training("train_gpu", "train GPU", "cuda"))
RATES = (_make_rate("query_cpu", "query CPU", "cpu"), _make_rate("query_gpu", "query GPU", "cuda"))
#: Of a table, in its order.
QUANTITIES: tuple[Quantity, ...] = (RECALL, TRAINING[0], RATES[0], TRAINING[1], RATES[1])


def list_quantities(metrics: Sequence[str]) -> tuple[Quantity, ...]:
    """Return the columns of a table: recall, times, and `metrics` by their names."""
    return (*QUANTITIES, *_list_more(metrics))


def list_comparison_quantities(metrics: Sequence[str], devices: Sequence[str]) -> tuple[Quantity, ...]:
    """Return the columns of a comparison on some devices: accuracies, seconds of the fit, query rates and memory."""
    kinds = [kind for kind in DEVICES if any(device.startswith(kind) for device in devices)]
    accuracies = _list_more(["recall_at_5", "auc_pr_a", *metrics])
    trainings = [one for one in TRAINING if one.device in kinds]
    heads = [one.head.replace("train", "fit") if len(kinds) > 1 else "fit" for one in trainings]
    fits = [
        Quantity(one.name, head, "s", "fit_seconds", "fit", one.device, over_seeds=median)
        for one, head in zip(trainings, heads, strict=True)
    ]
    rates = [rate for rate in RATES if rate.device in kinds]
    memory = Quantity("peak_memory", "peak", "MB", "peak_memory_bytes", "memory", in_unit=lambda size: size / 1e6)
    return (RECALL, *accuracies[:2], *fits, *rates, memory, *accuracies[2:])


def drop_accuracies(quantities: Sequence[Quantity]) -> tuple[Quantity, ...]:
    """Return the columns of a table of data without a ground truth: times, memory and costs."""
    return tuple(one for one in quantities if one.metric is None or one.metric.cost is not None)


def _list_more(metrics: Sequence[str]) -> list[Quantity]:
    return [_make_accuracy(name) for name in dict.fromkeys(metrics) if name != RECALL.name]

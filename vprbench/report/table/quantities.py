"""The quantities of Table II: which fact of the frame of runs each shows, in which unit and over the seeds."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from statistics import mean, median
from typing import Literal

from vprbench.metrics.catalogue import METRICS, Metric
from vprbench.report.plan import Row
from vprbench.report.selection import DEVICES, Device
from vprbench.report.table.best import Contestant, find_best_rate, find_best_recall, find_best_training
from vprbench.text import format_two_digits

TRAINING_TIME = (  # of the table, the page and the README
    "Wall time from the first reference image to the finished map, without waiting for images to be read or rendered; "
    "in brackets with waiting for them."
)

Kind = Literal[
    "accuracy",  # of the answers, on the device with the most seeds
    "training",  # the step that the paper times, quoted of networks that come trained
    "fit",  # of every row, whatever it does there
    "rate",
    "memory",
]


@dataclass(frozen=True)
class Quantity:
    """A column of the table: a fact of the frame of runs (`vprbench.runs.frame`), over the seeds of a row."""

    name: str  # in the CSV, and of what the paper printed
    head: str
    unit: str
    fact: str  # column of the frame of runs
    kind: Kind = "accuracy"
    device: Device | None = None  # whose runs it shows; None: those of the device with the most seeds
    in_unit: Callable[[float], float] = float
    over_seeds: Callable[[Sequence[float]], float] = mean
    text: Callable[[float], str] = format_two_digits
    total: str | None = None  # the fact that takes in the steps that `fact` leaves out
    best: Callable[[Sequence[Contestant]], str | None] = lambda rows: None  # the row that a test separates from all
    metric: Metric | None = None  # what it is of `METRICS`, but for R@1

    @property
    def heading(self) -> str:
        """The head of its column, with the unit."""
        return f"{self.head} {self.unit}".rstrip()

    @property
    def required(self) -> str | None:
        """The fact without which a run shows nothing; None: every run shows it, or that it is undefined."""
        return {"training": "fit_compute_seconds", "fit": "fit_compute_seconds", "rate": "streaming_total_hz"}.get(
            self.kind
        )

    def source(self, row: Row) -> Literal["measured", "quoted", "none"]:
        """Return where a row's number comes from; none: the row has no such step."""
        if self.kind != "training" or row.learns_here:
            return "measured"
        return "none" if row.training == "none" else "quoted"

    def contends(self, row: Row) -> bool:
        """Tell whether a row is compared with the others: what only builds a map trains nothing."""
        return self.kind != "training" or row.training != "map"


RECALL = Quantity(
    *("recall_at_1", "R@1", "%", "recall_at_1"),
    in_unit=METRICS["recall_at_1"].shown,
    text=METRICS["recall_at_1"].rounded_text,
    best=find_best_recall,
)


def _training(name: str, head: str, device: Device) -> Quantity:
    return Quantity(
        *(name, head, "min", "fit_compute_seconds", "training", device),
        in_unit=lambda seconds: seconds / 60,
        over_seeds=median,
        total="fit_seconds",
        best=find_best_training,
    )


def _rate(name: str, head: str, device: Device) -> Quantity:
    return Quantity(name, head, "Hz", "streaming_total_hz", "rate", device, best=find_best_rate)


TRAINING = (_training("train_cpu", "train CPU", "cpu"), _training("train_gpu", "train GPU", "cuda"))
RATES = (_rate("query_cpu", "query CPU", "cpu"), _rate("query_gpu", "query GPU", "cuda"))
#: Those of the paper, in its order.
QUANTITIES: tuple[Quantity, ...] = (RECALL, TRAINING[0], RATES[0], TRAINING[1], RATES[1])

_OF_COMPARISONS = ("recall_at_5", "auc_pr_a")


def quantities(metrics: Sequence[str], devices: Collection[Device] = DEVICES) -> tuple[Quantity, ...]:
    """Return the columns of a table: those of the paper, times on these devices, and `metrics` by their names."""
    return (*(one for one in QUANTITIES if one.device is None or one.device in devices), *_of_metrics(metrics))


def comparison_quantities(metrics: Sequence[str], devices: Sequence[str]) -> tuple[Quantity, ...]:
    """Return the columns of a comparison on some devices: accuracies, seconds of the fit, query rates and memory."""
    kinds: list[Device] = [kind for kind in DEVICES if any(device.startswith(kind) for device in devices)]
    usual = _of_metrics(_OF_COMPARISONS)
    more = _of_metrics([name for name in metrics if name not in _OF_COMPARISONS])
    words = {"cpu": "fit CPU", "cuda": "fit GPU"} if len(kinds) > 1 else dict.fromkeys(kinds, "fit")
    names = {"cpu": "train_cpu", "cuda": "train_gpu"}
    fits = [Quantity(names[k], words[k], "s", "fit_seconds", "fit", k, over_seeds=median) for k in kinds]
    rates = [rate for rate in RATES if rate.device in kinds]
    memory = Quantity("peak_memory", "peak", "MB", "peak_memory_bytes", "memory", in_unit=lambda size: size / 1e6)
    return (RECALL, *usual, *fits, *rates, memory, *more)


def without_accuracies(quantities: Sequence[Quantity]) -> tuple[Quantity, ...]:
    """Return the columns of a table of data without a ground truth: times, memory and costs."""
    costs = [one for one in quantities if one.metric is not None and one.metric.cost is not None]
    return tuple(one for one in quantities if one.kind != "accuracy" or one in costs)


def _of_metrics(names: Sequence[str]) -> list[Quantity]:
    more = [METRICS[name] for name in dict.fromkeys(names) if name != RECALL.name]
    return [
        Quantity(one.name, one.words, one.unit, one.name, in_unit=one.shown, text=one.rounded_text, metric=one)
        for one in more
    ]

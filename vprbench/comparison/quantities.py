"""The columns of a comparison: accuracies, seconds of the fit, query rates and memory."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import mean, median
from typing import Literal

from vprbench.metrics.registry import METRICS
from vprbench.paper.plan import Row
from vprbench.paper.selection import DEVICES, Device
from vprbench.paper.table.best import Contestant
from vprbench.paper.table.quantities import RATES, RECALL, Numbers, OfMetric, Quantity, Training
from vprbench.paper.table.reasons import Reason
from vprbench.runs.record import Run

_METRICS = ("recall_at_5", "auc_pr_a")


@dataclass(frozen=True)
class Fit(Training):
    """Wall seconds until queries can be answered, as in the row of one run, in no contest: median over the seeds."""

    def source(self, row: Row) -> Literal["measured"]:
        """Say that every row has such a step."""
        return "measured"

    def numbers(self, row: Row, runs: Sequence[Run]) -> Numbers:
        """Return the seconds, reading the images included."""
        values = [run.training_seconds for run in runs if run.training_seconds is not None]
        return Numbers(values, median(values))

    def best(self, rows: Sequence[Contestant]) -> str | None:
        """Name no row: some train, and some build a map alone."""
        return None

    def remarks(self, row: Row, runs: Sequence[Run]) -> Iterator[Reason]:
        """Yield what sets a fit apart, and not that it builds a map."""
        return (told for told in super().remarks(row, runs) if told.code != "map")


@dataclass(frozen=True)
class Memory(Quantity):
    """The peak memory of the process in MB: the mean over the seeds."""

    def numbers(self, row: Row, runs: Sequence[Run]) -> Numbers:
        """Return the megabytes of the runs."""
        values = [run.peak_memory_bytes / 1e6 for run in runs]
        return Numbers(values, mean(values))

    def disturbed(self, runs: Sequence[Run]) -> bool:
        """Say no: a busy machine takes no memory of a process."""
        return False

    def remarks(self, row: Row, runs: Sequence[Run]) -> Iterator[Reason]:
        """Yield nothing: notes stand with the accuracy."""
        return iter(())


def quantities(metrics: Sequence[str], devices: Sequence[str]) -> tuple[Quantity, ...]:
    """Return the columns of a comparison on some devices, with more `metrics` by their names."""
    kinds: list[Device] = [kind for kind in DEVICES if any(device.startswith(kind) for device in devices)]
    names = [name for name in dict.fromkeys((*_METRICS, *metrics)) if name != RECALL.name]
    of_metrics = [OfMetric(name, METRICS[name].words, METRICS[name].unit, metric=METRICS[name]) for name in names]
    words = {"cpu": "fit CPU", "cuda": "fit GPU"} if len(kinds) > 1 else dict.fromkeys(kinds, "fit")
    fits = [Fit(f"train_{'cpu' if kind == 'cpu' else 'gpu'}", words[kind], "s", kind) for kind in kinds]
    rates = [rate for rate in RATES if rate.device in kinds]
    return (RECALL, *of_metrics[:2], *fits, *rates, Memory("peak_memory", "peak", "MB"), *of_metrics[2:])

"""The runs of one row on maps of different sizes, as times against the number of places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from vprbench.errors import BadInput
from vprbench.report.plan import Row
from vprbench.report.selection import age, as_text, conditions
from vprbench.report.table import best
from vprbench.runs.frame import tabulate_with_records
from vprbench.runs.record import Run

_PER_SIZE = frozenset(  # parts of the protocol in which runs of one growth differ
    {"places", "query_places", "first_query_place", "reference_places", "held_out_places"}
)
_TIMES = ("query_seconds", "query_low", "query_high")


@dataclass(frozen=True)
class GrowthSamples:
    """Times of one row by number of places, all measured under the same conditions."""

    name: str  # the row's
    table: pd.DataFrame  # the frame of its runs, ascending by places and seed, with `record` and the times of a query:
    # seconds of encode and match together, their median and its 95 % interval; None: not timed, under six laps
    n_aside: int  # stored runs that are not among them, of other code or conditions

    @property
    def runs(self) -> tuple[Run, ...]:
        """The runs behind the samples."""
        return tuple(self.table["record"])


def samples(row: Row, runs: Sequence[Run]) -> GrowthSamples:
    """Collect the times of one row on one dataset, whose runs differ in their places and seeds.

    Times compare by one code under the same arguments, on one machine and under one protocol alone: the set of runs
    with the newest one is taken, of each size and seed its newest run, and the others are counted.

    Raises:
        BadInput: There are no runs.
    """
    if not runs:
        raise BadInput(f"no run of {row.name} is stored at different numbers of places: nothing shows its growth")
    sets: dict[str, list[Run]] = {}
    for run in sorted(runs, key=age, reverse=True):
        sets.setdefault(as_text(_conditions(run)), []).append(run)
    newest, *others = sets.values()
    chosen: dict[tuple[int, int], Run] = {}
    for run in newest:
        chosen.setdefault((run.outcome.n_places, run.config["seed"]), run)
    kept = [run for _, run in sorted(chosen.items(), key=lambda item: item[0])]
    times = pd.DataFrame(list(map(_query_times, kept)), columns=[*_TIMES], dtype=object)
    return GrowthSamples(row.name, tabulate_with_records(kept).join(times), sum(map(len, others)))


def interval_of_median(values: npt.NDArray[np.float64]) -> tuple[float, float] | None:
    """Return the 95 % interval of the median of `values` (n,) from their order; None for fewer than six.

    With k the largest number for which Binomial(n, 1/2) lies below k with a chance of at most 2.5 %, it runs from the
    k-th lowest to the k-th highest value. It assumes nothing about the distribution, only independent values.
    """
    from scipy.stats import binom  # takes long to import

    k = int(binom.ppf(0.025, len(values), 0.5))
    ordered = np.sort(values)
    return (float(ordered[k - 1]), float(ordered[-k])) if k else None


def _query_times(run: Run) -> tuple[float | None, ...]:
    if run.timing is None:
        return (None, None, None)
    seconds = best.list_laps(run)
    return (float(np.median(seconds)), *(interval_of_median(seconds) or (None, None)))


def _conditions(run: Run) -> dict[str, Any]:
    """Return the conditions that must be equal for times to compare."""
    protocol = {name: value for name, value in run.protocol.items() if name not in _PER_SIZE}
    return {
        **conditions(run),
        "timing": run.config.get("timing"),
        "dataset": [run.dataset, protocol],
        "device": run.config["device"],
    }

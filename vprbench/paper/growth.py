"""The runs of one row on maps of different sizes, as times against the number of places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.errors import BadInput
from vprbench.paper.plan import Row
from vprbench.paper.selection import age, as_text, conditions
from vprbench.paper.table import best
from vprbench.runs.record import Run

_PER_SIZE = frozenset(  # parts of the protocol in which runs of one growth differ
    {"places", "query_places", "first_query_place", "reference_places", "held_out_places"}
)


@dataclass(frozen=True)
class Sample:
    """One time at one number of places."""

    n_places: int
    seconds: float
    low: float | None = None  # 95 % interval of a median; None for a single measurement and for under six laps
    high: float | None = None
    disturbed: bool = False  # the machine did other things meanwhile, or the laps were too few


@dataclass(frozen=True)
class GrowthSamples:
    """Times of one row by number of places, ascending, all measured under the same conditions."""

    name: str  # the row's
    runs: tuple[Run, ...]  # those behind the samples: one a size and seed
    training: tuple[Sample, ...]  # one a run that trained, without the time that it waited for images
    query: tuple[Sample, ...]  # one image at a time, encode and match together: median
    aside: tuple[str, ...]  # sentences: which runs are not among them, and why


def samples(row: Row, runs: Sequence[Run]) -> GrowthSamples:
    """Collect the times of one row on one dataset, whose runs differ in their places and seeds.

    Times compare by one code under the same arguments, on one machine and under one protocol alone: the set of runs
    with the newest one is taken, of each size and seed its newest run, and the others are named in `aside`. Raises
    BadInput for no runs.
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
    kept = tuple(run for _, run in sorted(chosen.items(), key=lambda item: item[0]))
    trained = [(run, run.training_compute_seconds) for run in kept if run.training_compute_seconds is not None]
    return GrowthSamples(
        name=row.name,
        runs=kept,
        training=tuple(
            Sample(run.outcome.n_places, seconds, disturbed=best.disturbed(run)) for run, seconds in trained
        ),
        query=tuple(_median(run) for run in kept if run.timing is not None),
        aside=tuple(_set_aside(row.name, members, newest[0]) for members in others),
    )


def interval_of_median(values: npt.NDArray[np.float64]) -> tuple[float, float] | None:
    """Return the 95 % interval of the median of `values` (n,) from their order; None for fewer than six.

    With k the largest number for which Binomial(n, 1/2) lies below k with a chance of at most 2.5 %, it runs from the
    k-th lowest to the k-th highest value. It assumes nothing about the distribution, only independent values.
    """
    from scipy.stats import binom  # takes long to import

    k = int(binom.ppf(0.025, len(values), 0.5))
    ordered = np.sort(values)
    return (float(ordered[k - 1]), float(ordered[-k])) if k else None


def _median(run: Run) -> Sample:
    seconds = best.laps(run)
    low, high = interval_of_median(seconds) or (None, None)
    return Sample(run.outcome.n_places, float(np.median(seconds)), low, high, best.disturbed(run))


def _conditions(run: Run) -> dict[str, Any]:
    """Return the conditions that must be equal for times to compare, keyed by the word for a difference."""
    protocol = {name: value for name, value in run.protocol.items() if name not in _PER_SIZE}
    return {**conditions(run), "dataset": [run.dataset, protocol], "device": run.config["device"]}


def _set_aside(name: str, members: Sequence[Run], chosen: Run) -> str:
    ours, wanted = _conditions(members[0]), _conditions(chosen)
    different = ", ".join(part for part in wanted if ours[part] != wanted[part])
    sizes = ", ".join(f"{size:,}" for size in sorted({run.outcome.n_places for run in members}))
    return f"Set aside: runs of {name} at {sizes} places (other {different})."

"""The runs of one row on maps of different sizes, as times against the number of places."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.interface import BadInput
from vprbench.plan import Boundary, Row
from vprbench.records import Run


@dataclass(frozen=True)
class Sample:
    """One time at one number of places."""

    n_places: int
    seconds: float
    low: float | None = None  # 95 % interval of a median; None for a single measurement and for under six laps
    high: float | None = None


@dataclass(frozen=True)
class GrowthSamples:
    """Times of one row by number of places, ascending, all measured under the same conditions."""

    name: str  # the row's
    boundary: Boundary  # what `query` covers
    runs: tuple[Run, ...]  # those behind the samples: one a size and seed
    training: tuple[Sample, ...]  # one a run that trained
    query: tuple[Sample, ...]  # one image at a time, at the row's boundary: median
    total: tuple[Sample, ...]  # encode and match
    aside: tuple[str, ...]  # sentences: which runs are not among them, and why


def samples(row: Row, runs: Sequence[Run]) -> GrowthSamples:
    """Collect the times of one row on one dataset, whose runs differ in their places and seeds.

    Times compare on one machine, by one code and under one timing protocol alone: the set of runs with the newest one
    is taken, of each size and seed its newest run, and the others are named in `aside`. Raises BadInput for no runs.
    """
    if not runs:
        raise BadInput(f"no run of {row.name} is stored at different numbers of places: nothing shows its growth")
    sets: dict[str, list[Run]] = {}
    for run in sorted(runs, key=_age, reverse=True):
        sets.setdefault(json.dumps(_conditions(run), sort_keys=True), []).append(run)
    newest, *others = sets.values()
    chosen: dict[tuple[int, int], Run] = {}
    for run in newest:
        chosen.setdefault((run.outcome.n_places, run.config["seed"]), run)
    kept = tuple(run for _, run in sorted(chosen.items(), key=lambda item: item[0]))
    return GrowthSamples(
        name=row.name,
        boundary=row.boundary,
        runs=kept,
        training=tuple(Sample(run.outcome.n_places, run.fit_seconds) for run in kept if run.fit_seconds is not None),
        query=tuple(_median(run, _laps(run, row.boundary)) for run in kept),
        total=tuple(_median(run, run.timing.streaming.total_seconds) for run in kept),
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


def _laps(run: Run, boundary: Boundary) -> npt.NDArray[np.float64]:
    streaming = run.timing.streaming
    return streaming.match_seconds if boundary == "match" else streaming.encode_seconds


def _median(run: Run, seconds: npt.NDArray[np.float64]) -> Sample:
    low, high = interval_of_median(seconds) or (None, None)
    return Sample(run.outcome.n_places, float(np.median(seconds)), low, high)


def _age(run: Run) -> tuple[str, str]:
    return str(run.environment.get("time_utc") or ""), run.key


def _conditions(run: Run) -> dict[str, Any]:
    """Return what has to be the same for times to compare, by what it is called where it differs."""
    surroundings = run.environment
    return {
        "code": run.config.get("code"),
        "timing protocol": run.config.get("timing"),
        "libraries": surroundings.get("libraries"),
        "threads": surroundings.get("threads"),
        "device": run.config["device"],
        "machine": [surroundings.get(name) for name in ("processor", "cores", "accelerator")],
    }


def _set_aside(name: str, members: Sequence[Run], chosen: Run) -> str:
    ours, wanted = _conditions(members[0]), _conditions(chosen)
    different = ", ".join(part for part in wanted if ours[part] != wanted[part])
    sizes = ", ".join(f"{size:,}" for size in sorted({run.outcome.n_places for run in members}))
    return f"Set aside: runs of {name} at {sizes} places under another {different}."

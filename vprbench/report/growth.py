"""The runs of one row on maps of different sizes, as times against the number of places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pandas as pd

from vprbench.errors import BadInput
from vprbench.report.plan import Row
from vprbench.report.selection import format_plain_values, get_sort_key, list_conditions
from vprbench.report.table.best import list_laps
from vprbench.runs.frame import tabulate_with_records
from vprbench.runs.record import Run

_PER_SIZE = {"places", "query_places", "first_query_place", "reference_places", "held_out_places"}  # of a protocol


@dataclass(frozen=True)
class GrowthSamples:
    """Times of one row by number of places, all measured under the same conditions."""

    name: str  # the row's
    table: pd.DataFrame  # the frame of its runs, ascending by places and seed, with `record` and the times of a query:
    # `query_seconds`, `query_low`, `query_high`, encode and match together, their median and its 95 % interval
    n_aside: int  # stored runs that are not among them, of other code or conditions

    @property
    def runs(self) -> tuple[Run, ...]:
        """The runs behind the samples."""
        return tuple(self.table["record"])


def collect_growth_samples(row: Row, runs: Sequence[Run]) -> GrowthSamples:
    """Collect the times of one row on one dataset, whose runs differ in their places and seeds.

    The newest run decides code, arguments, machine and protocol: of each size and seed the newest run that has these is
    taken. All others of these conditions are left out, those of other conditions counted. Raises BadInput for no runs.
    """
    if not runs:
        raise BadInput(f"no run of {row.name} is stored at different numbers of places: nothing shows its growth")
    ordered = sorted(runs, key=get_sort_key)
    alike = [run for run in ordered if _format_conditions(run) == _format_conditions(ordered[-1])]
    chosen = {(run.outcome.n_places, run.config["seed"]): run for run in alike}
    kept = [run for _, run in sorted(chosen.items(), key=lambda item: item[0])]
    times = pd.DataFrame(map(_list_times, kept), columns=["query_seconds", "query_low", "query_high"], dtype=object)
    return GrowthSamples(row.name, tabulate_with_records(kept).join(times), len(runs) - len(alike))


def compute_median_interval(values: npt.NDArray[np.float64]) -> tuple[float, float] | None:
    """Return the 95 % interval of the median of `values` (n,) from their order; None for fewer than six.

    With k the largest number for which Binomial(n, 1/2) lies below k with a chance of at most 2.5 %, it runs from the
    k-th lowest to the k-th highest value. It assumes nothing about the distribution, only independent values.
    """
    from scipy.stats import binom  # takes long to import

    k = int(binom.ppf(0.025, len(values), 0.5))
    ordered = np.sort(values)
    return (float(ordered[k - 1]), float(ordered[-k])) if k else None


def _list_times(run: Run) -> tuple[float | None, ...]:
    if run.timing is None:
        return (None, None, None)
    return (float(np.median(list_laps(run))), *(compute_median_interval(list_laps(run)) or (None, None)))


def _format_conditions(run: Run) -> str:
    """Return the conditions that must be equal for times to compare, as text."""
    protocol = {name: value for name, value in run.protocol.items() if name not in _PER_SIZE}
    return format_plain_values(
        [list_conditions(run), run.config.get("timing"), run.config["device"], run.dataset, protocol]
    )

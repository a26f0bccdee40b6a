"""Intervals of R@1, and of every metric with a value per query, over stored runs in the order of the journey."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from vprbench.metrics.accuracy import Ties
from vprbench.metrics.catalogue import METRICS, Metric
from vprbench.metrics.intervals import Values, WiderInterval, difference_interval, share_interval
from vprbench.runs.record import Run
from vprbench.runs.views import get_window_length

METHOD = (
    "the wider one of Wilson's, which takes queries as independent, and that of a bootstrap of blocks of neighbouring "
    "queries, as long as the automatic rule of Politis and White finds them alike"
)


def estimate_recall_interval(runs: Sequence[Run], confidence: float = 0.95) -> WiderInterval | None:
    """Return the interval of R@1 over all queries, 0 to 1; of several seeds, of the mean hits over them.

    None if no query has a right place. At least one run, all of the same queries.
    """
    return estimate_interval(runs, METRICS["recall_at_1"], confidence)


def estimate_recall_difference(first: Run, second: Run, confidence: float = 0.95) -> WiderInterval | None:
    """Return the interval of R@1 of one run less that of another on the same queries, -1 to 1.

    Ties are broken against the first and in favour of the second.
    """
    ours, theirs = list_hits(first, "pessimistic"), list_hits(second, "optimistic")
    return difference_interval(ours, theirs, confidence, get_window_length(first))


def estimate_interval(runs: Sequence[Run], metric: Metric, confidence: float = 0.95) -> WiderInterval | None:
    """Return the interval of a metric over all queries, 0 to 1; of several seeds, of their mean values.

    None if the metric has no value per query, or is undefined. At least one run, all of the same queries.
    """
    if metric.per_query is None or metric.of(runs[0]) is None:
        return None
    values = np.mean([list_values(run, metric) for run in runs], axis=0)
    return share_interval(values, confidence, get_window_length(runs[0]))


def list_hits(run: Run, ties: Ties = "expected") -> Values:
    """Return the chance of each query that its best place is right, (n_queries,), in the order of the journey."""
    return list_values(run, METRICS["recall_at_1"], ties)


def list_values(run: Run, metric: Metric, ties: Ties = "expected") -> Values:
    """Return the value of a metric for each query, (n_queries,), in the order of the journey.

    Raises what `Metric.list_values` raises.
    """
    return metric.list_values(run, ties)[order_along_journey(run)]


def order_along_journey(run: Run) -> npt.NDArray[np.int64]:
    """Return the queries in the order of the places that they show, (n_queries,); equals stay in their order.

    The place of a query is its first right one. A query without any stays behind the query before it.
    """
    numbers = np.arange(run.outcome.n_places) if run.place_numbers is None else run.place_numbers
    first = np.array([numbers[right].min() if len(right) else -1 for right in run.positives], np.int64)
    known = np.maximum.accumulate(np.where(first >= 0, np.arange(len(first)), -1))
    places = np.where(known >= 0, first[known], -1)
    return np.argsort(places, kind="stable")

"""How far R@1 of stored runs can be trusted: the intervals of their hits, in the order of the journey."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from vprbench.metrics.accuracy import Ties, hits_at
from vprbench.metrics.intervals import Values, WiderInterval, difference_interval, share_interval
from vprbench.runs.record import Run
from vprbench.runs.views import window_of

METHOD = (
    "the wider one of Wilson's, which takes queries as independent, and that of a bootstrap of blocks of neighbouring "
    "queries, as long as the automatic rule of Politis and White finds them alike"
)


def recall_interval(runs: Sequence[Run], confidence: float = 0.95) -> WiderInterval | None:
    """Return the interval of R@1 over all queries, 0 to 1; of several seeds, of the mean hits over them.

    None if no query has a right place. At least one run, all of the same queries.
    """
    if not runs[0].outcome.answerable.any():
        return None
    hits = np.mean([hits_at(run.outcome, 1) for run in runs], axis=0)
    return share_interval(hits[order_along_journey(runs[0])], confidence, window_of(runs[0]))


def difference_of_recalls(first: Run, second: Run, confidence: float = 0.95) -> WiderInterval | None:
    """Return the interval of R@1 of one run less that of another on the same queries, -1 to 1.

    Ties are broken against the first and in favour of the second.
    """
    order = order_along_journey(first)

    def hits(run: Run, ties: Ties) -> Values:
        return hits_at(run.outcome, 1, ties)[order]

    return difference_interval(hits(first, "pessimistic"), hits(second, "optimistic"), confidence, window_of(first))


def order_along_journey(run: Run) -> npt.NDArray[np.int64]:
    """Return the queries in the order of the places that they show, (n_queries,); equals stay in their order.

    The place of a query is its first right one. A query without any stays behind the query before it.
    """
    numbers = np.arange(run.outcome.n_places) if run.place_numbers is None else run.place_numbers
    first = np.array([numbers[right].min() if len(right) else -1 for right in run.positives], np.int64)
    known = np.maximum.accumulate(np.where(first >= 0, np.arange(len(first)), -1))
    places = np.where(known >= 0, first[known], -1)
    return np.argsort(places, kind="stable")

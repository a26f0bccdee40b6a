"""Rows of one dataset from the best to the worst, and what tests say of the first ones in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import mean, median
from typing import Any

import numpy as np
import pandas as pd

from vprbench.metrics.accuracy import hits_at
from vprbench.metrics.intervals import WiderInterval, difference_interval
from vprbench.paper.selection import Series
from vprbench.paper.table.best import (
    FASTER,
    Contestant,
    best_rate,
    best_recall,
    disturbed,
    mean_recall,
    rate,
)
from vprbench.paper.table.quantities import RATES
from vprbench.paper.templates import sentences
from vprbench.runs.frame import named_tuples
from vprbench.runs.recall_intervals import along_the_journey, recall_interval
from vprbench.runs.record import Run
from vprbench.runs.tuned import draws, others_of, tuned_here
from vprbench.runs.views import window_of

#: The columns of a ranking; numbers are of all seeds of a row, and None where there is none.
NUMBERS = (
    *("recall_at_1", "low", "high"),  # mean, 0 to 1, and its 95 % interval; None: no query has a right place
    *("elsewhere", "elsewhere_low", "elsewhere_high"),  # on the other queries, where some show what it was tuned on
    "hz",  # queries per second, encode and match together; None: not timed
    "fit_seconds",  # median, reading the images included; None: nothing was fitted
)


@dataclass(frozen=True)
class Ranking:
    """Rows of one dataset, the best first, and what a test says of them."""

    table: pd.DataFrame  # a line a row: `method`, `NUMBERS`, `seeds` and `runs`, one a seed
    sentences: tuple[str, ...]  # the first is about the best row


def ranked(series: Sequence[Series]) -> Ranking:
    """Rank rows that answered the same queries by R@1, those of equal R@1 as they came, and say what tests separate.

    A row that was tuned on these places is ranked, and in no contest.
    """
    lines = [{"method": one.name, **_numbers(one.runs), "seeds": len(one.runs), "runs": one.runs} for one in series]
    lines.sort(key=lambda line: -1.0 if line["recall_at_1"] is None else line["recall_at_1"], reverse=True)
    table = pd.DataFrame(lines, columns=["method", *NUMBERS, "seeds", "runs"], dtype=object)
    rows = [*named_tuples(table)]
    tuned = [row.method for row in rows if any(map(tuned_here, row.runs))]
    one_seed = [row.method for row in rows if len(row.runs) == 1 and draws(row.runs[0])]
    told = _ranking_sentences([row for row in rows if row.method not in tuned], tuned)
    return Ranking(table, (*told, *sentences("ranking.j2", "of_one_seed", one_seed)))


def _tuned_elsewhere(rows: Sequence[Any]) -> str:
    """Return the dataset whose places the first row was tuned on, as far as is known none of these; empty if none."""
    return str(rows[0].runs[0].tuned_on.get("dataset", "")) if rows else ""


def _numbers(runs: Sequence[Run]) -> dict[str, Any]:
    others = others_of(runs)
    elsewhere = _accuracy(others) if others else (None, None, None)
    timed = all(run.timing is not None for run in runs)
    fits = [run.fit_seconds for run in runs if run.fit_seconds is not None]
    hz = mean(rate(run) for run in runs) if timed else None
    return dict(zip(NUMBERS, (*_accuracy(runs), *elsewhere, hz, median(fits) if fits else None), strict=True))


def _accuracy(runs: Sequence[Run]) -> tuple[float | None, float | None, float | None]:
    interval = recall_interval(runs)
    return (mean_recall(runs), *((None, None) if interval is None else (interval.low, interval.high)))


def _ranking_sentences(rows: Sequence[Any], tuned: Sequence[str]) -> list[str]:
    contest = [Contestant(row.method, row.runs, True) for row in rows]
    timed = [one for one, row in zip(contest, rows, strict=True) if row.hz is not None]
    of_first = best_rate(timed[:2]) if timed[:2] == contest[:2] else None
    found = best_recall(contest), _difference(rows), of_first or _about_faster(rows[:2]), best_rate(timed)
    elsewhere = _tuned_elsewhere(rows)
    return sentences("ranking.j2", "told", rows, *found, tuned, elsewhere, times=RATES[0].text, about=of_first is None)


def _about_faster(rows: Sequence[Any]) -> str | None:
    """Return which of two rows is faster where a busy machine alone keeps a test from saying so."""
    rates = sorted((row.hz or 0.0, row.method) for row in rows)
    busy = any(map(disturbed, (run for row in rows for run in row.runs)))
    return rates[1][1] if len(rates) == 2 and busy and rates[1][0] > FASTER * rates[0][0] > 0 else None


def _difference(rows: Sequence[Any]) -> WiderInterval | None:
    """Return the interval of the first row's R@1 less the second's, of several seeds of their mean hits."""
    if len(rows) < 2 or rows[1].recall_at_1 is None:
        return None
    order = along_the_journey(rows[0].runs[0])
    ours, theirs = (np.mean([hits_at(run.outcome, 1) for run in row.runs], axis=0)[order] for row in rows[:2])
    return difference_interval(ours, theirs, window=window_of(rows[0].runs[0]))

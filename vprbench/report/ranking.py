"""Rows of one dataset from the best to the worst, and the results of tests on the first ones in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import mean, median
from typing import Any

import numpy as np
import pandas as pd

from vprbench.metrics.intervals import difference_interval
from vprbench.report.selection import MethodRuns
from vprbench.report.table.best import average_recall, compute_rate, find_best_rate
from vprbench.report.table.quantities import RATES, RECALL
from vprbench.runs.frame import iterate_rows
from vprbench.runs.recall_intervals import estimate_recall_interval, list_hits
from vprbench.runs.record import Run
from vprbench.runs.tuned import all_without_tuning_places, draws_at_random, overlaps_tuning_places
from vprbench.runs.views import get_window_length
from vprbench.text import format_interval, format_percent

#: The columns of a ranking; numbers are of all seeds of a row, and None where there is none.
NUMBERS = (
    *("recall_at_1", "low", "high"),  # mean, 0 to 1, and its 95 % interval; None: no query has a right place
    *("elsewhere", "elsewhere_low", "elsewhere_high"),  # the same on places that the row was not tuned on
    "hz",  # queries per second, encode and match together; None: not timed
    "fit_seconds",  # median, reading the images included; None: nothing was fitted
)


@dataclass(frozen=True)
class Ranking:
    """Rows of one dataset, the best first, and the results of tests on them."""

    table: pd.DataFrame  # a line a row: `method`, `NUMBERS`, `seeds` and `runs`, one a seed
    sentences: tuple[str, ...]  # the first is about the best row


def rank_rows(series: Sequence[MethodRuns]) -> Ranking:
    """Rank rows that answered the same queries by R@1, equal ones in their order, and test their differences.

    A row that was tuned on these places is ranked, and in no contest.
    """
    lines = [
        {"method": one.name, **_list_numbers(one.runs), "seeds": len(one.runs), "runs": one.runs} for one in series
    ]
    lines.sort(key=lambda line: -1.0 if line["recall_at_1"] is None else line["recall_at_1"], reverse=True)
    table = pd.DataFrame(lines, columns=["method", *NUMBERS, "seeds", "runs"], dtype=object)
    rows = [*iterate_rows(table)]
    tuned = [row.method for row in rows if any(map(overlaps_tuning_places, row.runs))]
    one_seed = [row.method for row in rows if len(row.runs) == 1 and draws_at_random(row.runs[0])]
    sentences = _describe_first([row for row in rows if row.method not in tuned])
    if tuned:
        sentences.append(f"Tuned on these places, in no contest: {', '.join(tuned)}.")
    if one_seed:
        names = ", ".join(one_seed)
        sentences.append(f"Ran with one seed and draw at random: {names}; seeds=3 measures how far seeds differ.")
    return Ranking(table, tuple(sentences))


def _list_numbers(runs: Sequence[Run]) -> dict[str, Any]:
    others = all_without_tuning_places(runs)
    elsewhere = _estimate_recall(others) if others else (None, None, None)
    fits = [run.fit_seconds for run in runs if run.fit_seconds is not None]
    hz = mean(map(compute_rate, runs)) if all(run.timing is not None for run in runs) else None
    return dict(zip(NUMBERS, (*_estimate_recall(runs), *elsewhere, hz, median(fits) if fits else None), strict=True))


def _estimate_recall(runs: Sequence[Run]) -> tuple[float | None, float | None, float | None]:
    interval = estimate_recall_interval(runs)
    return (average_recall(runs), *((None, None) if interval is None else (interval.low, interval.high)))


def _describe_first(rows: Sequence[Any]) -> list[str]:
    """Return the results of tests on the best and on the fastest row; `rows` are those in the contest, best first."""
    if not rows:
        return []
    first = rows[0]
    if first.recall_at_1 is None:
        judged = first.runs[0].is_judged
        return [f"{'No query has a right place' if judged else 'There is no ground truth'}: nothing is ranked."]
    tuned_on = first.runs[0].tuned_on.get("dataset")  # of other places
    name = f"{first.method} (tuned on {tuned_on})" if tuned_on else first.method
    percent = f"{format_percent(first.recall_at_1)} %"
    if len(rows) == 1:
        return [f"{name} finds {percent}."]
    contest = [MethodRuns(row.method, row.runs) for row in rows]
    is_best = RECALL.best(contest) is not None
    verdict = f"is best: {percent}," if is_best else f"leads with {percent}, but no test separates it from all others:"
    sentences = [f"{name} {verdict} {_describe_difference(first, rows[1])}."]
    fastest = find_best_rate([one for one, row in zip(contest, rows, strict=True) if row.hz is not None])
    if fastest is not None:
        hz = next(row.hz for row in rows if row.method == fastest)
        sentences.append(f"{fastest} is fastest: {RATES[0].text(hz)} queries a second.")
    return sentences


def _describe_difference(first: Any, second: Any) -> str:
    """Return by how much one row is above the other, with the interval of their R@1, of several seeds of the mean."""
    points = first.recall_at_1 - second.recall_at_1
    ours, theirs = (np.mean([list_hits(run) for run in row.runs], axis=0) for row in (first, second))
    interval = difference_interval(ours, theirs, window=get_window_length(first.runs[0]))
    ends = "" if interval is None else f" {format_interval(interval.low, interval.high)}"
    return f"{f'{format_percent(points)} points above' if points else 'level with'} {second.method}{ends}"

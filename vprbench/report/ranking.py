"""Rows of one dataset from the best to the worst, and the results of tests on the first ones in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import mean, median
from typing import Any

import numpy as np
import pandas as pd

from vprbench.metrics.accuracy import hits_at
from vprbench.metrics.intervals import WiderInterval, difference_interval
from vprbench.report.selection import Series
from vprbench.report.table.best import Contestant, average_recall, compute_rate, find_best_rate, find_best_recall
from vprbench.report.table.quantities import RATES
from vprbench.runs.frame import iterate_rows
from vprbench.runs.recall_intervals import order_along_journey, recall_interval
from vprbench.runs.record import Run
from vprbench.runs.tuned import all_without_tuning_places, draws_at_random, overlaps_tuning_places
from vprbench.runs.views import window_of
from vprbench.text import format_interval, format_percent

#: The columns of a ranking; numbers are of all seeds of a row, and None where there is none.
NUMBERS = (
    *("recall_at_1", "low", "high"),  # mean, 0 to 1, and its 95 % interval; None: no query has a right place
    *(
        "elsewhere",
        "elsewhere_low",
        "elsewhere_high",
    ),  # on the other queries, where some show places that it was tuned on
    "hz",  # queries per second, encode and match together; None: not timed
    "fit_seconds",  # median, reading the images included; None: nothing was fitted
)


@dataclass(frozen=True)
class Ranking:
    """Rows of one dataset, the best first, and the results of tests on them."""

    table: pd.DataFrame  # a line a row: `method`, `NUMBERS`, `seeds` and `runs`, one a seed
    sentences: tuple[str, ...]  # the first is about the best row


def rank_rows(series: Sequence[Series]) -> Ranking:
    """Rank rows that answered the same queries by R@1, equal ones in their order, and test their differences.

    A row that was tuned on these places is ranked, and in no contest.
    """
    lines = [{"method": one.name, **_numbers(one.runs), "seeds": len(one.runs), "runs": one.runs} for one in series]
    lines.sort(key=lambda line: -1.0 if line["recall_at_1"] is None else line["recall_at_1"], reverse=True)
    table = pd.DataFrame(lines, columns=["method", *NUMBERS, "seeds", "runs"], dtype=object)
    rows = [*iterate_rows(table)]
    tuned = [row.method for row in rows if any(map(overlaps_tuning_places, row.runs))]
    one_seed = [row.method for row in rows if len(row.runs) == 1 and draws_at_random(row.runs[0])]
    sentences = (
        *_describe_first([row for row in rows if row.method not in tuned]),
        f"Tuned on these places, in no contest: {', '.join(tuned)}." if tuned else "",
        f"Ran with one seed and draw at random: {', '.join(one_seed)}; seeds=3 measures how far seeds differ."
        if one_seed
        else "",
    )
    return Ranking(table, tuple(filter(None, sentences)))


def _numbers(runs: Sequence[Run]) -> dict[str, Any]:
    others = all_without_tuning_places(runs)
    elsewhere = _accuracy(others) if others else (None, None, None)
    timed = all(run.timing is not None for run in runs)
    fits = [run.fit_seconds for run in runs if run.fit_seconds is not None]
    hz = mean(compute_rate(run) for run in runs) if timed else None
    return dict(zip(NUMBERS, (*_accuracy(runs), *elsewhere, hz, median(fits) if fits else None), strict=True))


def _accuracy(runs: Sequence[Run]) -> tuple[float | None, float | None, float | None]:
    interval = recall_interval(runs)
    return (average_recall(runs), *((None, None) if interval is None else (interval.low, interval.high)))


def _describe_first(rows: Sequence[Any]) -> list[str]:
    """Return the results of tests on the best and on the fastest row; `rows` are those in the contest, best first."""
    if not rows:
        return []
    first = rows[0]
    if not first.runs[0].is_judged:
        return ["There is no ground truth: nothing is ranked by accuracy."]
    if first.recall_at_1 is None:
        return ["No query has a right place: nothing is ranked."]
    contest = [Contestant(row.method, row.runs, True) for row in rows]
    tuned_on = first.runs[0].tuned_on.get("dataset")  # of other places
    name = f"{first.method} (tuned on {tuned_on})" if tuned_on else first.method
    if len(rows) == 1:
        return [f"{name} finds {format_percent(first.recall_at_1)} %."]
    verdict = "is best:" if find_best_recall(contest) else "leads with"
    doubt = "" if find_best_recall(contest) else "but no test separates it from all others: "
    sentence = f"{name} {verdict} {format_percent(first.recall_at_1)} %, {doubt}{_describe_difference(rows)}."
    fastest = find_best_rate([one for one, row in zip(contest, rows, strict=True) if row.hz is not None])
    rates = {row.method: row.hz for row in rows}
    if fastest is None:
        return [sentence]
    times = "" if fastest == first.method else f", {RATES[0].text(rates[fastest] / first.hz)} times {first.method}'s"
    return [sentence, f"{fastest} is fastest: {RATES[0].text(rates[fastest])} queries a second{times}."]


def _describe_difference(rows: Sequence[Any]) -> str:
    """Return by how much the first row is above the second, with the interval."""
    first, second = rows[:2]
    points = first.recall_at_1 - second.recall_at_1
    interval = _estimate_difference(rows)
    ends = "" if interval is None else f" {format_interval(interval.low, interval.high)}"
    return f"{f'{format_percent(points)} points above' if points else 'level with'} {second.method}{ends}"


def _estimate_difference(rows: Sequence[Any]) -> WiderInterval | None:
    """Return the interval of the first row's R@1 less the second's, of several seeds of their mean hits."""
    order = order_along_journey(rows[0].runs[0])
    ours, theirs = (np.mean([hits_at(run.outcome, 1) for run in row.runs], axis=0)[order] for row in rows[:2])
    return difference_interval(ours, theirs, window=window_of(rows[0].runs[0]))

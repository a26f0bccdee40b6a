"""The best row of a column: bold marks a difference that a paired test confirms on an undisturbed machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np

from vprbench.metrics.catalogue import METRICS, Metric
from vprbench.metrics.intervals import difference_interval, mcnemar_exact
from vprbench.report.selection import MethodRuns
from vprbench.runs.machine import Machine
from vprbench.runs.notes import DISTURBED
from vprbench.runs.recall_intervals import list_values
from vprbench.runs.record import Run
from vprbench.runs.stopwatch import Seconds
from vprbench.runs.views import get_window_length

CHANCE = 0.05  # of any false difference in an accuracy among all comparisons of a column
RATE_CHANCE = 0.01
FASTER = 1.25  # times the rate: less is within the variation of machines


def find_most_accurate(rows: Sequence[MethodRuns], metric: Metric) -> str | None:
    """Return the row with the best mean of a metric per query if a paired test separates it from every other row.

    For every pair of seeds the exact McNemar test gives p < 0.05 / number of other rows, and the interval of the
    difference at that level (`intervals.difference_interval`) lies above 0. Ties are broken against the best row and in
    favour of the other one. All runs answer the same queries; a row without a right place is in no contest.
    """
    means = {row.name: average_seeds(row.runs, metric) for row in rows}
    known = {name: mean if metric.higher_is_better else -mean for name, mean in means.items() if mean is not None}
    rows = [row for row in rows if row.name in known]
    chance = CHANCE / max(1, len(rows) - 1)
    return _find_winner(rows, lambda row: known[row.name], lambda one, other: _is_better(one, other, metric, chance))


def find_best_rate(rows: Sequence[MethodRuns]) -> str | None:
    """Return the row with the highest query rate if the laps separate it from every other row, else None.

    All rows ran undisturbed on one machine and were timed alike. For every pair of seeds it is at least 1.25 times as
    fast, and the Mann-Whitney U test of the streaming laps, encode and match together, gives p < 0.01. A row with a run
    that gave other answers when it was timed may be beaten but cannot win.
    """
    if not _are_comparable(rows):
        return None
    best = _find_winner(rows, lambda row: float(np.mean([compute_rate(run) for run in row.runs])), _is_faster)
    doubted = {row.name for row in rows for run in row.runs for note in run.notes if note.kind == "answers"}
    return None if best in doubted else best


def average_seeds(runs: Sequence[Run], metric: Metric) -> float | None:
    """Return the mean of a metric over the seeds; None if it is undefined."""
    values = [value for run in runs if (value := metric.of(run)) is not None]
    return float(np.mean(values)) if values else None


def average_recall(runs: Sequence[Run]) -> float | None:
    """Return the mean R@1 over the seeds, 0 to 1, expected under ties; None if no query has a right place."""
    return average_seeds(runs, METRICS["recall_at_1"])


def list_laps(run: Run) -> Seconds:
    """Return the seconds of the streaming laps, encode and match together; raises ValueError for an untimed run."""
    return run.required_timing().streaming.total_seconds


def compute_rate(run: Run) -> float:
    """Return the streaming rate in Hz, 1 / median of encode and match together."""
    return 1 / float(np.median(list_laps(run)))


def is_disturbed(run: Run) -> bool:
    """Tell whether the machine did other things while a run's times were taken, or the laps are too few."""
    return any(note.kind in DISTURBED for note in run.notes)


def describe_machine(run: Run) -> str:
    """Return the machine of a run's times, without the day."""
    return Machine.of(run.environment).line


def _find_winner(
    rows: Sequence[MethodRuns],
    value: Callable[[MethodRuns], float],
    beats: Callable[[MethodRuns, MethodRuns], bool],
) -> str | None:
    """Return the row of the highest value if it beats all others one by one."""
    if len(rows) < 2:
        return None
    leader, *others = sorted(rows, key=value, reverse=True)
    return leader.name if not leader.missing_seeds and all(beats(leader, other) for other in others) else None


def _is_better(one: MethodRuns, other: MethodRuns, metric: Metric, chance: float) -> bool:
    sign, window = 1 if metric.higher_is_better else -1, get_window_length(one.runs[0])
    ours = [list_values(run, metric, "pessimistic") for run in one.runs]
    theirs = [list_values(run, metric, "optimistic") for run in other.runs]
    for better, worse in (pair[::sign] for pair in product(ours, theirs)):
        test = mcnemar_exact(better > worse, better < worse, window)
        if test.b <= test.c or test.p_value >= chance:
            return False
        interval = difference_interval(better, worse, 1 - chance, window)
        if interval is None or interval.low <= 0:
            return False
    return True


def _is_faster(one: MethodRuns, other: MethodRuns) -> bool:
    from scipy.stats import mannwhitneyu  # takes long to import

    return all(
        compute_rate(first) >= FASTER * compute_rate(second)
        and mannwhitneyu(list_laps(first), list_laps(second)).pvalue < RATE_CHANCE
        for first, second in product(one.runs, other.runs)
    )


def _are_comparable(rows: Sequence[MethodRuns]) -> bool:
    """Tell whether all times were taken in one way on one machine that did nothing else."""
    runs = [run for row in rows for run in row.runs]
    around = [
        (run.config.get("timing"), run.environment.get("libraries"), run.environment.get("threads")) for run in runs
    ]
    alike = all(run.timing is not None and given == around[0] for run, given in zip(runs, around, strict=True))
    return alike and len(set(map(describe_machine, runs))) == 1 and not any(map(is_disturbed, runs))

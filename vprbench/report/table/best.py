"""The best row of a column: bold marks a difference that a paired test confirms on an undisturbed machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product

import numpy as np

from vprbench.metrics.accuracy import hits_at, recall_at
from vprbench.metrics.intervals import mcnemar_exact
from vprbench.report.plan import Boundary
from vprbench.runs.machine import Machine
from vprbench.runs.notes import DISTURBED
from vprbench.runs.recall_intervals import difference_of_recalls, order_along_journey
from vprbench.runs.record import Run
from vprbench.runs.stopwatch import Seconds
from vprbench.runs.views import window_of

CHANCE = 0.05  # of any false difference in R@1 among all comparisons of a column
RATE_CHANCE = 0.01
FASTER = 1.25  # times: less is within what machines vary by


@dataclass(frozen=True)
class Contestant:
    """One measured row."""

    name: str
    runs: tuple[Run, ...]  # one a seed, at least one
    finished: bool  # all its seeds are stored: otherwise it may be beaten but cannot win


def find_best_recall(rows: Sequence[Contestant]) -> str | None:
    """Return the row with the highest R@1 if a paired test separates it from every other row, else None.

    For every pair of seeds the exact McNemar test gives p < 0.05 / number of other rows, and the interval of the
    difference at that level (`intervals.difference_interval`) lies above 0. Ties are broken against the best row and in
    favour of the other one. All runs answer the same queries.
    """
    rows = [row for row in rows if average_recall(row.runs) is not None]
    chance = CHANCE / max(1, len(rows) - 1)
    return _winner(rows, lambda row: average_recall(row.runs) or 0.0, partial(_more_accurate, chance=chance))


def find_best_rate(rows: Sequence[Contestant]) -> str | None:
    """Return the row with the highest query rate if the laps separate it from every other row, else None.

    All rows ran undisturbed on one machine and were timed alike. For every pair of seeds it is at least 1.25 times as
    fast, and the Mann-Whitney U test of the streaming laps, encode and match together, gives p < 0.01. A row with a run
    that gave other answers when it was timed may be beaten but cannot win.
    """
    rows = [replace(row, finished=row.finished and not any(map(has_other_answers, row.runs))) for row in rows]
    if not _comparable(rows):
        return None
    return _winner(rows, lambda row: float(np.mean([compute_rate(run) for run in row.runs])), _faster)


def find_best_training(rows: Sequence[Contestant]) -> str | None:
    """Return the row that trains fastest, by at least 1.25 times in every pair of seeds; None if no row does.

    Waiting for images does not count. All rows trained undisturbed on one machine. One fit a seed is no sample that a
    test could weigh.
    """
    rows = [row for row in rows if all(run.fit_compute_seconds is not None for run in row.runs)]
    if not _comparable(rows):
        return None
    return _winner(rows, lambda row: -_slowest(row), lambda one, other: FASTER * _slowest(one) <= _fastest(other))


def average_recall(runs: Sequence[Run]) -> float | None:
    """Return the mean R@1 over the seeds, 0 to 1, expected under ties; None if no query has a right place."""
    recalls = [recall_at(run.outcome, 1) for run in runs]
    expected = [recall.expected for recall in recalls if recall is not None]
    return float(np.mean(expected)) if expected else None


def compute_rate(run: Run, boundary: Boundary | None = None) -> float:
    """Return the streaming rate in Hz, 1 / median: of encode and match together, or of one of them alone."""
    return 1 / float(np.median(list_laps(run, boundary)))


def is_disturbed(run: Run) -> bool:
    """Tell whether a run's times were taken while the machine did other things, or are too few."""
    return any(note.kind in DISTURBED for note in run.notes)


def has_other_answers(run: Run) -> bool:
    """Return whether a run gave other answers when it was timed."""
    return any(note.kind == "answers" for note in run.notes)


def describe_machine(run: Run) -> str:
    """Return what a run's times were measured on, without the day."""
    return Machine.of(run.environment).line


def _winner(
    rows: Sequence[Contestant],
    value: Callable[[Contestant], float],
    beats: Callable[[Contestant, Contestant], bool],
) -> str | None:
    """Return the row of the highest value if it is the only one of that value and beats all others one by one."""
    if len(rows) < 2:
        return None
    leader, *others = sorted(rows, key=value, reverse=True)
    won = leader.finished and value(leader) > value(others[0]) and all(beats(leader, other) for other in others)
    return leader.name if won else None


def _more_accurate(one: Contestant, other: Contestant, chance: float) -> bool:
    return all(_separated(first, second, chance) for first, second in product(one.runs, other.runs))


def _separated(first: Run, second: Run, chance: float) -> bool:
    order = order_along_journey(first)
    ours, theirs = hits_at(first.outcome, 1, "pessimistic")[order], hits_at(second.outcome, 1, "optimistic")[order]
    test = mcnemar_exact(ours, theirs, window_of(first))
    if test.b <= test.c or test.p_value >= chance:
        return False
    interval = difference_of_recalls(first, second, 1 - chance)
    return interval is not None and interval.low > 0


def _faster(one: Contestant, other: Contestant) -> bool:
    from scipy.stats import mannwhitneyu  # takes long to import

    return all(
        compute_rate(first) >= FASTER * compute_rate(second)
        and mannwhitneyu(list_laps(first), list_laps(second)).pvalue < RATE_CHANCE
        for first, second in product(one.runs, other.runs)
    )


def _comparable(rows: Sequence[Contestant]) -> bool:
    """Tell whether all times were taken in one way on one machine that did nothing else."""
    runs = [run for row in rows for run in row.runs]
    alike = all(run.timing is not None and _timed_by(run) == _timed_by(runs[0]) for run in runs)
    return alike and len(set(map(describe_machine, runs))) == 1 and not any(map(is_disturbed, runs))


def _timed_by(run: Run) -> tuple[object, ...]:
    return run.config.get("timing"), run.environment.get("libraries"), run.environment.get("threads")


def list_laps(run: Run, boundary: Boundary | None = None) -> Seconds:
    """Return the seconds of the streaming laps: of encode and match together, or of one of them alone.

    Raises ValueError for a run that was not timed.
    """
    encode, match, both = run.required_timing().streaming.by_stage
    return both if boundary is None else encode if boundary == "encode" else match


def _slowest(row: Contestant) -> float:
    return max(run.fit_compute_seconds or 0.0 for run in row.runs)


def _fastest(row: Contestant) -> float:
    return min(run.fit_compute_seconds or 0.0 for run in row.runs)

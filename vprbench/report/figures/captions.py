"""The runs that a figure draws, and the facts about them with which its caption ends."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from vprbench.errors import BadInput
from vprbench.report.selection import MethodRuns
from vprbench.report.table.best import describe_machine, is_disturbed
from vprbench.runs.record import Run
from vprbench.runs.tuned import describe_tuning
from vprbench.text import format_count

INTERVALS = "95 % intervals over the queries, the wider of Wilson's and a block bootstrap's"


def choose_runs(series: Sequence[MethodRuns], fits: Callable[[Run], object], wanted: str) -> list[MethodRuns]:
    """Return the rows with their runs that fit; raises BadInput, "no stored run" and `wanted`, if there is none."""
    chosen = [MethodRuns(row.name, runs) for row in series if (runs := tuple(filter(fits, row.runs)))]
    if not chosen:
        raise BadInput(f"no stored run {wanted}")
    return chosen


def choose_answerable(series: Sequence[MethodRuns]) -> list[MethodRuns]:
    """Return the rows whose runs know right places; raises BadInput if none does."""
    return choose_runs(series, lambda run: run.outcome.answerable.any(), "has a query with a right place")


def list_names(fact: str, names: Iterable[str]) -> str:
    """Return a sentence of a caption, after a space, on different names; empty for no names."""
    text = ", ".join(dict.fromkeys(names))
    return f" {fact}: {text}." if text else ""


def describe_machines(runs: Iterable[Run]) -> str:
    """Return a sentence that names the machines on which runs were timed."""
    return f"Measured on {'; '.join(dict.fromkeys(map(describe_machine, runs)))}."


def describe_runs(series: Sequence[MethodRuns]) -> str:
    """Return the end of a caption: datasets, rows of several seeds and tuned rows."""
    datasets = dict.fromkeys(_describe_dataset(run) for row in series for run in row.runs)
    seeds = list_names("Seeds", (f"{row.name} {len(row.runs)}" for row in series if len(row.runs) > 1))
    tuned = [f" {row.name}: {note}." for row in series if (note := describe_tuning(row.runs))]
    return f"Dataset: {'; '.join(datasets)}.{seeds}{''.join(tuned)}"


def describe_timed_runs(series: Sequence[MethodRuns]) -> str:
    """Return the end of a caption of times: `describe_runs`, machines and disturbed rows."""
    machines = describe_machines(run for row in series for run in row.runs)
    disturbed = [row.name for row in series if any(map(is_disturbed, row.runs))]
    return f"{describe_runs(series)} {machines}{list_names('Disturbed machine or too few laps', disturbed)}"


def _describe_dataset(run: Run) -> str:
    unanswerable = int(np.count_nonzero(~run.outcome.answerable))
    counts = f"{format_count(len(run.outcome), 'query')}, {format_count(run.outcome.n_places, 'place')}"
    return f"{run.dataset} ({counts}{f', {unanswerable:,} without a right place' if unanswerable else ''})"

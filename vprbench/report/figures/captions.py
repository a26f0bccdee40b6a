"""The facts about runs with which captions end, and the checks of the runs that a figure draws."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace

import numpy as np

from vprbench.errors import BadInput
from vprbench.report.selection import Series
from vprbench.report.table.best import describe_machine, is_disturbed
from vprbench.runs.record import Run
from vprbench.runs.tuned import describe_tuning
from vprbench.text import plural

INTERVALS = "95 % intervals over the queries, the wider of Wilson's and a block bootstrap's"


def join_facts(*facts: str) -> str:
    """Return a caption of facts, without the empty ones."""
    return " ".join(filter(None, facts))


def list_names(fact: str, names: Collection[str]) -> str:
    """Return a fact with the names that it is about; empty for no names."""
    return f"{fact}: {', '.join(names)}." if names else ""


def describe_runs(series: Sequence[Series], seeds: str, of_times: bool = False) -> str:
    """Return the end of a caption: datasets, seeds and tuned rows, for times also machines and disturbed rows.

    Args:
        series: Rows that the figure draws, at least one.
        seeds: How the figure draws several seeds of a row.
        of_times: Whether the figure draws times.
    """
    runs = [run for row in series for run in row.runs]
    several = dict.fromkeys(f"{row.name} {len(row.runs)}" for row in series if len(row.runs) > 1)
    noisy = dict.fromkeys(row.name for row in series if any(map(is_disturbed, row.runs)))
    tuned = dict.fromkeys(f"{row.name}: {note}." for row in series if (note := describe_tuning(row.runs)))
    return join_facts(
        f"Dataset: {'; '.join(dict.fromkeys(map(_describe_dataset, runs)))}.",
        list_names(f"Seeds ({seeds})", several),
        describe_machines(runs) if of_times else "",
        list_names("Disturbed machine or too few laps", noisy if of_times else ()),
        *tuned,
    )


def describe_machines(runs: Iterable[Run]) -> str:
    """Return a sentence that names the machines on which runs were timed."""
    return f"Measured on {'; '.join(dict.fromkeys(map(describe_machine, runs)))}."


def _describe_dataset(run: Run) -> str:
    unanswerable = int(np.count_nonzero(~run.outcome.answerable))
    counts = f"{plural(len(run.outcome), 'query')}, {plural(run.outcome.n_places, 'place')}"
    return f"{run.dataset} ({counts}{f', {unanswerable:,} without a right place' if unanswerable else ''})"


def split_timed(series: Sequence[Series]) -> tuple[list[Series], list[str]]:
    """Return the rows that were timed, without runs that were not, and the names of the other rows."""
    timed = [replace(row, runs=tuple(run for run in row.runs if run.timing is not None)) for row in series]
    return [row for row in timed if row.runs], [row.name for row in timed if not row.runs]


def require_one_dataset(series: Sequence[Series], figure: str) -> Run:
    """Return a run that stands for the data of all; raises BadInput for no run and for runs on different data."""
    runs = [run for row in series for run in row.runs]
    if not runs:
        raise BadInput(f"the figure of {figure} has no stored runs to draw: run a method first")
    first = runs[0]
    for run in runs:
        if (run.fingerprint, run.protocol) != (first.fingerprint, first.protocol):
            raise BadInput(
                f"the figure of {figure} got runs on different data ({first.method} on {first.dataset} under "
                f"{dict(first.protocol)}, {run.method} on {run.dataset} under {dict(run.protocol)}): draw one at a time"
            )
    return first


def require_answerable(series: Sequence[Series], figure: str) -> Run:
    """Return what `require_one_dataset` does; raises BadInput too if no query has a right place."""
    run = require_one_dataset(series, figure)
    if not run.outcome.answerable.any():
        raise BadInput(f"no query of dataset {run.dataset} has a right place: there is no figure of {figure}")
    return run

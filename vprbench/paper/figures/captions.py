"""The facts about runs with which captions end, and the checks of the runs that a figure draws."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from vprbench.errors import BadInput
from vprbench.paper.growth import GrowthSamples
from vprbench.paper.selection import Series
from vprbench.paper.table.best import describe_machine, is_disturbed
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
    datasets = dict.fromkeys(_describe_dataset(run) for one in series for run in one.runs)
    several = dict.fromkeys(f"{one.name} {len(one.runs)}" for one in series if len(one.runs) > 1)
    noisy = dict.fromkeys(one.name for one in series if any(map(is_disturbed, one.runs)))
    tuned = dict.fromkeys(f"{one.name}: {note}." for one in series if (note := describe_tuning(one.runs)))
    return join_facts(
        f"Dataset: {'; '.join(datasets)}.",
        list_names(f"Seeds ({seeds})", several),
        describe_machines(series) if of_times else "",
        list_names("Disturbed machine or too few laps", noisy if of_times else ()),
        *tuned,
    )


def describe_machines(series: Sequence[Series | GrowthSamples]) -> str:
    """Return a sentence that names the machines on which runs were timed."""
    return f"Measured on {'; '.join(dict.fromkeys(describe_machine(run) for one in series for run in one.runs))}."


def _describe_dataset(run: Run) -> str:
    unanswerable = int(np.count_nonzero(~run.outcome.answerable))
    counts = f"{plural(len(run.outcome), 'query')}, {plural(run.outcome.n_places, 'place')}"
    return f"{run.dataset} ({counts}{f', {unanswerable:,} without a right place' if unanswerable else ''})"


def split_timed(series: Sequence[Series]) -> tuple[list[Series], list[str]]:
    """Return the rows that were timed, without runs that were not, and the names of the other rows."""
    runs = [(one, tuple(run for run in one.runs if run.timing is not None)) for one in series]
    return [replace(one, runs=kept) for one, kept in runs if kept], [one.name for one, kept in runs if not kept]


def require_one_dataset(series: Sequence[Series], figure: str) -> Run:
    """Return a run that stands for the data of all; raises BadInput for no run and for runs on different data."""
    runs = [run for one in series for run in one.runs]
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

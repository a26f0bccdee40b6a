"""Captions of figures: the facts of the runs that many of them tell, put into the template beside this module."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from vprbench.errors import BadInput
from vprbench.paper.growth import GrowthSamples
from vprbench.paper.selection import Series
from vprbench.paper.table.best import disturbed, machine
from vprbench.paper.templates import sentences
from vprbench.runs.record import Run
from vprbench.runs.tuned import describe_tuning
from vprbench.text import plural


def caption(figure: str, series: Sequence[Series | GrowthSamples], **values: Any) -> str:
    """Return the caption of a figure, a macro of captions.j2 by its name, that shows at least one run."""
    runs = [run for one in series for run in one.runs]
    tuned = [
        f"{one.name}: {note}." for one in series if isinstance(one, Series) and (note := describe_tuning(one.runs))
    ]
    told = {
        "datasets": [
            f"{r.dataset} ({plural(len(r.outcome), 'query')}, {plural(r.outcome.n_places, 'place')})" for r in runs
        ],
        "unanswerable": int(np.count_nonzero(~runs[0].outcome.answerable)),
        "several": [f"{one.name} ({len(one.runs)} seeds)" for one in series if len(one.runs) > 1],
        "machines": list(dict.fromkeys(map(machine, runs))),
        "noisy": [one.name for one in series if any(map(disturbed, one.runs))],
        "tuned": list(dict.fromkeys(tuned)),
    }
    return " ".join(sentences("figures/captions.j2", figure, told, **values))


def timed(series: Sequence[Series]) -> tuple[list[Series], list[str]]:
    """Return the rows that were timed, without runs that were not, and the names of those that were not."""
    runs = [(one, tuple(run for run in one.runs if run.timing is not None)) for one in series]
    return [replace(one, runs=kept) for one, kept in runs if kept], [one.name for one, kept in runs if not kept]


def one_dataset(series: Sequence[Series], figure: str) -> Run:
    """Return a run that stands for the data of all; raises BadInput if there is none or they saw different data."""
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

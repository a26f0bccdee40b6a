"""The rows of one figure saw the same images under the same protocol."""

from __future__ import annotations

from collections.abc import Sequence

from vprbench.errors import BadInput
from vprbench.paper.figures.measured_on import runs_of
from vprbench.paper.selection import Series
from vprbench.run.record import Run


def one_dataset(series: Sequence[Series], figure: str) -> Run:
    """Return a run that stands for the data of all; raises BadInput where there is none or they saw different data."""
    runs = runs_of(series)
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

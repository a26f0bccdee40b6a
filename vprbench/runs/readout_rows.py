"""The readouts of a run for people and programs: R@1 of codes, layers and answer, each with its interval."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.metrics.accuracy import hits_at
from vprbench.metrics.intervals import share_interval
from vprbench.metrics.registry import METRICS
from vprbench.runs.recall_intervals import along_the_journey
from vprbench.runs.record import Run
from vprbench.terminal.console import line_text, table_text

_ANSWER = "answer"


def readout_numbers(run: Run) -> list[dict[str, Any]] | None:
    """Return R@1 of each readout and of the answer, 0 to 1, with the ends of its 95 % interval as in the row.

    None if no layer was read; empty for a method without layers, and where no query has a right place.
    """
    if not run.readouts or not run.outcome.answerable.any():
        return None if run.readouts is None else []
    order = along_the_journey(run)
    answer = {"name": _ANSWER, "neurons": run.outcome.n_places, "hits": hits_at(run.outcome, 1)}
    return [_recall(readout, order) for readout in (*run.readouts, answer)]


def readout_text(run: Run) -> str:
    """Return the readouts of a run as a small table, or a line that says why there is none."""
    found = readout_numbers(run)
    if found:
        columns = ("readout", "neurons", "R@1 % [95 %]", *["time steps"] * any("steps" in each for each in found))
        return table_text(columns, [_row(readout)[: len(columns)] for readout in found])
    missing = f"{run.method} learns no layer that it shows" if run.readouts == [] else "see the notes"
    return line_text(f"readouts: none, {missing}")


def _recall(readout: Mapping[str, Any], order: npt.NDArray[np.int64]) -> dict[str, Any]:
    hits = np.asarray(readout["hits"], np.float64)[order]
    interval = share_interval(hits)
    assert interval is not None  # there are queries
    return {
        "name": readout["name"],
        "neurons": readout["neurons"],
        "recall_at_1": float(hits.mean()),
        "recall_at_1_low": interval.low,
        "recall_at_1_high": interval.high,
        **({"steps": float(np.mean(readout["steps"]))} if "steps" in readout else {}),
    }


def _row(readout: Mapping[str, Any]) -> list[str]:
    name, first = readout["name"], METRICS["recall_at_1"].text(readout["recall_at_1"])
    ends = f"[{100 * readout['recall_at_1_low']:.1f}, {100 * readout['recall_at_1_high']:.1f}]"
    steps = f"{readout['steps']:.4g}" if "steps" in readout else ""
    said = name if name == _ANSWER or steps else f"{name}, cosine"
    return [said, f"{readout['neurons']:,}", f"{first} {ends}", steps]

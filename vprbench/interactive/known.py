"""Registered methods, registered datasets and stored runs as tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from vprbench.errors import BadInput
from vprbench.plugins.entries import Group, entries


def methods() -> pd.DataFrame:
    """Return the registered methods, a row each; imports none of them."""
    return _tabulate_entries("method", ("name", "description", "provider", "spiking", "needs_weights"))


def datasets() -> pd.DataFrame:
    """Return the registered datasets, a row each; looks for no frames."""
    return _tabulate_entries("dataset", ("name", "description", "provider"))


def results(folder: str | Path = "results") -> pd.DataFrame:
    """Return every whole run that a folder stores, a row each: accuracies, 0 to 1, intervals, seconds and rates.

    The columns stand in docs/numbers.md; `hz` is `streaming_total_hz`. Runs of equal `fingerprint` were asked the same
    images. Raises BadInput for a folder that is not there or cannot be read.
    """
    from vprbench.metrics.registry import METRICS
    from vprbench.runs.frame import tabulate_runs
    from vprbench.runs.store import Store

    root = Path(folder).expanduser()
    if not root.is_dir():
        raise BadInput(
            f"results={folder} is no folder: give one that vprbench.run, or the command line, stored runs in"
        )
    found = tabulate_runs(Store(root).runs(), [*METRICS])
    numbers = [name for name in found if name in METRICS or str(name).endswith(("_low", "_high", "_seconds", "_hz"))]
    return found.astype(dict.fromkeys(numbers, float)).assign(hz=found["streaming_total_hz"].astype(float))


def _tabulate_entries(group: Group, columns: Sequence[str]) -> pd.DataFrame:
    return pd.DataFrame([{column: getattr(entry, column) for column in columns} for entry in entries(group).values()])

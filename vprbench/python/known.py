"""Registered methods, registered datasets and stored runs as tables."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from vprbench.errors import BadInput
from vprbench.plugins.entries import Group, find_entries
from vprbench.plugins.listing import describe_entry

_SHOWN = ("name", "description", "provider")


def methods() -> pd.DataFrame:
    """Return the registered methods, a row each; imports none of them."""
    found = _tabulate("method")
    spiking = found["tags"].map(lambda tags: "spiking" in tags)
    return found.assign(spiking=spiking)[[*_SHOWN, "spiking", "needs_weights"]]


def datasets() -> pd.DataFrame:
    """Return the registered datasets, a row each; looks for no frames."""
    return _tabulate("dataset")[[*_SHOWN]]


def results(folder: str | Path = "results") -> pd.DataFrame:
    """Return every whole run that a folder stores, a row each: accuracies, 0 to 1, intervals, seconds and rates.

    The columns stand in docs/numbers.md; `hz` is `streaming_total_hz`. Runs of equal `fingerprint` were asked the same
    images. Raises BadInput for a folder that is not there or cannot be read.
    """
    from vprbench.metrics.catalogue import METRICS
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


def _tabulate(group: Group) -> pd.DataFrame:
    return pd.DataFrame(map(describe_entry, find_entries(group).values()))

"""What there is, as tables: registered methods and datasets, and stored runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from vprbench.plugins.entries import Group, entries

if TYPE_CHECKING:
    from vprbench.interactive.result import Result

_NAN = float("nan")


def methods() -> pd.DataFrame:
    """Return the registered methods, a row each; imports none of them."""
    more = {name: (entry.spiking, entry.needs_weights) for name, entry in entries("method").items()}
    told = pd.DataFrame.from_dict(more, orient="index", columns=["spiking", "needs_weights"])
    return _described("method").join(told, on="name")


def datasets() -> pd.DataFrame:
    """Return the registered datasets, a row each; looks for no frames."""
    return _described("dataset")


def results(folder: str | Path = "results") -> pd.DataFrame:
    """Return every whole run that a folder stores, a row each: accuracies, 0 to 1, intervals, seconds and rates.

    Raises BadInput for a folder that cannot be read.
    """
    from vprbench.interactive.result import Result
    from vprbench.run.store import Store

    runs = Store(Path(folder).expanduser(), read_only=True).runs()
    return pd.DataFrame([_row(Result(run, None, ())) for run in runs])


def _row(result: Result) -> dict[str, Any]:
    run, interval = result.run, result.interval()
    return {
        "method": run.method,
        "dataset": run.dataset,
        "arguments": result.name.removeprefix(run.method).strip(),
        "seed": run.config["seed"],
        "device": run.config["device"],
        **result.metrics,
        "recall_at_1_low": interval.low if interval else _NAN,
        "recall_at_1_high": interval.high if interval else _NAN,
        "fit_seconds": run.training_seconds,
        "hz": result.hz,
        "key": run.key,
    }


def _described(group: Group) -> pd.DataFrame:
    columns = ("name", "description", "provider")
    return pd.DataFrame([{column: getattr(entry, column) for column in columns} for entry in entries(group).values()])

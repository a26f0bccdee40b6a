"""What there is, as tables: registered methods and datasets, and stored runs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from vprbench.errors import BadInput
from vprbench.plugins.entries import Entry, Group, entries

if TYPE_CHECKING:
    from vprbench.runs.record import Run


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

    Runs of equal `fingerprint` were asked the same images. Raises BadInput for a folder that is not there or cannot be
    read.
    """
    from vprbench.interactive.result import Result
    from vprbench.metrics.registry import METRICS
    from vprbench.runs.store import Store

    root = Path(folder).expanduser()
    if not root.is_dir():
        raise BadInput(
            f"results={folder} is no folder: give one that vprbench.run, or the command line, stored runs in"
        )
    found = [Result(run, None, ()) for run in Store(root, read_only=True).runs()]
    runs = [result.run for result in found]
    metrics, known = [result.metrics for result in found], entries("dataset")
    intervals = [result.interval() for result in found]
    columns = {
        "method": [run.method for run in runs],
        "arguments": [result.name.removeprefix(result.run.method).strip() for result in found],
        "dataset": [run.dataset for run in runs],
        "dataset_arguments": [_as_text(_changed(run, known)) for run in runs],
        "places": [run.outcome.n_places for run in runs],
        "queries": [len(run.outcome) for run in runs],
        "protocol": [_as_text(run.protocol) for run in runs],
        "fingerprint": [run.fingerprint[:12] for run in runs],
        "seed": [run.config["seed"] for run in runs],
        "device": [run.config["device"] for run in runs],
        **{name: [each[name] for each in metrics] for name in METRICS},
        "recall_at_1_low": pd.Series([interval and interval.low for interval in intervals], dtype=float),
        "recall_at_1_high": pd.Series([interval and interval.high for interval in intervals], dtype=float),
        "fit_seconds": pd.Series([run.training_seconds for run in runs], dtype=float),
        "hz": [result.hz for result in found],
        "key": [run.key for run in runs],
    }
    return pd.DataFrame(columns)


def _changed(run: Run, known: Mapping[str, Entry]) -> Mapping[str, Any]:
    """Return the arguments of a run's dataset that differ from its yaml; all of one that is not registered here."""
    asked = (text.lstrip("+") for text in run.config.get("overrides", ()))
    name = next((text.partition("=")[2] for text in asked if text.startswith("dataset=")), run.dataset)
    arguments = {key: value for key, value in run.config["dataset"].items() if key not in ("_target_", "name")}
    entry = known.get(name)
    return arguments if entry is None else entry.changed(arguments)


def _as_text(values: Mapping[str, Any]) -> str:
    return " ".join(f"{name}={value}" for name, value in values.items())


def _described(group: Group) -> pd.DataFrame:
    columns = ("name", "description", "provider")
    return pd.DataFrame([{column: getattr(entry, column) for column in columns} for entry in entries(group).values()])

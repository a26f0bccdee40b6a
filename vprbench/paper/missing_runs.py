"""Runs that the table and the figures want and the store lacks, each made in a process of its own."""

from __future__ import annotations

import json
import logging
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vprbench.paper.plan import Row
from vprbench.paper.shelf import Compose, Shelf
from vprbench.plugins import registry
from vprbench.run import machine
from vprbench.run.processes import Ending, run_apart
from vprbench.run.record import Failure
from vprbench.run.store import Store

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class MissingRun:
    """One run: a row on a dataset, with a seed and a device."""

    row: Row
    title: str  # of the dataset, for people
    dataset_options: tuple[str, ...]  # of the command line
    dataset: Mapping[str, Any]  # what these resolve to
    arguments: Mapping[str, Any]  # of the row's method
    seed: int
    device: str

    def options(self) -> list[str]:
        """Return the options of the command line that make it."""
        return [
            *self.dataset_options,
            f"method={self.row.method}",
            *(f"method.{name}={json.dumps(value)}" for name, value in _flat(self.arguments)),
            f"seed={self.seed}",
            f"device={self.device}",
        ]

    def failed(self, error: str, missing: bool) -> Failure:
        """Return the record of its failure."""
        return Failure(
            self.row.method,
            str(self.dataset["name"]),
            {
                "method": dict(self.arguments),
                "dataset": dict(self.dataset),
                "seed": self.seed,
                "device": self.device,
                "load": None,
                "changed": dict(self.arguments),
                "overrides": self.options(),
            },
            error,
            machine.capture("cpu", 1),
            missing,
        )


def _flat(arguments: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield arguments, those of mappings by dotted names."""
    for name, value in arguments.items():
        if isinstance(value, Mapping) and value:
            yield from ((f"{name}.{inner}", given) for inner, given in _flat(value))
        else:
            yield name, value


def fill(wanted: Sequence[MissingRun], options: Sequence[str], store: Store, compose: Compose) -> list[Ending]:
    """Make the runs that are not stored yet, one after the other; returns how each ended.

    `options` of the command line are those of all runs. For a run that is stored no process is started. What is missing
    for the first seed of a row is missing for the others, which are not tried. A failure is stored, never raised.
    """
    endings: list[Ending] = []
    missing: dict[tuple[str, str, str], Ending] = {}
    shelf = Shelf(store, options, compose)
    for number, run in enumerate(wanted, 1):
        known = (run.row.name, run.title, run.device)
        if known in missing:
            endings.append(missing[known])
            continue
        if shelf.holds(run):
            endings.append(Ending(0))
            continue
        logger.info("[%d/%d] %s on %s, seed %d, %s", number, len(wanted), run.row.name, run.title, run.seed, run.device)
        ending = _made(run, options, store)
        if ending.missing:
            missing[known] = ending
        endings.append(ending)
    return endings


def _made(run: MissingRun, options: Sequence[str], store: Store) -> Ending:
    """Make one run in a process of its own."""
    known = registry.entries("method")
    if run.row.method not in known:
        return _stored(run, f"there is no method {run.row.method} here yet", True, store)
    if run.device != "cpu" and "device" not in known[run.row.method].options:
        return Ending(0)
    ending = run_apart([*run.options(), *options, f"results={store.root}"], stdout=subprocess.DEVNULL)
    if ending.code and not ending.recorded:
        return _stored(run, ending.error, ending.missing, store, ending.code)
    return ending


def _stored(run: MissingRun, error: str, missing: bool, store: Store, code: int = 2) -> Ending:
    store.prepare()
    store.save_failure(run.failed(error, missing))
    return Ending(code, missing, error, recorded=True)


def results_folder(results: str) -> Path:
    """Return the folder of a store as an absolute path, so that processes elsewhere find it."""
    return Path(results).expanduser().absolute()

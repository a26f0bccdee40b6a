"""Runs that the table and the figures want and the store lacks, each made in a process of its own."""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import mean
from typing import Any

from vprbench.api.weights import Weights, find_weights
from vprbench.errors import NotThere
from vprbench.metrics.accuracy import recall_at
from vprbench.paper.plan import Row
from vprbench.paper.shelf import Compose, Shelf
from vprbench.plugins import registry
from vprbench.progress import marked, shown_by
from vprbench.run import machine
from vprbench.run.processes import Ending, run_apart
from vprbench.run.rates import StageRates, best_batch
from vprbench.run.record import Failure, Run, content_key
from vprbench.run.store import Store
from vprbench.terminal.live import LiveTable

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
    corruption: str | None = None  # of the query frames

    def options(self) -> list[str]:
        """Return the options of the command line that make it."""
        return [
            *self.dataset_options,
            f"method={self.row.method}",
            *(f"method.{name}={json.dumps(value)}" for name, value in _flat(self.arguments)),
            f"seed={self.seed}",
            f"device={self.device}",
            *([] if self.corruption is None else [f"corruption={self.corruption}"]),
        ]

    def failed(self, error: str, missing: bool) -> Failure:
        """Return the record of its failure."""
        return Failure(
            self.row.method,
            str(self.dataset["name"]),
            {
                "method": dict(self.arguments),
                "dataset": dict(self.dataset),
                "corruption": self.corruption,
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

    `options` of the command line are those of all runs. For a run that is stored no process is started, nor for one
    whose published weights cannot be had. What is missing for the first seed of a row is missing for the others, which
    are not tried. A failure is stored, never raised.
    """
    shown = _Shown(wanted) if sys.stderr.isatty() and len(wanted) > 1 else None
    shelf, weights = Shelf(store, options, compose), _Weights(options, compose)
    if shown is None:
        return list(_endings(wanted, options, store, shelf, weights, None))
    with shown.table, shown_by(shown.progress):
        return list(_endings(wanted, options, store, shelf, weights, shown))


class _Weights:
    """The published weights that rows need, looked for once, and fetched if that is possible."""

    def __init__(self, options: Sequence[str], compose: Compose) -> None:
        """Look for those of runs with these options."""
        self._options, self._compose = options, compose
        self._errors: dict[tuple[str, str], str] = {}

    def lacking(self, run: MissingRun) -> str:
        """Return why those of a run cannot be had; nothing if they are there, or if its process has to tell."""
        known = (run.row.method, content_key(run.arguments))
        if known not in self._errors:
            self._errors[known] = ""
            try:
                config = self._compose([*run.options(), *self._options])["method"]
                wanted = registry.checked("method.weights", config["weights"], Weights)
                find_weights(wanted, config["_target_"].rpartition(".")[2])
            except NotThere as error:
                logger.warning("%s: %s", run.row.name, error)
                self._errors[known] = str(error)
            except (Exception, SystemExit) as error:  # whatever a plug-in raises, or an option that does not fit
                logger.debug("the weights of %s are left to a process: %s", run.row.name, error)
        return self._errors[known]


def _endings(
    wanted: Sequence[MissingRun],
    options: Sequence[str],
    store: Store,
    shelf: Shelf,
    weights: _Weights,
    shown: _Shown | None,
) -> Iterator[Ending]:
    missing: dict[tuple[str, str, str], Ending] = {}
    for number, run in enumerate(wanted, 1):
        known = (run.row.name, run.title, run.device)
        if shown is not None:
            shown.begin(run)
        ending, found = missing.get(known), None
        if ending is None:
            found = shelf.held(run)
            ending = Ending(0) if found else None
        if ending is None:
            if shown is None:
                on = f"{run.row.name} on {run.title}, seed {run.seed}, {run.device}"
                logger.info("[%d/%d] %s", number, len(wanted), on)
            ending = _made(run, options, store, weights, shown)
            found = store.find(str(run.dataset["name"]), run.row.method, ending.key) if shown and ending.key else None
        if ending.missing:
            missing[known] = ending
        if shown is not None:
            shown.end(run, ending, found)
        yield ending


def _made(run: MissingRun, options: Sequence[str], store: Store, weights: _Weights, shown: _Shown | None) -> Ending:
    """Make one run in a process of its own."""
    known = registry.entries("method")
    if run.row.method not in known:
        return _stored(run, f"there is no method {run.row.method} here yet", True, store)
    if run.device != "cpu" and "device" not in known[run.row.method].options:
        return Ending(0)
    asked = [*run.options(), *options, f"results={store.root}"]
    if shown is not None:
        shown.start(run)
    if known[run.row.method].needs_weights and (lacking := weights.lacking(run)):
        return _stored(run, lacking, True, store)
    if shown is None:
        ending = run_apart(asked, stdout=subprocess.DEVNULL)
    else:
        ending = run_apart(asked, stdout=subprocess.DEVNULL, heard=shown.heard)
    if ending.code and not ending.recorded:
        return _stored(run, ending.error, ending.missing, store, ending.code)
    return ending


class _Shown:
    """The live table of what is filled: recall and query rate of each row and dataset, as they are stored."""

    def __init__(self, wanted: Sequence[MissingRun]) -> None:
        """Show a row and a column for each that is wanted."""
        rows, columns = (dict.fromkeys(run.row.name for run in wanted), dict.fromkeys(map(_column, wanted)))
        self.table = LiveTable([*rows], [*columns], len(wanted))
        self._at = wanted[0]
        self._numbers: dict[tuple[str, str], list[tuple[float | None, float | None]]] = {}

    def begin(self, run: MissingRun) -> None:
        """Go on with a run."""
        self._at = run

    def start(self, run: MissingRun) -> None:
        """Begin to make a run."""
        self.table.show(run.row.name, _column(run), "starts", "cyan")
        self.table.begin()

    def progress(self, stage: str, done: float) -> None:
        """Show how far the run is."""
        self.table.share(done if stage.startswith("timing") else 0.0)
        self.table.show(self._at.row.name, _column(self._at), f"{stage.split(',')[0]} {100 * done:.0f} %", "cyan")

    def heard(self, line: str) -> None:
        """Show what a process says: its progress in its cell, all else above the table."""
        told = marked(line)
        if isinstance(told, tuple):
            self.progress(*told)
        elif told is not None:
            self.table.line(told, "yellow")
        elif line:
            self.table.line(line, "red" if line.startswith("vprbench: ") else "")

    def end(self, run: MissingRun, ending: Ending, found: Run | None) -> None:
        """Show what a run has come to."""
        cell = (run.row.name, _column(run))
        if ending.code:
            self.table.show(*cell, *(("not there", "dim") if ending.missing else ("failed", "red")))
        elif found is not None:
            numbers = self._numbers.setdefault(cell, [])
            first = recall_at(found.outcome, 1)
            batch = best_batch(found.timing.offline) if found.timing else None
            rate = StageRates.offline(batch).total if batch else None
            numbers.append((first.expected if first else None, rate))
            recalls, rates = ([each for each in column if each is not None] for column in zip(*numbers, strict=True))
            words = [f"{100 * mean(recalls):.1f} %" if recalls else "undefined"]
            words.append(f"{mean(rates):,.0f} Hz" if rates else "not timed")
            self.table.show(*cell, "  ".join(words))
        else:
            self.table.show(*cell, "-", "dim")
        self.table.step()


def _column(run: MissingRun) -> str:
    return run.title if run.device == "cpu" else f"{run.title}, {run.device}"


def _stored(run: MissingRun, error: str, missing: bool, store: Store, code: int = 2) -> Ending:
    store.prepare()
    store.save_failure(run.failed(error, missing))
    return Ending(code, missing, error, recorded=True)


def results_folder(results: str) -> Path:
    """Return the folder of a store as an absolute path, so that processes elsewhere find it."""
    return Path(results).expanduser().absolute()

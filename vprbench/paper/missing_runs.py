"""Runs that the table and the figures want and the store lacks, each made in a process of its own."""

from __future__ import annotations

import itertools
import json
import logging
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import mean
from typing import Any

from vprbench.api.weights import Weights, find_weights
from vprbench.errors import NotThere
from vprbench.jobs.executors import Callbacks, Executor, Numbered, SerialExecutor, run_all
from vprbench.jobs.job import JobResult
from vprbench.jobs.sweep import lost
from vprbench.metrics.accuracy import recall_at
from vprbench.paper.plan import Row
from vprbench.paper.stored_runs import Compose, StoredRuns
from vprbench.plugins import registry
from vprbench.runs import machine
from vprbench.runs.record import Failure, Run
from vprbench.runs.run_files import content_key
from vprbench.runs.stopwatch import StageRates, best_batch
from vprbench.runs.store import Store
from vprbench.terminal.live import LiveTable
from vprbench.text import format_percent, format_rate

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
    corruption: str | tuple[str, ...] | None = None  # of the query frames; several: a run each, in one process
    views: Any = None  # viewpoints that its queries are asked from, as the option says

    def options(self) -> list[str]:
        """Return the options of the command line that make the run."""
        return [
            *self.dataset_options,
            f"method={self.row.method}",
            *(f"method.{name}={json.dumps(value)}" for name, value in _flat(self.arguments)),
            f"seed={self.seed}",
            f"device={self.device}",
            *([] if self.corruption is None else [f"corruption={_listed(self.corruption)}"]),
            *([] if self.views is None else [f"views={_written(self.views)}"]),
        ]

    def each(self) -> list[MissingRun]:
        """Return a run for each of the corruptions."""
        several = self.corruption if isinstance(self.corruption, tuple) else [self.corruption]
        return [replace(self, corruption=one) for one in several]

    def failed(self, error: str, missing: bool) -> Failure:
        """Return the record of its failure."""
        return Failure(
            self.row.method,
            str(self.dataset["name"]),
            {
                "method": dict(self.arguments),
                "dataset": dict(self.dataset),
                "corruption": self.corruption,
                "views": self.views,
                "seed": self.seed,
                "device": self.device,
                "load": None,
                "changed": dict(self.arguments),
                "overrides": self.options(),
            },
            error,
            machine.describe_machine("cpu", 1),
            missing,
        )


def _listed(names: str | tuple[str, ...]) -> str:
    return names if isinstance(names, str) else f"[{','.join(names)}]"


def _written(value: Any) -> str:
    """Return an option's value in the words of the command line."""
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":")).replace('"', "")


def _flat(arguments: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield arguments, those of mappings by dotted names."""
    for name, value in arguments.items():
        if isinstance(value, Mapping) and value:
            yield from ((f"{name}.{inner}", given) for inner, given in _flat(value))
        else:
            yield name, value


def fill(
    wanted: Sequence[MissingRun],
    options: Sequence[str],
    store: Store,
    compose: Compose,
    executor: Executor | None = None,
    watch: Watch | None = None,
) -> list[JobResult]:
    """Make the runs that are not stored yet, by an executor or one after the other; returns how each ended.

    `options` of the command line are those of all runs. For a run that is stored no process is started, nor for one
    whose published weights cannot be had. What is missing for the first seed of a row is missing for the others, which
    are not tried if it is known by then. A failure is stored, never raised. `watch` is told how it goes.
    """
    executor, watch = executor or SerialExecutor(), watch or Watch()
    shown = _Shown(wanted) if sys.stderr.isatty() and len(wanted) > 1 else None
    filling = _Filling(wanted, options, store, compose, shown, executor.is_distributed)
    cells = filling.cells()
    first = list(itertools.islice(cells, 1))
    if first:
        watch.before_first(wanted[first[0][0]])
    heard = shown.heard if shown else None
    with shown.table if shown else nullcontext():
        for number, result in run_all(executor, itertools.chain(first, cells), Callbacks(filling.begin, heard)):
            filling.end(number, result)
            watch.after_each()
    return [filling.results[number] for number in range(len(wanted))]


@dataclass(frozen=True)
class Watch:
    """What is called while runs are made: before the first process starts, and after each that has ended."""

    before_first: Callable[[MissingRun], None] = lambda _: None
    after_each: Callable[[], None] = lambda: None


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


class _Filling:
    """Which of the wanted runs a process has to make, and how all of them end."""

    def __init__(
        self,
        wanted: Sequence[MissingRun],
        options: Sequence[str],
        store: Store,
        compose: Compose,
        shown: _Shown | None,
        elsewhere: bool,
    ) -> None:
        """Compare with the store as it is when the first run is asked for."""
        self._wanted, self._options, self._store = wanted, options, store
        self._shelf, self._weights = StoredRuns(store, options, compose), _Weights(options, compose)
        self._shown, self._elsewhere = shown, elsewhere
        self._missing: dict[tuple[str, str, str], JobResult] = {}
        self.results: dict[int, JobResult] = {}

    def cells(self) -> Iterator[Numbered]:
        """Yield the runs that a process has to make, by their numbers; the others end at once."""
        for number, run in enumerate(self._wanted):
            result, found = self._missing.get(_known(run)), None
            if result is None:
                found = self._shelf.find(run)
                result = JobResult(0) if found else None
            if result is None:
                result = self._unmade(run)
            if result is None:
                yield number, [*run.options(), *self._options, f"results={self._store.root}"]
            else:
                self._end(number, result, found)

    def begin(self, number: int, host: str) -> None:
        """Tell that a process makes a run."""
        if self._shown is not None:
            self._shown.begin(number, host)
        else:
            self._say(number, f" on {host}" * self._elsewhere)

    def end(self, number: int, result: JobResult) -> None:
        """Take how a process ended; a failure that it has not stored is stored."""
        run, found = self._wanted[number], None
        if result.code and not result.recorded and not isinstance(run.corruption, tuple):
            options = [*run.options(), *self._options]
            failure = lost(options, result) if result.code == 1 else run.failed(result.error, result.missing)
            result = _stored(failure, self._store, result.code)
        if self._shown is not None and result.key:
            found = self._store.find(str(run.dataset["name"]), run.row.method, result.key)
        self._end(number, result, found)
        if self._shown is None and self._elsewhere:
            logger.info("%d of %d done", len(self.results), len(self._wanted))

    def _end(self, number: int, result: JobResult, found: Run | None) -> None:
        self.results[number] = result
        if result.missing:
            self._missing[_known(self._wanted[number])] = result
        if self._shown is not None:
            self._shown.end(number, result, found)

    def _unmade(self, run: MissingRun) -> JobResult | None:
        """Return how a run ends that no process can make; None if one has to tell."""
        known = registry.entries("method")
        if run.row.method not in known:
            return _stored(run.failed(f"there is no method {run.row.method} here yet", missing=True), self._store)
        if run.device != "cpu" and "device" not in known[run.row.method].options:
            return JobResult(0)
        if known[run.row.method].needs_weights and (lacking := self._weights.lacking(run)):
            return _stored(run.failed(lacking, missing=True), self._store)
        return None

    def _say(self, number: int, where: str = "") -> None:
        run = self._wanted[number]
        logger.info("[%d/%d] %s%s", number + 1, len(self._wanted), _title(run), where)


def _known(run: MissingRun) -> tuple[str, str, str]:
    return run.row.name, run.title, run.device


def _title(run: MissingRun) -> str:
    return f"{run.row.name} on {run.title}, seed {run.seed}, {run.device}"


class _Shown:
    """The live table of what is filled: recall and query rate of each row and dataset, as they are stored."""

    def __init__(self, wanted: Sequence[MissingRun]) -> None:
        """Show a row and a column for each that is wanted."""
        rows, columns = (dict.fromkeys(run.row.name for run in wanted), dict.fromkeys(map(_column, wanted)))
        self.table = LiveTable([*rows], [*columns], len(wanted))
        self._wanted = wanted
        self._numbers: dict[tuple[str, str], list[tuple[float | None, float | None]]] = {}

    def begin(self, number: int, host: str) -> None:
        """Show that a run has begun on a host."""
        run = self._wanted[number]
        self.table.show(run.row.name, _column(run), "runs", "cyan")
        self.table.begin(number, _title(run), host)

    def heard(self, _: int, line: str) -> None:
        """Show a line of a process above the table."""
        if line:
            self.table.line(line, "red" if line.startswith("vprbench: ") else "")

    def end(self, number: int, result: JobResult, found: Run | None) -> None:
        """Show what a run has come to."""
        cell = (self._wanted[number].row.name, _column(self._wanted[number]))
        if result.code:
            self.table.show(*cell, *(("not there", "dim") if result.missing else ("failed", "red")))
        elif found is not None:
            numbers = self._numbers.setdefault(cell, [])
            first = recall_at(found.outcome, 1)
            batch = best_batch(found.timing.offline) if found.timing else None
            rate = StageRates.offline(batch).total if batch else None
            numbers.append((first.expected if first else None, rate))
            recalls, rates = ([each for each in column if each is not None] for column in zip(*numbers, strict=True))
            words = [f"{format_percent(mean(recalls))} %" if recalls else "undefined"]
            words.append(f"{format_rate(mean(rates))} Hz" if rates else "not timed")
            self.table.show(*cell, "  ".join(words))
        else:
            self.table.show(*cell, "-", "dim")
        self.table.end(number, bool(result.code and not result.missing))


def _column(run: MissingRun) -> str:
    return run.title if run.device == "cpu" else f"{run.title}, {run.device}"


def _stored(failure: Failure, store: Store, code: int = 2) -> JobResult:
    store.prepare()
    store.save_failure(failure)
    return JobResult(code, failure.missing, failure.error, recorded=True)


def results_folder(results: str) -> Path:
    """Return the folder of a store as an absolute path, so that processes elsewhere find it."""
    return Path(results).expanduser().absolute()

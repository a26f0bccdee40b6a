"""Runs that the table and the figures want and the store lacks, each made in a process of its own."""

from __future__ import annotations

import itertools
import logging
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import mean
from typing import Any

from vprbench.api.weights import Weights, find_weights
from vprbench.config import make_request
from vprbench.errors import BadInput, NotThere
from vprbench.jobs.executors import Executor, Numbered, run_all
from vprbench.jobs.job import JobResult, failure_of
from vprbench.metrics.accuracy import recall_at
from vprbench.paper.plan import Row
from vprbench.paper.stored_runs import StoredRuns
from vprbench.plugins import registry
from vprbench.runs.record import Run
from vprbench.runs.request import RunRequest
from vprbench.runs.run_files import content_key
from vprbench.runs.stopwatch import StageRates, best_batch
from vprbench.runs.store import Store
from vprbench.terminal.live import LiveTable
from vprbench.text import format_percent, format_rate

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Cell:
    """One run of a table: a row on a dataset, with a seed and a device."""

    row: Row
    title: str  # of the dataset, for people
    request: RunRequest
    error: str = ""  # why no process can make it
    missing: bool = False  # whether that is because its method is not there

    def each(self) -> list[Cell]:
        """Return a cell for each of its corruptions."""
        return [replace(self, request=self.request.with_corruption(name)) for name in self.request.corruptions]


def make_cell(row: Row, title: str, options: Sequence[str], values: Mapping[str, Any]) -> Cell:
    """Return a run of a row; one whose method is unknown, or whose options do not fit, says so in its `error`.

    Args:
        row: the method and its arguments.
        title: the title of the dataset.
        options: of the command line, those of the dataset among them.
        values: more options by their dotted names, as seed and device.
    """
    arguments = {f"method.{name}": value for name, value in _flatten(row.arguments)}
    known = row.method in registry.entries("method")
    try:
        if known:
            return Cell(row, title, make_request([*options, f"method={row.method}"], {**values, **arguments}))
        error = f"there is no method {row.method} here yet"
    except BadInput as refused:
        error = str(refused)
    given = dict(row.arguments)
    nobody = {"method_name": row.method, "method": given, "changed": given, "tuned_on": {}}
    return Cell(row, title, make_request(options, values, nobody), error, missing=not known)


def _flatten(arguments: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield arguments, those of mappings by dotted names."""
    for name, value in arguments.items():
        if isinstance(value, Mapping) and value:
            yield from ((f"{name}.{inner}", given) for inner, given in _flatten(value))
        else:
            yield name, value


def fill(
    wanted: Sequence[Cell], store: Store, executor: Executor | None = None, watch: Watch | None = None
) -> list[JobResult]:
    """Make the runs that are not stored yet, by an executor or one after the other; returns how each ended.

    For a run that is stored no process is started, nor for one whose published weights cannot be had. What is missing
    for the first seed of a row is missing for the others, which are not tried if it is known by then. A failure is
    stored, never raised. `watch` is told how it goes.
    """
    executor, watch = executor or Executor(), watch or Watch()
    shown = _Shown(wanted, executor.name) if sys.stderr.isatty() and len(wanted) > 1 else None
    filling = _Filling(wanted, store, shown, executor.is_distributed)
    cells = filling.cells()
    first = list(itertools.islice(cells, 1))
    if first:
        watch.before_first(wanted[first[0][0]])
    hear = shown.hear if shown else None
    with shown.table if shown else nullcontext():
        for number, result in run_all(executor, itertools.chain(first, cells), filling.begin, hear):
            filling.end(number, result)
            watch.after_each()
    return [filling.results[number] for number in range(len(wanted))]


@dataclass(frozen=True)
class Watch:
    """Functions that are called while runs are made: before the first process starts, and after each that has ended."""

    before_first: Callable[[Cell], None] = lambda _: None
    after_each: Callable[[], None] = lambda: None


class _Weights:
    """The published weights that rows need, looked for once, and fetched if that is possible."""

    def __init__(self) -> None:
        """Look for none yet."""
        self._errors: dict[tuple[str, str], str] = {}

    def lacking(self, cell: Cell) -> str:
        """Return why those of a run cannot be had; nothing if they are there, or if its process has to tell."""
        arguments = cell.request.method
        known = (cell.row.method, content_key(cell.row.arguments))
        if known not in self._errors:
            self._errors[known] = ""
            try:
                wanted = registry.check_value("method.weights", arguments["weights"], Weights)
                find_weights(wanted, arguments["_target_"].rpartition(".")[2])
            except NotThere as error:
                logger.warning("%s: %s", cell.row.name, error)
                self._errors[known] = str(error)
            except (Exception, SystemExit) as error:  # whatever a plug-in raises, or an option that does not fit
                logger.debug("the weights of %s are left to a process: %s", cell.row.name, error)
        return self._errors[known]


class _Filling:
    """Which of the wanted runs a process has to make, and how all of them end."""

    def __init__(self, wanted: Sequence[Cell], store: Store, shown: _Shown | None, elsewhere: bool) -> None:
        """Compare with the store as it is when the first run is asked for."""
        self._wanted, self._store = wanted, store
        self._shelf, self._weights = StoredRuns(store), _Weights()
        self._shown, self._elsewhere = shown, elsewhere
        self._missing: dict[tuple[str, str, str], JobResult] = {}
        self.results: dict[int, JobResult] = {}

    def cells(self) -> Iterator[Numbered]:
        """Yield the runs that a process has to make, by their numbers; the others end at once."""
        for number, cell in enumerate(self._wanted):
            result, found = self._missing.get(_known(cell)), None
            if result is None and not cell.error:
                found = self._shelf.find(cell.request)
                result = JobResult(0) if found else None
            if result is None:
                result = self._end_without_process(cell)
            if result is None:
                yield number, cell.request
            else:
                self._end(number, result, found)

    def begin(self, number: int) -> None:
        """Tell that a process makes a run."""
        if self._shown is not None:
            self._shown.begin(number)
        else:
            logger.info("[%d/%d] %s", number + 1, len(self._wanted), _title(self._wanted[number]))

    def end(self, number: int, result: JobResult) -> None:
        """Take how a process ended, and store its failure."""
        request, found = self._wanted[number].request, None
        if result.code and not isinstance(request.corruption, list):  # of several each is tried again alone
            self._save_failure(request, result)
        if self._shown is not None and result.key:
            found = self._store.find(request.dataset_name, request.method_name, result.key)
        self._end(number, result, found)
        if self._shown is None and self._elsewhere:
            logger.info("%d of %d done", len(self.results), len(self._wanted))

    def _end(self, number: int, result: JobResult, found: Run | None) -> None:
        self.results[number] = result
        if result.missing:
            self._missing[_known(self._wanted[number])] = result
        if self._shown is not None:
            self._shown.end(number, result, found)

    def _end_without_process(self, cell: Cell) -> JobResult | None:
        """Return how a run ends that no process can make; None if one has to tell."""
        entry = registry.entries("method").get(cell.row.method)
        if entry is not None and cell.request.device != "cpu" and "device" not in entry.options:
            return JobResult(0)
        lacking = cell.error
        if not lacking and entry is not None and entry.needs_weights:
            lacking = self._weights.lacking(cell)
        if not lacking:
            return None
        result = JobResult(2, lacking, missing=cell.missing or not cell.error)
        self._save_failure(cell.request, result)
        return result

    def _save_failure(self, request: RunRequest, result: JobResult) -> None:
        self._store.prepare()
        self._store.save_failure(failure_of(request, result))


def _known(cell: Cell) -> tuple[str, str, str]:
    return cell.row.name, cell.title, cell.request.device


def _title(cell: Cell) -> str:
    return f"{cell.row.name} on {cell.title}, seed {cell.request.seed}, {cell.request.device}"


class _Shown:
    """The live table of what is filled: recall and query rate of each row and dataset, as they are stored."""

    def __init__(self, wanted: Sequence[Cell], host: str) -> None:
        """Show a row and a column for each that is wanted; runs are made on `host`."""
        rows, columns = (dict.fromkeys(cell.row.name for cell in wanted), dict.fromkeys(map(_column, wanted)))
        self.table = LiveTable([*rows], [*columns], len(wanted))
        self._wanted, self._host = wanted, host
        self._numbers: dict[tuple[str, str], list[tuple[float | None, float | None]]] = {}

    def begin(self, number: int) -> None:
        """Show that a run has begun."""
        cell = self._wanted[number]
        self.table.show(cell.row.name, _column(cell), "runs", "cyan")
        self.table.begin(number, _title(cell), self._host)

    def hear(self, _: int, line: str) -> None:
        """Show a line of a process above the table."""
        if line:
            self.table.line(line, "red" if line.startswith("vprbench: ") else "")

    def end(self, number: int, result: JobResult, found: Run | None) -> None:
        """Show what a run has come to."""
        at = (self._wanted[number].row.name, _column(self._wanted[number]))
        if result.code:
            self.table.show(*at, *(("not there", "dim") if result.missing else ("failed", "red")))
        elif found is not None:
            numbers = self._numbers.setdefault(at, [])
            first = recall_at(found.outcome, 1)
            batch = best_batch(found.timing.offline) if found.timing else None
            rate = StageRates.offline(batch).total if batch else None
            numbers.append((first.expected if first else None, rate))
            recalls, rates = ([each for each in column if each is not None] for column in zip(*numbers, strict=True))
            words = [f"{format_percent(mean(recalls))} %" if recalls else "undefined"]
            words.append(f"{format_rate(mean(rates))} Hz" if rates else "not timed")
            self.table.show(*at, "  ".join(words))
        else:
            self.table.show(*at, "-", "dim")
        self.table.end(number, bool(result.code and not result.missing))


def _column(cell: Cell) -> str:
    return cell.title if cell.request.device == "cpu" else f"{cell.title}, {cell.request.device}"


def results_folder(results: str) -> Path:
    """Return the folder of a store as an absolute path, so that processes elsewhere find it."""
    return Path(results).expanduser().absolute()

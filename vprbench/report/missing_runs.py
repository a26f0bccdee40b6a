"""Runs that the table and the figures want and the store lacks, each made in a process of its own."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.jobs.executors import Executor, Numbered, run_all
from vprbench.jobs.job import JobResult, describe_failure
from vprbench.plugins import registry
from vprbench.report.plan import Row
from vprbench.report.stored_runs import StoredRuns
from vprbench.runs.request import RunRequest
from vprbench.runs.store import Store
from vprbench.terminal.live import LiveTable

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Cell:
    """One run of a table: a row on a dataset, with a seed and a device."""

    row: Row
    title: str  # of the dataset, for people
    request: RunRequest
    error: str = ""  # why no process can make it
    missing: bool = False  # whether that is because its method is not there

    @property
    def column(self) -> str:
        """The title of its dataset, with the device if that is not the CPU."""
        return self.title if self.request.device == "cpu" else f"{self.title}, {self.request.device}"

    def each(self) -> list[Cell]:
        """Return a cell for each of its corruptions."""
        return [replace(self, request=self.request.with_corruption(name)) for name in self.request.corruptions]


def make_cell(row: Row, title: str, options: Sequence[str], values: Mapping[str, Any]) -> Cell:
    """Return a run of a row; one whose method is unknown, or whose options do not fit, says so in its `error`.

    Args:
        row: the method and its arguments.
        title: the title of the dataset.
        options: of the command line, with the dataset's.
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
    """Yield arguments; a value inside a mapping has a dotted name."""
    for name, value in arguments.items():
        if isinstance(value, Mapping) and value:
            yield from ((f"{name}.{inner}", given) for inner, given in _flatten(value))
        else:
            yield name, value


def make_missing_runs(wanted: Sequence[Cell], store: Store, executor: Executor | None = None) -> list[JobResult]:
    """Make the runs that are not stored yet, by an executor or one after the other; returns the outcome of each.

    For a run that is stored no process is started, nor for a seed once weights or frames are missing for another seed
    of the row. A failure is stored, never raised.
    """
    executor = executor or Executor()
    stored = StoredRuns(store)
    missing: dict[tuple[str, str], JobResult] = {}  # by row and column
    results: dict[int, JobResult] = {}
    rows, columns = dict.fromkeys(cell.row.name for cell in wanted), dict.fromkeys(cell.column for cell in wanted)
    is_shown = sys.stderr.isatty() and len(wanted) > 1
    table = LiveTable([*rows], [*columns], len(wanted)) if is_shown else None

    def begin(number: int) -> None:
        cell = wanted[number]
        title = f"{cell.row.name} on {cell.title}, seed {cell.request.seed}, {cell.request.device}"
        if table is None:
            logger.info("[%d/%d] %s", number + 1, len(wanted), title)
        else:
            table.show(cell.row.name, cell.column, "runs", "cyan")
            table.begin(number, title)

    def hear(line: str) -> None:
        if line and table is not None:
            table.line(line, "red" if line.startswith("vprbench: ") else "")

    def end(number: int, result: JobResult) -> None:
        cell = wanted[number]
        results[number] = result
        is_known = (cell.row.name, cell.column) in missing
        is_retried = isinstance(cell.request.corruption, list)  # each of the corruptions in a process of its own
        if result.failure is not None and not is_known and not is_retried:
            store.prepare()
            store.save_failure(result.failure)
        if result.missing:
            missing[cell.row.name, cell.column] = result
        if table is not None:
            word = ("not there", "dim") if result.missing else ("failed", "red") if result.code else ("done", "")
            table.show(cell.row.name, cell.column, *word)
            table.end(number, bool(result.code and not result.missing))
        elif executor.is_distributed:
            logger.info("%d of %d done", len(results), len(wanted))

    def list_missing() -> Iterator[Numbered]:
        for number, cell in enumerate(wanted):
            result = missing.get((cell.row.name, cell.column)) or _end_without_process(cell, stored)
            if result is None:
                yield number, cell.request
            else:
                end(number, result)

    with table.shown() if table else nullcontext():
        for number, result in run_all(executor, list_missing(), begin, hear if table else None):
            end(number, result)
    return [results[number] for number in range(len(wanted))]


def _end_without_process(cell: Cell, stored: StoredRuns) -> JobResult | None:
    """Return the outcome of a run that is stored or that no process can make; None for a run to be made."""
    entry = registry.entries("method").get(cell.row.method)
    if entry is not None and cell.request.device != "cpu" and "device" not in entry.options:
        return JobResult(0)
    if cell.error:
        return JobResult(2, describe_failure(cell.request, cell.error, cell.missing))
    return JobResult(0) if stored.holds(cell.request) else None


def resolve_results_folder(results: str) -> Path:
    """Return the folder of a store as an absolute path, so that processes elsewhere find it."""
    return Path(results).expanduser().absolute()

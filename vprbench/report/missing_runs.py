"""Runs that a table, a comparison or figures lack: those that are stored are found, the others made in processes."""

from __future__ import annotations

import contextlib
import io
import logging
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from vprbench.api.dataset import Dataset
from vprbench.jobs.executors import Executor, Numbered, run_all
from vprbench.jobs.job import JobResult
from vprbench.plugins import registry
from vprbench.progress import show_progress
from vprbench.report.plan import Row
from vprbench.runs.experiment import build_experiment, corrupt_experiment
from vprbench.runs.get_or_run import find_run
from vprbench.runs.identity import hash_content
from vprbench.runs.request import RunRequest
from vprbench.runs.store import Store
from vprbench.runs.thumbnails import load_thumbnails
from vprbench.terminal.live import LiveTable

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Cell:
    """One run of a table: a row on a dataset, with a seed and a device."""

    row: Row
    title: str  # of the dataset, for people
    request: RunRequest

    @property
    def column(self) -> str:
        """The title of its dataset, with the device if that is not the CPU."""
        return self.title if self.request.device == "cpu" else f"{self.title}, {self.request.device}"

    @property
    def words(self) -> str:
        """The run as a line for people."""
        facts = [f"seed {self.request.seed}", self.request.device, *self.request.corruptions]
        return f"{self.row.name} on {self.title}, {', '.join(facts)}"


def make_missing_runs(wanted: Sequence[Cell], store: Store, executor: Executor | None = None) -> list[JobResult]:
    """Make the runs that are not stored yet, by an executor or one after the other; returns the outcome of each.

    For a run that is stored no process is started, nor for a row in a column where its weights or frames are missing. A
    failure is stored, never raised.
    """
    executor, datasets = executor or Executor(), dict[str, Dataset]()
    results: dict[int, JobResult] = {}
    missing: dict[tuple[str, str], JobResult] = {}  # by row and column
    rows, columns = dict.fromkeys(cell.row.name for cell in wanted), dict.fromkeys(cell.column for cell in wanted)
    is_shown = sys.stderr.isatty() and len(wanted) > 1
    table = LiveTable([*rows], [*columns], len(wanted)) if is_shown else None

    def begin(number: int) -> None:
        cell = wanted[number]
        if table is None:
            logger.info("[%d/%d] %s", number + 1, len(wanted), cell.words)
        else:
            table.show(cell.row.name, cell.column, "runs", "cyan")
            table.begin(number, cell.words)

    def hear(line: str) -> None:
        if line and table is not None:
            table.line(line, "red" if line.startswith("vprbench: ") else "")

    def end(number: int, result: JobResult) -> None:
        cell = wanted[number]
        results[number] = result
        is_known = result is missing.get((cell.row.name, cell.column))
        if result.failure is not None and not is_known and not isinstance(cell.request.corruption, list):
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
            result = missing.get((cell.row.name, cell.column))
            if result is None and _is_stored(cell.request, store, datasets):
                result = JobResult(0)
            if result is None:
                yield number, cell.request
            else:
                end(number, result)

    with table.shown() if table else contextlib.nullcontext():
        for number, result in run_all(executor, list_missing(), begin, hear if table else None):
            end(number, result)
    return [results[number] for number in range(len(wanted))]


def _is_stored(request: RunRequest, store: Store, datasets: dict[str, Dataset]) -> bool:
    """Tell whether a process would find the run of a request, for each of its corruptions, with nothing to add.

    Nothing is built if the method has no stored run; `datasets` that were built are kept. False for whatever raises an
    error here: a process tells it.
    """
    if request.force or not any(store.root.glob(f"*/{request.method_name}-*")):
        return False
    key = hash_content(request.dataset)
    try:
        with contextlib.redirect_stdout(io.StringIO()), show_progress(request.dataset_name):
            if key not in datasets:
                datasets[key] = registry.make_dataset(request.dataset)
            clean = build_experiment(request, datasets[key])
            several = request.corruption if isinstance(request.corruption, list) else []
            return all(
                find_run(one, store) is not None
                and not (request.frames and load_thumbnails(store.root, one.fingerprint) is None)
                for one in [corrupt_experiment(clean, name) for name in several] or [clean]
            )
    except (Exception, SystemExit) as error:  # whatever a plug-in raises
        logger.debug("whether %s is stored is left to a process: %s", request.method_name, error)
        return False


def resolve_results_folder(results: str) -> Path:
    """Return the folder of a store as an absolute path, so that processes elsewhere find it."""
    return Path(results).expanduser().absolute()

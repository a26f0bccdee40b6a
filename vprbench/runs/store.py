"""The store of runs on disk: several processes may write to it at once, a reader finds whole runs alone."""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from vprbench.errors import BadInput
from vprbench.runs import run_lock
from vprbench.runs.record import Failure, Run
from vprbench.runs.run_files import (
    SUMMARY,
    DamagedRunError,
    OtherLayoutError,
    content_key,
    find_arrays,
    load,
    read_failure,
    write,
    write_failure,
)
from vprbench.storage import atomic

logger = logging.getLogger(__name__)


class Store:
    """A results folder: `<dataset>/<method>-<key>/` holds one run. Several processes may write to it at once."""

    def __init__(self, root: Path) -> None:
        """Use the folder `root`, where nothing is written yet."""
        self.root = root
        self._damaged: set[Path] = set()  # folders that a warning has named

    def prepare(self, dataset: str = "") -> None:
        """Make the folder, and see that it and the folder of a dataset can be written.

        Raises BadInput before work is wasted on a run.
        """
        folder = self.root
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self.remove_leftovers()
            for folder in (self.root, self.root / dataset):
                if os.path.lexists(folder):  # a link may lead to a disk that is not there
                    probe = atomic.unfinished(folder)
                    probe.mkdir()
                    probe.rmdir()
        except OSError as error:
            raise BadInput(
                f"results={self.root}: {folder} cannot be written ({error.strerror or error}): "
                "choose another folder with results=..."
            ) from error

    def folder(self, dataset: str, method: str, key: str) -> Path:
        """Return where a run with this key lies, or would lie."""
        return self.root / dataset / f"{method}-{key}"

    def find(self, dataset: str, method: str, key: str) -> Run | None:
        """Return the stored run with this key; a damaged one is named in a warning and counts as absent."""
        folder = self.folder(dataset, method, key)
        try:
            return self._load(folder)
        except OtherLayoutError as error:
            logger.warning("%s is left as it is: %s", folder, error)
            return None

    def runs(self) -> Iterator[Run]:
        """Yield every whole run; damaged ones are named in warnings, and never keep the others from being read."""
        others = 0  # of earlier and later versions
        for folder in self._folders():
            try:
                run = self._load(folder)
            except OtherLayoutError:
                others += 1
                continue
            if run is not None:
                yield run
        if others:
            logger.warning("%s: %d runs of another version of vprbench are left as they are", self.root, others)

    def failures(self) -> Iterator[Failure]:
        """Yield every stored failure; a damaged one is named in a warning and left out."""
        for folder in self._folders():
            failure = read_failure(folder)
            if failure is not None:
                yield failure

    def save(self, run: Run) -> Path:
        """Store a run, replacing one with the same key; raises BadInput if the disk refuses, or a run cannot be."""
        folder = self.folder(run.dataset, run.method, run.key)
        try:
            _place(folder, lambda partial: write(run, partial))
            shutil.rmtree(self._failure_folder(run.method, run.dataset, run.config), ignore_errors=True)
        except ValueError as error:
            raise BadInput(f"the run cannot be stored: {error}; mend the method or dataset that gave it") from error
        except OSError as error:
            raise BadInput(
                f"the run could not be stored in {folder} ({error.strerror or error}): nothing was left there; "
                "make room or choose another folder with results=..."
            ) from error
        return folder

    def save_failure(self, failure: Failure) -> Path:
        """Store that a run ended in an error, until a run of the same configuration succeeds."""
        folder = self._failure_folder(failure.method, failure.dataset, failure.config)
        try:
            _place(folder, lambda partial: write_failure(failure, partial))
        except OSError as error:
            raise BadInput(f"the failure could not be stored in {folder} ({error.strerror or error})") from error
        return folder

    def try_to_save_failure(self, failure: Failure) -> None:
        """Store a failure if the disk takes it; the caller reports the error in any case."""
        with contextlib.suppress(OSError, BadInput):
            self.save_failure(failure)

    def remove_leftovers(self) -> None:
        """Remove locks that nobody holds, and unfinished files that nobody has written to for a day."""
        run_lock.remove_leftovers(self.root)
        atomic.remove_leftovers(self.root)
        with contextlib.suppress(OSError):
            for dataset in _list_folders(self.root):
                atomic.remove_leftovers(dataset)

    def _folders(self) -> Iterator[Path]:
        """Yield the folders of all datasets, by dataset and name; a warning names each that cannot be read."""
        try:
            datasets = _list_folders(self.root)
        except FileNotFoundError:
            return
        except OSError as error:
            raise BadInput(f"results={self.root} cannot be read ({error.strerror or error})") from error
        for dataset in datasets:
            try:
                yield from _list_folders(dataset)
            except OSError as error:
                logger.warning("%s cannot be read (%s): its runs are left out", dataset, error.strerror or error)

    def _load(self, folder: Path) -> Run | None:
        """Read the run of a folder; None if there is none or, with a warning, none whole. Raises OtherLayoutError.

        A run that is not whole is read again, for another process may have replaced it meanwhile.
        """
        reason = ""
        for _ in range(2):
            try:
                return load(folder) if (folder / SUMMARY).exists() else None
            except (DamagedRunError, OSError) as error:
                reason = str(error)
        if folder not in self._damaged:
            self._damaged.add(folder)
            logger.warning("%s cannot be used and is left out: %s", folder, reason)
        return None

    def _failure_folder(self, method: str, dataset: str, config: Mapping[str, Any]) -> Path:
        wanted = {name: config.get(name) for name in ("method", "dataset", "seed", "device", "load")}
        for name in ("corruption", "views"):
            if config.get(name):
                wanted[name] = config[name]
        return self.root / dataset / f"{method}-failed-{content_key(wanted)}"


def _place(folder: Path, fill: Callable[[Path], None]) -> None:
    """Let `fill` write files into a folder beside `folder`, and move them there, the summary last.

    A reader finds the earlier run until the summary is replaced, and the new one from then on.
    """
    partial = atomic.unfinished(folder.parent)
    earlier = find_arrays(folder)
    try:
        partial.mkdir(parents=True)
        fill(partial)
        folder.mkdir(exist_ok=True)
        for path in sorted(partial.iterdir(), key=lambda path: path.name == SUMMARY):
            path.replace(folder / path.name)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    if earlier is not None and earlier != find_arrays(folder):
        with contextlib.suppress(OSError):  # under Windows, a process reads it
            earlier.unlink()


def _list_folders(parent: Path) -> list[Path]:
    """Return the folders in a folder, sorted; names that begin with a dot are no datasets or runs."""
    return sorted(path for path in parent.iterdir() if not path.name.startswith(".") and path.is_dir())

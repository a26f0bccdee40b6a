"""The store of runs on disk: several processes may write to it at once, a reader finds whole runs alone."""

from __future__ import annotations

import contextlib
import logging
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from vprbench.errors import BadInput
from vprbench.runs import run_files
from vprbench.runs.identity import hash_content
from vprbench.runs.record import Failure, Run
from vprbench.runs.run_files import FAILURE, SUMMARY, DamagedRunError, OtherLayoutError
from vprbench.storage import atomic

logger = logging.getLogger(__name__)


class Store:
    """A results folder: `<dataset>/<method>-<key>/` holds one run. Several processes may write to it at once."""

    def __init__(self, root: Path) -> None:
        """Use the folder `root`, where nothing is written yet."""
        self.root = root
        self._damaged: set[Path] = set()  # folders that a warning has named

    def prepare(self, dataset: str = "") -> None:
        """Make the folder, and that of a dataset; raises BadInput if nothing can be written, before a run is made."""
        folder = self.root
        try:
            for folder in (self.root, self.root / dataset):
                folder.mkdir(parents=True, exist_ok=True)
            probe = atomic.name_unfinished(folder)
            probe.mkdir()
            probe.rmdir()
        except OSError as error:
            raise BadInput(
                f"results={self.root}: {folder} cannot be written ({error.strerror or error}): "
                "choose another folder with results=..."
            ) from error
        self.remove_leftovers()

    def folder(self, dataset: str, method: str, key: str) -> Path:
        """Return where a run with this key lies, or would lie."""
        return self.root / dataset / f"{method}-{key}"

    def find(self, dataset: str, method: str, key: str) -> Run | None:
        """Return the stored run with this key; a damaged one is named in a warning and counts as absent."""
        folder = self.folder(dataset, method, key)
        try:
            return run_files.load(folder) if (folder / SUMMARY).exists() else None
        except (DamagedRunError, OSError) as error:
            self._warn_of_damage(folder, error)
            return None

    def runs(self) -> Iterator[Run]:
        """Yield every whole run; damaged ones are named in warnings, and never keep the others from being read."""
        others = 0  # of earlier and later versions
        for summary in self._find_files(SUMMARY):
            try:
                yield run_files.load(summary.parent)
            except OtherLayoutError:
                others += 1
            except DamagedRunError as error:
                self._warn_of_damage(summary.parent, error)
        if others:
            logger.warning("%s: %d runs of another version of vprbench are left as they are", self.root, others)

    def failures(self) -> Iterator[Failure]:
        """Yield every stored failure; a damaged one is named in a warning and left out."""
        found = (run_files.read_failure(path) for path in self._find_files(FAILURE))
        return (failure for failure in found if failure is not None)

    def save(self, run: Run) -> Path:
        """Store a run, replacing one with the same key; raises BadInput if the disk refuses, or a run cannot be."""
        folder = self.folder(run.dataset, run.method, run.key)
        _write_folder(folder, lambda partial: run_files.write(run, partial))
        shutil.rmtree(self._failure_folder(run.method, run.dataset, run.config), ignore_errors=True)
        return folder

    def save_failure(self, failure: Failure) -> Path:
        """Store that a run ended in an error, until a run of the same configuration succeeds; raises BadInput."""
        folder = self._failure_folder(failure.method, failure.dataset, failure.config)
        _write_folder(folder, lambda partial: run_files.write_failure(failure, partial))
        return folder

    def try_to_save_failure(self, failure: Failure) -> None:
        """Store a failure if the disk takes it; the caller reports the error in any case."""
        with contextlib.suppress(BadInput):
            self.save_failure(failure)

    def remove_leftovers(self) -> None:
        """Remove unfinished files that nobody has written to for a day."""
        for folder in (self.root, *self.root.glob("[!.]*/")):
            atomic.remove_leftovers(folder)

    def _find_files(self, name: str) -> list[Path]:
        """Return the files of this name of all runs and failures, by dataset and folder."""
        return sorted(self.root.glob(f"[!.]*/[!.]*/{name}"))

    def _warn_of_damage(self, folder: Path, error: Exception) -> None:
        if folder not in self._damaged:
            logger.warning("%s cannot be used and is left out: %s", folder, error)
        self._damaged.add(folder)

    def _failure_folder(self, method: str, dataset: str, config: Mapping[str, Any]) -> Path:
        names = ("method", "dataset", "seed", "device", "load", "corruption", "views")
        key = hash_content({name: config.get(name) for name in names})
        return self.root / dataset / f"{method}-failed-{key}"


def _write_folder(folder: Path, fill: Callable[[Path], None]) -> None:
    """Let `fill` write files into a folder beside `folder`, and move them there, the summary last.

    A reader finds the earlier run until the summary is replaced, and the new one from then on. Raises BadInput.
    """
    partial = atomic.name_unfinished(folder.parent)
    try:
        partial.mkdir(parents=True)
        fill(partial)
        folder.mkdir(exist_ok=True)
        moved = [path.replace(folder / path.name) for path in sorted(partial.iterdir())]  # arrays before run.json
        for earlier in {*folder.glob("arrays-*")} - {*moved}:
            earlier.unlink(missing_ok=True)
    except ValueError as error:
        raise BadInput(f"the run cannot be stored: {error}; mend the method or dataset that gave it") from error
    except OSError as error:
        raise BadInput(
            f"{folder} cannot be written ({error.strerror or error}): nothing was left there; "
            "make room or choose another folder with results=..."
        ) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)

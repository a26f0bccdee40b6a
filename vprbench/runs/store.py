"""The store of runs on disk: several processes may write to it at once, a reader finds whole runs alone."""

from __future__ import annotations

import contextlib
import errno
import logging
import os
import shutil
import tempfile
import time
import uuid
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
    UnreadableRunError,
    content_key,
    load,
    read_failure,
    write,
    write_failure,
)
from vprbench.storage.atomic import PARTIAL, REPLACED, move_folder, remove_leftovers, unfinished

logger = logging.getLogger(__name__)

_DAMAGED = ".damaged"
_FAILURE_KEYS = 3  # the layout whose number is in the key of a failure: what failed under it is still found


class Store:
    """A results folder: `<dataset>/<method>-<key>/` holds one run. Several processes may write to it at once."""

    def __init__(self, root: Path, read_only: bool = False) -> None:
        """Use the folder `root`, where nothing is written yet, or never where it is only read."""
        self.root = root
        self.read_only = read_only

    def prepare(self) -> None:
        """Make the folder and see that it can be written; raises BadInput before work is wasted on a run."""
        self._require_writing()
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            self.remove_leftovers()
            self._partial().rmdir()
        except OSError as error:
            raise BadInput(
                f"results={self.root} cannot be written ({error.strerror or error}): "
                "choose another folder with results=..."
            ) from error

    def now(self) -> float:
        """Return the time in seconds by the clock of the disk; that of this machine where nothing can be written."""
        try:
            with tempfile.TemporaryFile(prefix=PARTIAL, dir=self.root) as probe:
                return os.fstat(probe.fileno()).st_mtime
        except OSError:
            return time.time()

    def folder(self, dataset: str, method: str, key: str) -> Path:
        """Return where a run with this key lies, or would lie."""
        return self.root / dataset / f"{method}-{key}"

    def find(self, dataset: str, method: str, key: str) -> Run | None:
        """Return the stored run with this key; a damaged one is set aside by name and counts as absent."""
        folder = self.folder(dataset, method, key)
        try:
            return self._load(folder)
        except OtherLayoutError as error:
            logger.warning("%s is left as it is: %s", folder, error)
            return None

    def runs(self) -> Iterator[Run]:
        """Yield every whole run; damaged ones are named and set aside, and never keep the others from being read."""
        others = 0  # of earlier and later versions
        for folder in self._folders():
            try:
                run = self._load(folder, SUMMARY)
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
        self._require_writing()
        folder = self.folder(run.dataset, run.method, run.key)
        try:
            self._place(folder, lambda partial: write(run, partial))
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
        self._require_writing()
        folder = self._failure_folder(failure.method, failure.dataset, failure.config)
        try:
            self._place(folder, lambda partial: write_failure(failure, partial))
        except OSError as error:
            raise BadInput(f"the failure could not be stored in {folder} ({error.strerror or error})") from error
        return folder

    def try_to_save_failure(self, failure: Failure) -> None:
        """Store a failure if the disk takes it; the error itself is told in any case."""
        with contextlib.suppress(OSError, BadInput):
            self.root.mkdir(parents=True, exist_ok=True)
            self.save_failure(failure)

    def failure(
        self, method: str, dataset: str, config: Mapping[str, Any], since: float | None = None
    ) -> Failure | None:
        """Return how the last run of this configuration failed; None if it did not, or only before `since`.

        `since` is in seconds, by the clock of the disk.
        """
        folder = self._failure_folder(method, dataset, config)
        with contextlib.suppress(OSError):
            return read_failure(folder) if since is None or folder.stat().st_mtime >= since else None
        return None

    def _folders(self) -> Iterator[Path]:
        """Yield the folders of all datasets, by dataset and name; those that cannot be read are named in a warning."""
        try:
            datasets = _visible(self.root)
        except OSError as error:
            raise BadInput(f"results={self.root} cannot be read ({error.strerror or error})") from error
        for dataset in datasets:
            try:
                yield from _visible(dataset)
            except OSError as error:
                logger.warning("%s cannot be read (%s): its runs are left out", dataset, error.strerror or error)

    def _require_writing(self) -> None:
        if self.read_only:
            raise RuntimeError(f"the store {self.root} was opened to be read only")

    def _load(self, folder: Path, part: str = "") -> Run | None:
        """Read the run of a folder that has this part; one that another process replaces meanwhile is read again.

        A damaged one is set aside; one that cannot be read is named, and left where it is. Raises OtherLayoutError.
        """
        try:
            while (before := identity(folder, part)) is not None:
                try:
                    return load(folder)
                except DamagedRunError as error:
                    if identity(folder) == before:
                        self._set_aside(folder, str(error))
                        return None
        except UnreadableRunError as error:
            logger.warning("%s cannot be read (%s): it is left out, and left as it is", folder, error)
        return None

    def _failure_folder(self, method: str, dataset: str, config: Mapping[str, Any]) -> Path:
        asked = {name: config.get(name) for name in ("method", "dataset", "seed", "device", "load")}
        if config.get("corruption"):
            asked["corruption"] = config["corruption"]
        if config.get("views"):
            asked["views"] = config["views"]
        return self.root / dataset / f"{method}-failed-{content_key({'schema': _FAILURE_KEYS, **asked})}"

    def _place(self, folder: Path, fill: Callable[[Path], None]) -> None:
        """Let `fill` write into a folder that no reader looks at, and put that in the place of `folder` at once."""
        partial = self._partial()
        try:
            fill(partial)
            move_folder(partial, folder)
        finally:
            shutil.rmtree(partial, ignore_errors=True)

    def _partial(self) -> Path:
        """Make a folder that no reader looks at."""
        folder = unfinished(self.root)
        folder.mkdir()
        return folder

    def remove_leftovers(self) -> None:
        """Remove what killed processes left unfinished, and return runs whose replacement never arrived."""
        run_lock.remove_leftovers(self.root)
        for folder in self.root.glob(f"{PARTIAL}*{REPLACED}*"):
            with contextlib.suppress(OtherLayoutError, UnreadableRunError):  # it is left to whoever can read it
                self._put_back(folder)
        remove_leftovers(self.root)

    def _put_back(self, folder: Path) -> None:
        try:
            run = load(folder)
            folder.rename(self.folder(run.dataset, run.method, run.key))
        except DamagedRunError:  # no longer whole: its replacement has arrived
            shutil.rmtree(folder, ignore_errors=True)
        except OSError as error:
            if error.errno in (errno.ENOTEMPTY, errno.EEXIST):
                shutil.rmtree(folder, ignore_errors=True)

    def _set_aside(self, folder: Path, reason: str) -> None:
        if self.read_only:
            logger.warning("%s cannot be used (%s)", folder, reason)
            return
        aside = folder.with_name(f"{_DAMAGED}-{folder.name}-{uuid.uuid4().hex[:8]}")
        try:
            folder.rename(aside)
        except OSError:
            logger.warning("%s cannot be used (%s) and could not be set aside", folder, reason)
        else:
            logger.warning("%s cannot be used (%s): set aside as %s", folder, reason, aside.name)


def _visible(folder: Path) -> list[Path]:
    """Return the folders in a folder, by name, without those that no reader looks at."""
    try:
        return sorted(path for path in folder.iterdir() if not path.name.startswith(".") and path.is_dir())
    except FileNotFoundError:
        return []


def identity(folder: Path, part: str = "") -> tuple[int, int] | None:
    """Return what tells a folder from its replacement of the same name; None if there is none with this part."""
    try:
        (folder / part).stat()
        found = folder.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise UnreadableRunError(error.strerror or error) from error
    return found.st_ino, found.st_mtime_ns  # a number may be used again


def require_writable(folder: Path) -> None:
    """Raise BadInput for a folder that nothing can be written to, as a link to a disk that is not there; none is made.

    A folder that is missing will be made, if the one above it takes it.
    """
    if not os.path.lexists(folder):
        return
    try:
        tempfile.TemporaryDirectory(prefix=".partial-", dir=folder).cleanup()
    except OSError as error:
        raise BadInput(
            f"{folder} cannot be written ({error.strerror or error}), where the run would be stored: mend that, or "
            "choose another folder with results=..."
        ) from error

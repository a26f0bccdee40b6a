"""Partial trainings: finished parts of a long fit are kept on disk, so that an interrupted fit goes on from them."""

from __future__ import annotations

import hashlib
import json
import logging
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import Any

from safetensors.numpy import save

from vprbench.storage.atomic import PARTIAL, remove_leftovers, replace_bytes
from vprbench.storage.folders import cache_folder
from vprbench.storage.tensors import Array, Arrays, Seal, plain

logger = logging.getLogger(__name__)

FORMAT = 1
_FOLDER = "VPRBENCH_PARTIAL"  # environment variable
_PART = ".safetensors"  # how the names of files end
_SEAL = Seal("seconds", "sha256")  # the text about a part: how long it took
_FORGOTTEN_SECONDS = 30 * 86400.0
_ATTEMPTS = 5  # to write where another process removes the folder meanwhile


class Partial:
    """The parts of one training that are done, each a few arrays under a name; several threads may share it.

    A damaged file or a full disk costs the kept parts, never the training.
    """

    def __init__(self, folder: Path, clock: Callable[[], float]) -> None:
        """Take over what an interrupted run has left in `folder`."""
        self._folder = folder
        self._clock = clock
        self._last = clock()  # when the last part was kept
        self._one_at_a_time = threading.Lock()
        self._refused = False
        self._taken: dict[str, float] = {}  # seconds that other runs spent, by part that this run has asked for
        self._own: dict[str, float] = {}  # seconds that this run spent on the parts that it kept
        remove_leftovers(folder)

    @property
    def seconds(self) -> float:
        """The wall time that interrupted runs had spent on the parts that this run has asked for."""
        return sum(self._taken.values())

    def get(self, name: str) -> dict[str, Array] | None:
        """Return the arrays of a part; None if it is not there, or was damaged, and then is removed."""
        path = self._path(name)
        with self._one_at_a_time:
            try:
                arrays, seconds = _read(path)
            except FileNotFoundError:
                self._taken.pop(name, None)
                return None
            except (OSError, ValueError) as error:
                self._discard(path, error)
                return None
            if name not in self._own:
                self._taken[name] = seconds
            return arrays

    def put(self, name: str, arrays: Arrays) -> None:
        """Keep a part, whole or not at all, in place of an earlier one of that name.

        With it is stored the time since the last part was kept. Raises ValueError for a name that is no file's
        (letters, digits, '_', '.' and '-') and TypeError for anything but numpy arrays of numbers.
        """
        path = self._path(name)
        numbers = {key: plain(array, key) for key, array in arrays.items()}
        with self._one_at_a_time:
            if self._refused:
                return
            now = self._clock()
            own = self._own.get(name, 0.0) + now - self._last
            try:
                _write(path, numbers, self._taken.get(name, 0.0) + own)
            except OSError as error:
                self._refused = True
                logger.warning(
                    "the training cannot be kept in %s (%s): it goes on, but an interruption would cost the rest",
                    self._folder,
                    error.strerror or error,
                )
            else:
                self._own[name], self._last = own, now

    def start(self) -> None:
        """Count time from now on."""
        self._last = self._clock()

    def remove(self) -> None:
        """Remove all parts."""
        _remove(self._folder)

    def _discard(self, path: Path, error: Exception) -> None:
        self._taken.pop(path.name.removesuffix(_PART), None)
        logger.warning("%s cannot be used (%s): that part is trained anew", path, error)
        if isinstance(error, ValueError):  # damaged; what only could not be read now may be whole
            with suppress(OSError):
                path.unlink()

    def _path(self, name: str) -> Path:
        if re.fullmatch(r"\w[\w.-]*", name) is None:
            raise ValueError(f"{name!r} names no part: give letters, digits, '_', '.' and '-'")
        return self._folder / f"{name}{_PART}"


class Resumed:
    """The trainings of one run: the parts that they took over, and the folders to remove once all is done."""

    def __init__(self) -> None:
        self._opened: dict[Path, Partial] = {}
        self._done: set[Path] = set()

    @property
    def seconds(self) -> float:
        """The wall time that interrupted runs had spent on the parts that the trainings took over."""
        return sum(kept.seconds for kept in self._opened.values())

    def open(self, folder: Path, clock: Callable[[], float]) -> Partial:
        """Return the parts in a folder; a second training of the same run goes on with its own parts."""
        if folder not in self._opened:
            self._opened[folder] = Partial(folder, clock)
        return self._opened[folder]

    def done(self, folder: Path) -> None:
        """Take note that a training has ended."""
        self._done.add(folder)

    def remove(self) -> None:
        """Remove the parts of the trainings that have ended."""
        for folder in self._done:
            self._opened[folder].remove()


_running: ContextVar[Resumed | None] = ContextVar("trainings_of_a_run", default=None)


@contextmanager
def ledger() -> Iterator[Resumed]:
    """Collect the trainings inside the block, and keep their parts until the block ends.

    So a run that is killed in a later training, or before its result is stored, loses none of the earlier ones. A
    ledger inside another one is the same.
    """
    outer = _running.get()
    if outer is not None:
        yield outer
        return
    resumed = Resumed()
    token = _running.set(resumed)
    try:
        yield resumed
    finally:
        _running.reset(token)
    resumed.remove()


@contextmanager
def training(
    what: Mapping[str, Any], folder: Path | None = None, clock: Callable[[], float] = time.perf_counter
) -> Iterator[Partial]:
    """Open the kept parts of a training, and remove them once the block has ended without an error.

    `what` (plain JSON) is all that decides about the outcome: only a training with an equal `what` is resumed. `folder`
    holds the trainings, one folder for each: by default VPRBENCH_PARTIAL, or one in the user's cache. A training that
    nobody continued for 30 days is removed. Several processes may do the same training: each file is replaced whole.
    """
    root = partial_folder() if folder is None else folder
    text = json.dumps({"format": FORMAT, "what": what}, sort_keys=True)
    home = root / hashlib.sha256(text.encode()).hexdigest()
    with ledger() as run:
        _remove_forgotten(root, home)
        kept = run.open(home, clock)
        kept.start()
        yield kept
        run.done(home)


def partial_folder() -> Path:
    """Return the folder that keeps partial trainings: VPRBENCH_PARTIAL, or one in the user's cache."""
    return cache_folder(_FOLDER, "partial")


def _write(path: Path, arrays: Arrays, seconds: float) -> None:
    stated = repr(seconds)
    content = save(dict(arrays), _SEAL.metadata(stated, arrays))
    for attempt in range(_ATTEMPTS):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            replace_bytes(path, content)
            return
        except FileNotFoundError:  # another process has ended the same training, and removed the folder
            if attempt == _ATTEMPTS - 1:
                raise


def _read(path: Path) -> tuple[dict[str, Array], float]:
    """Return the arrays of a file and the seconds spent on them; raises ValueError if it is damaged."""
    stated, arrays, whole = _SEAL.read(path)
    if stated is None or not whole:
        raise ValueError("it is not what was written")
    return arrays, float(stated)


def _remove_forgotten(root: Path, wanted: Path) -> None:
    """Remove the trainings that nobody went on with, but for the one that is wanted now."""
    with suppress(OSError):
        for folder in root.iterdir():
            if folder != wanted and re.fullmatch(r"[0-9a-f]{64}", folder.name):
                with suppress(OSError):
                    if time.time() - folder.stat().st_mtime > _FORGOTTEN_SECONDS:
                        _remove(folder)


def _remove(folder: Path) -> None:
    """Remove a training; files that are none of ours stay, and their folder with them."""
    with suppress(OSError):
        for path in folder.iterdir():
            if path.name.startswith(PARTIAL) or path.name.endswith(_PART):
                path.unlink(missing_ok=True)
        folder.rmdir()

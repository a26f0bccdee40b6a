"""Runs claimed in the store: which process makes which run now, so that no two make the same one at the same time."""

from __future__ import annotations

import atexit
import contextlib
import fcntl
import hashlib
import json
import logging
import os
import re
import tempfile
import time
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread
from typing import Any, Self

from vprbench import ending
from vprbench.storage import owner
from vprbench.storage.atomic import PARTIAL, remove_leftovers

logger = logging.getLogger(__name__)

FOLDER = ".claims"  # within a results folder: a file for each run that is being made
BEAT_SECONDS = 5.0  # between two signs of life
EXPIRES_SECONDS = 60.0  # without one; a process of the same host is asked for itself
_LOOK_EVERY = 1.0  # seconds between looks at a claim that is waited for
_STAGE_LENGTH = 60  # letters
_ROOM = 13 * _STAGE_LENGTH  # bytes of a file that a stage may fill: it is written over in one piece


@dataclass(frozen=True)
class Held:
    """A claim as it lies in the store."""

    path: Path
    words: Mapping[str, Any]  # of its owner; none while it begins to write, or if it died meanwhile
    beat_ns: int  # its last sign of life, by the clock of the disk
    silent_seconds: float  # since then
    alive: bool  # False: the next one who wants the run takes it over

    @property
    def whose(self) -> str:
        """The owner, for people."""
        word = self.words.get
        return f"{word('owner', 'somebody')} on {word('host', 'some host')} (process {word('process', 'unknown')})"


class Claim:
    """A claim of this process, let go at the end of the block; where nobody waits for the process a thread beats."""

    def __init__(self, path: Path, words: Mapping[str, Any], size: int) -> None:
        """Hold what was written to a file of `size` bytes, 0 if it could not be."""
        self.path, self._words, self._size = path, words, size
        self._told = ("", 0.0)
        self._over = Event()

    def __enter__(self) -> Self:
        """Begin to beat, where nobody does."""
        if not ending.waited_for() and self._size:
            Thread(target=self._beat, name="claim", daemon=True).start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Let go; in a process that is waited for not before it has stored its failure, if it has one."""
        if kind is not None and issubclass(kind, Exception) and ending.waited_for():
            atexit.register(self.release)
        else:
            self.release()

    def kept(self) -> bool:
        """Tell whether the run is still this process's to make: nobody thought it dead and took it over."""
        with contextlib.suppress(FileNotFoundError):
            return not self._size or _words(self.path)[0].get("token") == self._words["token"]
        return False

    def tell(self, stage: str, done: float) -> None:
        """Let others read how far the run is; a stage that goes on is written now and then."""
        now = time.monotonic()
        if stage == self._told[0] and now - self._told[1] < BEAT_SECONDS:
            return
        self._told = stage, now
        words = {**self._words, "stage": stage[:_STAGE_LENGTH], "done": round(done, 3)}
        with contextlib.suppress(OSError):
            if self._size and self.kept():
                _write(self.path, os.O_WRONLY, _text(words, self._size))

    def release(self) -> None:
        """Take the claim away, if it is still this process's; a fork of it takes nothing away."""
        self._over.set()
        if self._words["process"] != os.getpid():
            return
        with contextlib.suppress(OSError):
            if self._size and self.kept():
                self.path.unlink()
                self.path.parent.rmdir()

    def _beat(self) -> None:
        while not self._over.wait(BEAT_SECONDS):
            beat(self.path)


class HeldElsewhereError(Exception):
    """Another process makes the run now."""

    def __init__(self, key: str, claim: Path, whose: str) -> None:
        """Name the run, and hold the claim on it."""
        super().__init__(f"{key} is being made by {whose}")
        self.claim = claim


class Claims:
    """The claims of one results folder, `.claims/`; nothing is made of it before there is one."""

    def __init__(self, root: Path) -> None:
        """Look at the results folder `root`."""
        self.folder = root.absolute() / FOLDER  # a method may change the working folder

    def take(self, key: str, about: Mapping[str, Any]) -> Claim | Held:
        """Claim the run `key`, with what others may read `about` it, or return who has it; never waits.

        Of several processes one gets it. The claim of a dead one is taken over. Where nothing can be claimed a warning
        says so, and the run is made all the same.
        """
        path = self._path(key)
        words = {"token": uuid.uuid4().hex, "key": key, "about": dict(about), "since": time.time()}
        words |= owner.this_process()
        if ending.waited_for():
            words["parent_started"] = owner.started(os.getppid())
        text = _text(words, 0)
        ending.tell(claim=str(path))  # whoever waits for this process beats, and clears away what it leaves
        try:
            for _ in range(100):
                with contextlib.suppress(FileExistsError, FileNotFoundError):  # or the folder was just removed
                    self.folder.mkdir(parents=True, exist_ok=True)
                    _write(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, text)
                    return Claim(path, words, len(text))
                held = look(path)
                if held is not None and held.alive:
                    return held
                if held is not None:
                    _take_away(held)
            raise OSError("others take it over all the time")
        except OSError as error:
            reason = error.strerror or error
            logger.warning("%s cannot be claimed (%s): another process may make it at the same time", key, reason)
            return Claim(path, words, 0)

    def held(self) -> list[Held]:
        """Return all claims, those of the dead too, by their names."""
        with contextlib.suppress(OSError):
            files = sorted(path for path in self.folder.iterdir() if not path.name.startswith(PARTIAL))
            return [held for held in map(look, files) if held is not None]
        return []

    def tidy(self) -> None:
        """Take away the claims of the dead, and what was left by whoever died while it took one away."""
        with contextlib.suppress(OSError):
            for held in self.held():
                if not held.alive:
                    _take_away(held)
            remove_leftovers(self.folder)
            self.folder.rmdir()

    def now(self) -> float:
        """Return the time by the clock of the disk."""
        return _disk_clock(self.folder.parent)

    def _path(self, key: str) -> Path:
        name = re.sub(r"[^A-Za-z0-9_-]+", "-", key)[-150:]  # and whatever stands in a key, no two share a name
        return self.folder / f"{name}-{hashlib.sha256(key.encode(errors='surrogateescape')).hexdigest()[:8]}"


def look(path: Path) -> Held | None:
    """Return the claim that lies in a file, None if there is none."""
    try:
        words, beat_ns = _words(path)
    except OSError:  # it is gone, or the disk is
        return None
    silent = max(0.0, _disk_clock(path.parent) - beat_ns / 1e9)
    lives = owner.lives(words)
    waits = {**words, "process": words.get("parent"), "started": words.get("parent_started", -1)}
    if lives is False and owner.lives(waits):  # it stores the failure of the dead one, and then clears its claim away
        lives = None
    return Held(path, words, beat_ns, silent, silent <= EXPIRES_SECONDS if lives is None else lives)


def is_held(path: Path | str) -> bool:
    """Tell whether a living process holds this claim: once it does not, its run is stored, or free to be made."""
    held = look(Path(path))
    return held is not None and held.alive


def wait(path: Path | str) -> None:
    """Wait until nobody alive holds this claim."""
    while is_held(path):
        time.sleep(_LOOK_EVERY)


def beat(path: Path | str) -> None:
    """Give a sign of life for a claim of this process, or of one that it started and waits for; no other is touched."""
    with contextlib.suppress(OSError):
        words, _ = _words(Path(path))
        if owner.is_ours(words):
            os.utime(path)


def clear(path: Path | str) -> None:
    """Take a claim away if its owner is dead, as that of a process that was waited for until it ended."""
    held = look(Path(path))
    with contextlib.suppress(OSError):
        if held is not None and not held.alive:
            _take_away(held)
            held.path.parent.rmdir()


def _take_away(held: Held) -> None:
    """Remove a dead claim, under the lock of its file, unless it has come to life since or was taken over.

    Two may remove it where a disk has no locks; who was removed by mistake notices before it stores.
    """
    mode = "r+b" if os.access(held.path, os.W_OK) else "rb"  # a shared disk locks what may be written
    with contextlib.suppress(FileNotFoundError), held.path.open(mode) as file:  # another process was faster
        with contextlib.suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
        if _words(held.path) == (held.words, held.beat_ns):
            held.path.unlink()


def _words(path: Path) -> tuple[dict[str, Any], int]:
    """Return what a claim says, nothing if it is not all there, and its last sign of life; raises OSError."""
    try:
        with path.open("rb") as file:  # opened before its time is asked for: a shared disk then tells the newest
            found, beat_ns = json.loads(file.read()), os.fstat(file.fileno()).st_mtime_ns
    except (ValueError, PermissionError):
        return {}, path.stat().st_mtime_ns
    return found if isinstance(found, dict) else {}, beat_ns


def _text(words: Mapping[str, Any], size: int) -> bytes:
    """Return what a file of `size` bytes, or of a new one with room for a stage, says."""
    text = json.dumps({"stage": "begins", "done": 0.0, **words}).encode()
    return text.ljust(size or len(text) + _ROOM)


def _write(path: Path, flags: int, text: bytes) -> None:
    """Write a claim in one piece, so that nobody reads a part of it; one that is made and refused is removed."""
    number = os.open(path, flags, 0o666)
    try:
        os.write(number, text)
    except OSError:
        if flags & os.O_CREAT:
            path.unlink()
        raise
    finally:
        os.close(number)


def _disk_clock(folder: Path) -> float:
    """Return the time by the clock of a disk; that of this machine where nothing can be written."""
    try:
        with tempfile.TemporaryFile(prefix=PARTIAL, dir=folder) as probe:
            return os.fstat(probe.fileno()).st_mtime
    except OSError:
        return time.time()

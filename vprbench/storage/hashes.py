"""SHA-256 of files, computed once: kept in a small database for as long as a file stays as it is."""

from __future__ import annotations

import logging
import os
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from hashlib import file_digest
from pathlib import Path
from time import time_ns
from typing import NamedTuple, TypeVar

from vprbench import progress
from vprbench.errors import BadInput
from vprbench.storage.cores import core_count
from vprbench.storage.folders import cache_folder

logger = logging.getLogger(__name__)

_FOLDER = "VPRBENCH_HASHES"  # environment variable
_DATABASE = "files-1.sqlite3"  # the number is that of its layout
_TABLE = "CREATE TABLE IF NOT EXISTS files (path BLOB PRIMARY KEY, state TEXT, sha256 BLOB) WITHOUT ROWID"
_LOOK_UP = "SELECT sha256 FROM files WHERE path = ? AND state = ?"
_KEEP = "INSERT OR REPLACE INTO files VALUES (?, ?, ?)"
_DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
_PATIENCE_SECONDS = 5.0  # for what another process writes
_JUST_NOW_NS = 2_000_000_000  # the coarsest clock of a common file system, FAT's, ticks every two seconds
_ATTEMPTS = 3  # to read a file that does not change meanwhile
_BATCH = 256  # files whose hashes are kept together
_SHA256_BYTES = 32
Answer = TypeVar("Answer")


@dataclass(frozen=True, slots=True)
class FileHash:
    """What a file holds, in short."""

    size_bytes: int
    sha256: bytes  # 32 of them


class _State(NamedTuple):
    """What the file system says of a file; its hash holds for as long as the state stays the same."""

    size_bytes: int
    modified_ns: int
    changed_ns: int  # of its metadata too, which nobody can set back; on Windows, when it was made
    inode: int

    def __str__(self) -> str:
        return " ".join(map(str, self))

    def is_fresh(self, now_ns: int) -> bool:
        """Tell whether the file changed just now: another change might leave the same times."""
        return any(abs(now_ns - then) < _JUST_NOW_NS for then in (self.modified_ns, self.changed_ns))


class FileHashes:
    """The hashes of files, kept in a folder; several threads and processes may share it.

    A database that is damaged, locked or not to be written costs what was kept and never the run: it is said once.
    """

    def __init__(self, folder: Path, clock_ns: Callable[[], int] = time_ns) -> None:
        """Keep hashes in `folder`, which is made when it is first needed."""
        self._path = folder / _DATABASE
        self._clock_ns = clock_ns
        self._refused = False
        self._remembered: dict[Path, tuple[_State, bytes]] = {}  # for this process alone, since the database refused

    def of(self, paths: Sequence[Path]) -> list[FileHash]:
        """Return the hash of each file; those that are not known are read, by as many threads as there are cores.

        A file is known while its absolute path, size, inode and times of modification and of change stay the same. One
        that changed within two seconds before it was read is not kept, for it could change again at the same time.
        Raises BadInput if a file cannot be read, or changes while it is read.
        """
        absolute = [path.absolute() for path in paths]
        states = {path: _state(path) for path in absolute}  # each file once
        if not states:
            return []
        known = self._ask(lambda database: _look_up(database, states))
        if known is None:
            known = {path: sha256 for path, (state, sha256) in self._remembered.items() if state == states.get(path)}
        found = {path: FileHash(states[path].size_bytes, sha256) for path, sha256 in known.items()}
        found |= self._read([path for path in states if path not in found])
        return [found[path] for path in absolute]

    def _read(self, paths: Sequence[Path]) -> dict[Path, FileHash]:
        """Read files and keep their hashes, batch by batch."""
        found: dict[Path, FileHash] = {}
        readers = ThreadPoolExecutor(core_count())
        try:
            for start in range(0, len(paths), _BATCH):
                batch = paths[start : start + _BATCH]
                now_ns = self._clock_ns()
                done = dict(zip(batch, readers.map(_read_file, batch), strict=True))
                self._keep({path: read for path, read in done.items() if not read[0].is_fresh(now_ns)})
                found |= {path: FileHash(state.size_bytes, sha256) for path, (state, sha256) in done.items()}
                if len(paths) > _BATCH:  # fewer take no time worth telling
                    progress.report("hashing frames", len(found) / len(paths))
        finally:
            readers.shutdown(cancel_futures=True)
        return found

    def _keep(self, hashes: Mapping[Path, tuple[_State, bytes]]) -> None:
        rows = [(os.fsencode(path), str(state), sha256) for path, (state, sha256) in hashes.items()]
        if self._ask(lambda database: database.executemany(_KEEP, rows)) is None:
            self._remembered |= hashes

    def _ask(self, question: Callable[[sqlite3.Connection], Answer]) -> Answer | None:
        """Put a question to the database, once more to a new database if it was damaged; None once it has refused."""
        if self._refused:
            return None
        try:
            try:
                return self._connect(question)
            except sqlite3.DatabaseError as error:
                if getattr(error, "sqlite_errorcode", 0) & 0xFF not in _DAMAGED:
                    raise
                logger.warning("%s is damaged (%s): hashes of files are kept anew", self._path, error)
                for ending in ("", "-wal", "-shm"):
                    self._path.with_name(f"{_DATABASE}{ending}").unlink(missing_ok=True)
                return self._connect(question)
        except (sqlite3.Error, OSError) as error:
            self._refused = True
            logger.warning("no hashes of files are kept in %s (%s): the next run reads them again", self._path, error)
            return None

    def _connect(self, question: Callable[[sqlite3.Connection], Answer]) -> Answer:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with closing(sqlite3.connect(self._path, timeout=_PATIENCE_SECONDS)) as database, database:
            with suppress(sqlite3.OperationalError):  # another process is about to do the same
                database.execute("PRAGMA journal_mode=WAL")
            database.execute("PRAGMA synchronous=NORMAL")
            database.execute(_TABLE)
            return question(database)


def file_hashes(paths: Sequence[Path]) -> list[FileHash]:
    """Return the hash of each file, from the folder that VPRBENCH_HASHES names or one in the user's cache.

    Raises BadInput if a file cannot be read, or changes while it is read.
    """
    return _shared(hashes_folder()).of(paths)


def content_hash(path: Path) -> str:
    """Return the SHA-256 of one file as hexadecimal digits; raises what `file_hashes` raises."""
    return file_hashes([path])[0].sha256.hex()


def hashes_folder() -> Path:
    """Return the folder that keeps the hashes of files: VPRBENCH_HASHES, or one in the user's cache."""
    return cache_folder(_FOLDER, "hashes")


@cache
def _shared(folder: Path) -> FileHashes:
    return FileHashes(folder, time_ns)


def _look_up(database: sqlite3.Connection, states: Mapping[Path, _State]) -> dict[Path, bytes]:
    """Return what is kept of files in this state."""
    found = {}
    for path, state in states.items():
        for (sha256,) in database.execute(_LOOK_UP, (os.fsencode(path), str(state))):
            if isinstance(sha256, bytes) and len(sha256) == _SHA256_BYTES:
                found[path] = sha256
    return found


def _state(path: Path, opened: int | None = None) -> _State:
    """Return the state of a file, of the one that is open under its path if given; raises BadInput if there is none."""
    with _error_told(path):
        found = os.stat(path if opened is None else opened)  # noqa: PTH116 - of an open file too
    return _State(found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino)


def _read_file(path: Path) -> tuple[_State, bytes]:
    """Return the state that a file was read in, and its SHA-256; raises BadInput if it cannot be read."""
    for _ in range(_ATTEMPTS):
        with _error_told(path), path.open("rb", buffering=0) as file:
            before = _state(path, file.fileno())
            sha256 = file_digest(file, "sha256").digest()
            if _state(path, file.fileno()) == before:
                return before, sha256
    raise BadInput(f"{path} changes while it is read: wait until it is written, then run again")


@contextmanager
def _error_told(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise BadInput(f"{path} cannot be read ({error.strerror}): restore the file") from error

"""SHA-256 of files, computed once: kept in a small database for as long as a file stays as it is."""

from __future__ import annotations

import logging
import os
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import cache
from hashlib import file_digest
from pathlib import Path
from time import time_ns
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.errors import BadInput
from vprbench.storage.cores import core_count
from vprbench.storage.folders import cache_folder
from vprbench.storage.paths import Paths

logger = logging.getLogger(__name__)

_FOLDER = "VPRBENCH_HASHES"  # environment variable
_DATABASE = "files-1.sqlite3"  # the number is that of its layout
_TABLE = "CREATE TABLE IF NOT EXISTS files (path BLOB PRIMARY KEY, state TEXT, sha256 BLOB) WITHOUT ROWID"
_BETWEEN = "SELECT path, state, sha256 FROM files WHERE path BETWEEN ? AND ? LIMIT ?"
_KEEP = "INSERT OR REPLACE INTO files VALUES (?, ?, ?)"
_DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
_PATIENCE_SECONDS = 5.0  # for what another process writes
_JUST_NOW_NS = 2_000_000_000  # the coarsest clock of a common file system, FAT's, ticks every two seconds
_ATTEMPTS = 3  # to read a file that does not change meanwhile
_BATCH = 256  # files whose hashes are kept together
_ASKED = 4096  # files that are looked up together
_SPARSE = 4  # times as many files kept between them as are asked for, from which each is looked up on its own
_SHA256_BYTES = 32
_UNKNOWN = bytes(_SHA256_BYTES)
_Read: TypeAlias = tuple[os.stat_result, bytes]  # in which state, and the hash
Answer = TypeVar("Answer")


class FileHash(NamedTuple):
    """What a file holds, in short."""

    size_bytes: int
    sha256: bytes  # 32 of them


@dataclass(frozen=True, eq=False)
class HashedFiles:
    """What files hold, in short, in little memory."""

    sizes: npt.NDArray[np.int64]  # (n,), bytes
    sha256: bytes  # of all files, joined

    def __len__(self) -> int:
        """Return the number of files."""
        return len(self.sizes)

    def __getitem__(self, index: int) -> FileHash:
        """Return the hash of one file."""
        at = range(len(self))[index] * _SHA256_BYTES
        return FileHash(int(self.sizes[index]), self.sha256[at : at + _SHA256_BYTES])

    def digest_parts(self) -> Iterator[bytes]:
        """Yield what changes with the size or the content of any of the files, in parts."""
        for first in range(0, len(self), _ASKED):
            sizes = self.sizes[first : first + _ASKED].tolist()
            starts = range(first * _SHA256_BYTES, len(self.sha256), _SHA256_BYTES)
            hashes = (self.sha256[start : start + _SHA256_BYTES] for start in starts)
            yield b"".join([b"%d%b" % each for each in zip(sizes, hashes, strict=False)])


class FileHashes:
    """The hashes of files, kept in a folder; several threads and processes may share it.

    A database that is damaged, locked or not to be written costs what was kept and never the run: it is said once.
    """

    def __init__(self, folder: Path, clock_ns: Callable[[], int] = time_ns) -> None:
        """Keep hashes in `folder`, which is made when it is first needed."""
        self._path = folder / _DATABASE
        self._clock_ns = clock_ns
        self._refused = False
        self._remembered: dict[bytes, tuple[str, bytes]] = {}  # for this process alone, since the database refused

    def of(self, paths: Sequence[Path]) -> HashedFiles:
        """Return the hash of each file; those that are not known are read, by as many threads as there are cores.

        A file is known while its absolute path, size, inode and times of modification and of change stay the same. One
        that changed within two seconds before it was read is not kept, for it could change again at the same time.
        Raises BadInput if a file cannot be read, or changes while it is read.
        """
        files = Paths.of(paths).absolute()
        order, which = files.distinct()
        sizes, found = np.zeros(len(order), np.int64), np.zeros((len(order), _SHA256_BYTES), np.uint8)
        unknown: list[int] = []
        for start in range(0, len(order), _ASKED):
            asked = files.encoded(order[start : start + _ASKED])
            states = _states(asked)
            known = self._known({path: _file_state(state) for path, state in zip(asked, states, strict=True)})
            unknown += (number for number, path in enumerate(asked, start) if path not in known)
            sizes[start : start + _ASKED] = [state.st_size for state in states]
            found[start : start + _ASKED] = _rows([known.get(path, _UNKNOWN) for path in asked])
        for numbers, done in self._read(files, order, unknown):
            sizes[numbers] = [state.st_size for state, _ in done]
            found[numbers] = _rows([sha256 for _, sha256 in done])
        return HashedFiles(sizes[which], found[which].tobytes())

    def _known(self, states: Mapping[bytes, str]) -> Mapping[bytes, bytes]:
        """Return the hashes that are kept of files in this state."""
        known = self._ask(lambda database: _look_up(database, states))
        if known is None:
            known = {path: sha256 for path, (state, sha256) in self._remembered.items() if state == states.get(path)}
        return known

    def _read(
        self, files: Paths, order: npt.NDArray[np.int64], unknown: Sequence[int]
    ) -> Iterator[tuple[Sequence[int], list[_Read]]]:
        """Read those of the files in order that are unknown, and keep their hashes, batch by batch."""
        readers = ThreadPoolExecutor(core_count())
        try:
            for start in range(0, len(unknown), _BATCH):
                batch = unknown[start : start + _BATCH]
                paths, now_ns = files.encoded(order[batch]), self._clock_ns()
                done = list(readers.map(_read_file, paths))
                self._keep({path: read for path, read in zip(paths, done, strict=True) if not _is_fresh(read, now_ns)})
                yield batch, done
                if len(unknown) > _BATCH:  # fewer take no time worth telling
                    progress.report("hashing frames", (start + len(batch)) / len(unknown))
        finally:
            readers.shutdown(cancel_futures=True)

    def _keep(self, hashes: Mapping[bytes, _Read]) -> None:
        rows = [(path, _file_state(state), sha256) for path, (state, sha256) in hashes.items()]
        if self._ask(lambda database: database.executemany(_KEEP, rows)) is None:
            self._remembered |= {path: (state, sha256) for path, state, sha256 in rows}

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


def file_hashes(paths: Sequence[Path]) -> HashedFiles:
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


def _look_up(database: sqlite3.Connection, states: Mapping[bytes, str]) -> dict[bytes, bytes]:
    """Return what is kept of files in this state."""
    most = _SPARSE * len(states)
    rows = database.execute(_BETWEEN, (min(states), max(states), most)).fetchall()
    if len(rows) == most:
        rows = [row for path in states for row in database.execute(_BETWEEN, (path, path, 1))]
    return {
        path: sha256
        for path, state, sha256 in rows
        if state == states.get(path) and isinstance(sha256, bytes) and len(sha256) == _SHA256_BYTES
    }


def _rows(hashes: Sequence[bytes]) -> npt.NDArray[np.uint8]:
    """Return hashes as an array, (n, 32)."""
    return np.frombuffer(b"".join(hashes), np.uint8).reshape(-1, _SHA256_BYTES)


def _states(paths: Iterable[bytes]) -> list[os.stat_result]:
    """Return what the file system says of files; raises BadInput if there is none."""
    try:
        return [os.stat(path) for path in paths]  # noqa: PTH116 - a Path for each takes longer than the look
    except OSError as error:
        raise _unreadable(error.filename, error) from error


def _file_state(state: os.stat_result) -> str:
    """Return what must stay the same of a file for its hash to hold.

    That are its size, the time of its last change, that of its metadata too, which nobody can set back (on Windows,
    when it was made), and its inode.
    """
    return f"{state.st_size} {state.st_mtime_ns} {state.st_ctime_ns} {state.st_ino}"


def _is_fresh(read: _Read, now_ns: int) -> bool:
    """Tell whether a file changed just now: another change might leave the same times."""
    return any(abs(now_ns - then) < _JUST_NOW_NS for then in (read[0].st_mtime_ns, read[0].st_ctime_ns))


def _read_file(path: bytes) -> _Read:
    """Return the state that a file was read in, and its SHA-256; raises BadInput if it cannot be read."""
    try:
        for _ in range(_ATTEMPTS):
            with Path(os.fsdecode(path)).open("rb", buffering=0) as file:
                before = os.fstat(file.fileno())
                sha256 = file_digest(file, "sha256").digest()
                if _file_state(os.fstat(file.fileno())) == _file_state(before):
                    return before, sha256
    except OSError as error:
        raise _unreadable(path, error) from error
    raise BadInput(f"{os.fsdecode(path)} changes while it is read: wait until it is written, then run again")


def _unreadable(path: bytes, error: OSError) -> BadInput:
    return BadInput(f"{os.fsdecode(path)} cannot be read ({error.strerror}): restore the file")

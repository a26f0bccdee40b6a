"""SHA-256 of files, computed once: a JSON file for each folder of files keeps them until a file changes."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.errors import BadInput
from vprbench.storage.atomic import replace_text
from vprbench.storage.cores import core_count
from vprbench.storage.folders import cache_folder
from vprbench.storage.paths import Paths

logger = logging.getLogger(__name__)

_FOLDER = "VPRBENCH_HASHES"  # environment variable
_SHA256_BYTES = 32
_REPORT_EVERY = 256  # files that are read
_TOGETHER = 4096  # files whose hashes are joined at once
_ENTRY = re.compile(r"(\d+) -?\d+ -?\d+ ([0-9a-f]{64})")  # size, mtime_ns and ctime_ns, hash


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
        for first in range(0, len(self), _TOGETHER):
            sizes = self.sizes[first : first + _TOGETHER].tolist()
            starts = range(first * _SHA256_BYTES, len(self.sha256), _SHA256_BYTES)
            hashes = (self.sha256[start : start + _SHA256_BYTES] for start in starts)
            yield b"".join([b"%d%b" % each for each in zip(sizes, hashes, strict=False)])


def file_hashes(paths: Sequence[Path]) -> HashedFiles:
    """Return the hash of each file; unknown files are read, by as many threads as there are cores.

    A file is known while its absolute path, its size and its times of modification and of change stay the same. Hashes
    lie in the folder that VPRBENCH_HASHES names, or in one in the user's cache. Where that cannot be written, files are
    read each time. Raises BadInput if a file cannot be read, or changes while it is read.
    """
    files = Paths.of(paths).absolute()
    sizes, hashes = np.zeros(len(files), np.int64), np.zeros((len(files), _SHA256_BYTES), np.uint8)
    done = 0
    readers = ThreadPoolExecutor(core_count())
    try:
        for folder, positions in files.in_folders():
            names = [files.names[position] for position in positions.tolist()]
            entries = _entries(folder, names, readers, partial(_report, len(files), done))
            sizes[positions] = [int(entry.partition(" ")[0]) for entry in entries]
            joined = bytes.fromhex("".join(entry.rpartition(" ")[2] for entry in entries))
            hashes[positions] = np.frombuffer(joined, np.uint8).reshape(-1, _SHA256_BYTES)
            done += len(names)
    finally:
        readers.shutdown(cancel_futures=True)
    return HashedFiles(sizes, hashes.tobytes())


def content_hash(path: Path) -> str:
    """Return the SHA-256 of one file as hexadecimal digits; raises what `file_hashes` raises."""
    return file_hashes([path])[0].sha256.hex()


def hashes_folder() -> Path:
    """Return the folder that keeps the hashes of files: VPRBENCH_HASHES, or one in the user's cache."""
    return cache_folder(_FOLDER, "hashes")


def _entries(
    folder: Path, names: Sequence[str], readers: ThreadPoolExecutor, report: Callable[[int], None]
) -> list[str]:
    """Return for each file of a folder its size, its times and its hash, as they are kept."""
    index = hashes_folder() / f"{hashlib.sha256(os.fsencode(folder)).hexdigest()[:32]}.json"
    kept = _read_index(index)
    unknown = [name for name, state in _file_states(folder, names).items() if not _is_known(kept.get(name), state)]
    for number, entry in enumerate(readers.map(lambda name: _read_file(folder, name), unknown)):
        kept[unknown[number]] = entry
        if (number + 1) % _REPORT_EVERY == 0:  # fewer take no time
            report(number + 1)
    if unknown:
        _write_index(index, folder, kept)
    return [kept[name] for name in names]


def _is_known(entry: object, state: str) -> bool:
    return isinstance(entry, str) and entry.startswith(f"{state} ") and _ENTRY.fullmatch(entry) is not None


def _read_index(path: Path) -> dict[str, str]:
    """Return the entries of a folder by the names of its files; none if there are none, or if the file is damaged."""
    try:
        files = json.loads(path.read_bytes())["files"]
        return dict(files)
    except OSError:
        return {}
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        logger.warning("%s cannot be used (%s): the files of that folder are hashed anew", path, error)
        return {}


def _write_index(path: Path, folder: Path, entries: dict[str, str]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_text(path, json.dumps({"folder": str(folder), "files": entries}))
    except OSError as error:
        _warn_once(path.parent, error.strerror or str(error))


@cache
def _warn_once(folder: Path, reason: str) -> None:
    logger.warning("no hashes of files are kept in %s (%s): files are read each time", folder, reason)


def _file_states(folder: Path, names: Sequence[str]) -> dict[str, str]:
    """Return the state of each file by its name; raises BadInput if there is none."""
    start = os.path.join(folder, "")  # noqa: PTH118 - a Path for each file takes longer than the look
    try:
        return {name: _file_state(os.stat(start + name)) for name in names}  # noqa: PTH116
    except OSError as error:
        raise _unreadable(error.filename, error) from error


def _file_state(found: os.stat_result) -> str:
    """Return the size of a file and its times of modification and of change, which nobody can set back."""
    return f"{found.st_size} {found.st_mtime_ns} {found.st_ctime_ns}"


def _read_file(folder: Path, name: str) -> str:
    """Return the entry of a file; raises BadInput if it cannot be read, or changes meanwhile."""
    path = folder / name
    try:
        with path.open("rb", buffering=0) as file:
            before = _file_state(os.fstat(file.fileno()))
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            after = _file_state(os.fstat(file.fileno()))
    except OSError as error:
        raise _unreadable(path, error) from error
    if after != before:
        raise BadInput(f"{path} changes while it is read: wait until it is written, then run again")
    return f"{before} {sha256}"


def _report(total: int, done: int, read: int) -> None:
    progress.report("hashing frames", (done + read) / total)


def _unreadable(path: Path | str, error: OSError) -> BadInput:
    return BadInput(f"{path} cannot be read ({error.strerror}): restore the file")

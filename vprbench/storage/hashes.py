"""SHA-256 of files, computed once: a JSON file for each folder of files keeps them until a file changes."""

from __future__ import annotations

import hashlib
import json
import logging
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from pathlib import Path

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

Entry = list[int | str]  # of a file: size in bytes, times of modification and of change in ns, SHA-256


@dataclass(frozen=True, eq=False)
class HashedFiles:
    """Sizes and hashes of files, in little memory."""

    sizes: npt.NDArray[np.int64]  # (n,), bytes
    sha256: bytes  # of all files, joined

    def __len__(self) -> int:
        """Return the number of files."""
        return len(self.sizes)

    def __getitem__(self, index: int) -> bytes:
        """Return the SHA-256 of one file, 32 bytes."""
        at = range(len(self))[index] * _SHA256_BYTES
        return self.sha256[at : at + _SHA256_BYTES]

    def digest_parts(self) -> Iterator[bytes]:
        """Yield bytes that change with the size or the content of any of the files."""
        for number, size in enumerate(self.sizes.tolist()):
            yield b"%d%b" % (size, self[number])


def file_hashes(paths: Sequence[Path]) -> HashedFiles:
    """Return the hash of each file; unknown files are read, by as many threads as there are cores.

    A file is known while its absolute path, its size and its times of modification and of change stay the same. Hashes
    lie in the folder that VPRBENCH_HASHES names, or in one in the user's cache. Where that cannot be written, files are
    read each time. Raises BadInput if a file cannot be read, or changes while it is read.
    """
    files = Paths.of(paths)
    sizes, hashes = np.zeros(len(files), np.int64), np.zeros((len(files), _SHA256_BYTES), np.uint8)
    done = 0
    readers = ThreadPoolExecutor(core_count())
    try:
        for folder, positions in files.in_folders():
            names = [files.names[position] for position in positions.tolist()]
            entries = _hash_folder(folder.absolute(), names, readers, done, len(files))
            sizes[positions] = [entry[0] for entry in entries]
            joined = bytes.fromhex("".join(str(entry[-1]) for entry in entries))
            hashes[positions] = np.frombuffer(joined, np.uint8).reshape(-1, _SHA256_BYTES)
            done += len(names)
    finally:
        readers.shutdown(cancel_futures=True)
    return HashedFiles(sizes, hashes.tobytes())


def content_hash(path: Path) -> str:
    """Return the SHA-256 of one file as hexadecimal digits; raises BadInput as `file_hashes`."""
    return file_hashes([path])[0].hex()


def hashes_folder() -> Path:
    """Return the folder that keeps the hashes of files: VPRBENCH_HASHES, or one in the user's cache."""
    return cache_folder(_FOLDER, "hashes")


def _hash_folder(
    folder: Path, names: Sequence[str], readers: ThreadPoolExecutor, n_done: int, n_files: int
) -> list[Entry]:
    """Return the entry of each of these files of a folder; the first `n_done` of all `n_files` are hashed already."""
    index = hashes_folder() / f"{hashlib.sha256(os.fsencode(folder)).hexdigest()[:32]}.json"
    kept = _load_index(index)
    unknown = [name for name, state in _look_at(folder, names).items() if kept.get(name, [])[:-1] != state]
    for number, entry in enumerate(readers.map(lambda name: _read_file(folder / name), unknown), start=1):
        kept[unknown[number - 1]] = entry
        if number % _REPORT_EVERY == 0:  # fewer take no time
            progress.report("hashing frames", (n_done + number) / n_files)
    if unknown:
        _save_index(index, folder, kept)
    return [kept[name] for name in names]


def _load_index(path: Path) -> dict[str, Entry]:
    """Return the entries of a folder by the names of its files; none if there are none, or if the file is damaged."""
    try:
        return dict(json.loads(path.read_bytes())["files"])
    except OSError:
        return {}
    except (ValueError, TypeError, KeyError) as error:
        logger.warning("%s cannot be used (%s): the files of that folder are hashed anew", path, error)
        return {}


def _save_index(path: Path, folder: Path, entries: dict[str, Entry]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_text(path, json.dumps({"folder": str(folder), "files": entries}))
    except OSError as error:
        _warn_once(path.parent, error.strerror or str(error))


@cache
def _warn_once(folder: Path, reason: str) -> None:
    logger.warning("no hashes of files are kept in %s (%s): files are read each time", folder, reason)


def _look_at(folder: Path, names: Sequence[str]) -> dict[str, Entry]:
    """Return the state of each file by its name; raises BadInput if there is none."""
    start = os.path.join(folder, "")  # noqa: PTH118 - a Path for each file takes longer than the look
    try:
        return {name: _state(os.stat(start + name)) for name in names}  # noqa: PTH116
    except OSError as error:
        raise _unreadable(error.filename, error) from error


def _state(found: os.stat_result) -> Entry:
    return [found.st_size, found.st_mtime_ns, found.st_ctime_ns]


def _read_file(path: Path) -> Entry:
    """Return the entry of a file; raises BadInput if it cannot be read, or changes meanwhile."""
    try:
        with path.open("rb", buffering=0) as file:
            before = _state(os.fstat(file.fileno()))
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
            after = _state(os.fstat(file.fileno()))
    except OSError as error:
        raise _unreadable(path, error) from error
    if after != before:
        raise BadInput(f"{path} changes while it is read: wait until it is written, then run again")
    return [*before, sha256]


def _unreadable(path: Path | str, error: OSError) -> BadInput:
    return BadInput(f"{path} cannot be read ({error.strerror}): restore the file")

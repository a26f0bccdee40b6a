"""SHA-256 of files, computed once: a JSON file for each folder of files keeps them until a file changes."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.errors import BadInput
from vprbench.storage.atomic import replace_text
from vprbench.storage.cores import core_count
from vprbench.storage.folders import cache_folder
from vprbench.storage.paths import Paths

_SHA256_BYTES = 32
_REPORT_EVERY = 256  # files that are read

Entry = list[int | str]  # of a file: size in bytes, times of modification and of change in ns, SHA-256


@dataclass(frozen=True, eq=False)
class HashedFiles:
    """Sizes and hashes of files, in little memory."""

    sizes: npt.NDArray[np.int64]  # (n,), bytes
    sha256: bytes  # of all files, joined

    def __getitem__(self, index: int) -> bytes:
        """Return the SHA-256 of one file, 32 bytes."""
        start = range(len(self.sizes))[index] * _SHA256_BYTES
        return self.sha256[start : start + _SHA256_BYTES]

    def digest_parts(self) -> Iterator[bytes]:
        """Yield bytes that change with the size or the content of any of the files."""
        for number, size in enumerate(self.sizes.tolist()):
            yield b"%d%b" % (size, self[number])


def file_hashes(paths: Sequence[Path]) -> HashedFiles:
    """Return the hash of each file; unknown files are read, by as many threads as there are cores.

    A file is known while its absolute path, its size and its times of modification and of change stay the same. Where
    `hashes_folder` cannot be written, files are read each time. Raises BadInput if a file cannot be read.
    """
    files = Paths.of(paths)
    sizes, hashes = np.zeros(len(files), np.int64), np.zeros((len(files), _SHA256_BYTES), np.uint8)
    n_done = 0
    for folder, positions in files.in_folders():
        names = [files.names[position] for position in positions.tolist()]
        entries = _hash_folder(folder.absolute(), names, n_done, len(files))
        sizes[positions] = [entry[0] for entry in entries]
        joined = bytes.fromhex("".join(str(entry[-1]) for entry in entries))
        hashes[positions] = np.frombuffer(joined, np.uint8).reshape(-1, _SHA256_BYTES)
        n_done += len(names)
    return HashedFiles(sizes, hashes.tobytes())


def content_hash(path: Path) -> str:
    """Return the SHA-256 of one file as hexadecimal digits; raises BadInput if it cannot be read."""
    return file_hashes([path])[0].hex()


def hashes_folder() -> Path:
    """Return the folder that keeps the hashes of files: VPRBENCH_HASHES, or one in the user's cache."""
    return cache_folder("VPRBENCH_HASHES", "hashes")


def _hash_folder(folder: Path, names: Sequence[str], n_done: int, n_files: int) -> list[Entry]:
    """Return the entry of each of these files of a folder; the first `n_done` of all `n_files` are hashed already."""
    index = hashes_folder() / f"{hashlib.sha256(os.fsencode(folder)).hexdigest()[:32]}.json"
    kept: dict[str, Entry] = {}
    with suppress(OSError, ValueError, TypeError, KeyError):  # missing or damaged
        kept = dict(json.loads(index.read_bytes())["files"])
    start = os.path.join(folder, "")  # noqa: PTH118 - a Path for each file takes longer than the look
    try:
        states = {name: _read_state(start + name) for name in names}
        unknown = [name for name, state in states.items() if kept.get(name, [])[:-1] != state]
        with ThreadPoolExecutor(core_count()) as readers:
            digests = readers.map(_read_digest, [start + name for name in unknown])
            for number, (name, digest) in enumerate(zip(unknown, digests, strict=True), start=1):
                kept[name] = [*states[name], digest]
                if number % _REPORT_EVERY == 0:  # fewer take no time
                    progress.report("hashing frames", (n_done + number) / n_files)
    except OSError as error:
        path = error.filename or folder
        raise BadInput(f"{path} cannot be read ({error.strerror}): restore the file") from error
    if unknown:
        with suppress(OSError):  # files are read each time then
            index.parent.mkdir(parents=True, exist_ok=True)
            replace_text(index, json.dumps({"folder": str(folder), "files": kept}))
    return [kept[name] for name in names]


def _read_state(path: str) -> Entry:
    found = os.stat(path)  # noqa: PTH116
    return [found.st_size, found.st_mtime_ns, found.st_ctime_ns]


def _read_digest(path: str) -> str:
    with Path(path).open("rb", buffering=0) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

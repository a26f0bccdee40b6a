"""SHA-256 of files, computed once: a JSON file for each folder of files keeps them until a file changes."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

from vprbench import progress
from vprbench.errors import BadInput
from vprbench.storage.atomic import replace_text
from vprbench.storage.cores import count_cores
from vprbench.storage.folders import cache_folder
from vprbench.storage.paths import Paths

_REPORT_EVERY = 256  # files that are read

FileHash = tuple[int, bytes]  # size in bytes, SHA-256 (32 bytes)
_Entry = list[int | str]  # of a file: size in bytes, times of modification and of change in ns, SHA-256 in hexadecimal


def hash_each_file(paths: Sequence[Path]) -> list[FileHash]:
    """Return the size and hash of each file; unknown files are read, by as many threads as there are cores.

    A file is known while its absolute path, its size and its times of modification and of change stay the same. Where
    `find_hashes_folder` cannot be written, files are read each time. Raises BadInput if a file cannot be read.
    """
    files = Paths.of(paths)
    hashes: dict[int, FileHash] = {}  # by position
    for folder, positions in files.in_folders():
        names = [files.names[position] for position in positions.tolist()]
        entries = _hash_folder(folder.absolute(), names, len(hashes), len(files))
        found = ((int(entry[0]), bytes.fromhex(str(entry[-1]))) for entry in entries)
        hashes.update(zip(positions.tolist(), found, strict=True))
    return [hashes[position] for position in range(len(files))]


def hash_file(path: Path) -> str:
    """Return the SHA-256 of one file as hexadecimal digits; raises BadInput if it cannot be read."""
    return hash_each_file([path])[0][1].hex()


def find_hashes_folder() -> Path:
    """Return the folder that keeps the hashes of files: VPRBENCH_HASHES, or one in the user's cache."""
    return cache_folder("VPRBENCH_HASHES", "hashes")


def _hash_folder(folder: Path, names: Sequence[str], n_done: int, n_files: int) -> list[_Entry]:
    """Return the entry of each of these files of a folder; the first `n_done` of all `n_files` are hashed already."""
    index = find_hashes_folder() / f"{hashlib.sha256(os.fsencode(folder)).hexdigest()[:32]}.json"
    kept: dict[str, _Entry] = {}
    with suppress(OSError, ValueError, TypeError, KeyError):  # missing or damaged
        kept = dict(json.loads(index.read_bytes())["files"])
    start = os.path.join(folder, "")  # noqa: PTH118 - a Path for each file takes longer than the look
    try:
        states = {name: _read_state(start + name) for name in names}
        unknown = [name for name, state in states.items() if kept.get(name, [])[:-1] != state]
        with ThreadPoolExecutor(count_cores()) as readers:
            digests = readers.map(compute_sha256, [start + name for name in unknown])
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


def _read_state(path: str) -> _Entry:
    found = os.stat(path)  # noqa: PTH116
    return [found.st_size, found.st_mtime_ns, found.st_ctime_ns]


def compute_sha256(path: Path | str) -> str:
    """Return the SHA-256 of a file, which is read, as hexadecimal digits; raises OSError."""
    with Path(path).open("rb", buffering=0) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

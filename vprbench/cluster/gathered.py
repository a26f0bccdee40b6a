"""What a worker has stored where the client does not see it: sent back as files with their hashes, and stored here."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from vprbench.errors import BadInput
from vprbench.run.processes import scratch
from vprbench.run.record import load, read_failure
from vprbench.run.store import Store
from vprbench.storage.atomic import replace_bytes

_FRAMES = "frames"


@dataclass(frozen=True)
class Parcel:
    """Files by their paths below a results folder, and the sha256 of each."""

    files: dict[str, tuple[bytes, str]]


def packed(results: Path) -> Parcel:
    """Return the runs and failures of a worker's own results folder, which then holds none, and its small pictures."""
    folders = [*_folders(results)]
    paths = [path for folder in folders for path in folder.rglob("*") if path.is_file()]
    paths += (results / _FRAMES).glob("[!.]*")
    contents = {path.relative_to(results).as_posix(): path.read_bytes() for path in paths}
    for folder in folders:
        shutil.rmtree(folder)
    return Parcel({name: (content, hashlib.sha256(content).hexdigest()) for name, content in contents.items()})


def unpack(parcel: Parcel, store: Store) -> None:
    """Store what a worker sent; raises BadInput for a file that is not what was sent."""
    store.prepare()
    with scratch() as folder:
        for name, (content, expected) in parcel.files.items():
            if hashlib.sha256(content).hexdigest() != expected:
                raise BadInput(f"{name} came back from its worker damaged: give the same command again")
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
            kept = store.root / name
            if path.parent.name == _FRAMES and not kept.exists():
                kept.parent.mkdir(exist_ok=True)
                replace_bytes(kept, content)
        for found in _folders(folder):
            failure = read_failure(found)
            if failure is None:
                store.save(load(found))
            else:
                store.save_failure(failure)


def _folders(results: Path) -> Iterator[Path]:
    """Yield the folders of runs and failures."""
    for folder in results.glob("[!.]*/[!.]*"):
        if folder.is_dir() and folder.parent.name not in (_FRAMES, "descriptors"):
            yield folder

"""What identifies a run: the key of all that can change it, and hashes of its code and frames."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Sequence
from typing import TypedDict

from vprbench.api.dataset import Dataset
from vprbench.api.images import names_hash
from vprbench.api.method import Method
from vprbench.runs import machine, sources
from vprbench.runs.request import RunRequest
from vprbench.runs.run_files import hash_content

#: Raise it with a change by which a run may have other answers or times; a test holds that nobody forgets to decide.
VERSION = 6

#: A change of these modules is a decision about VERSION, beside those of `vprbench.api`.
MODULES = (
    *("vprbench.metrics.ranking", "vprbench.plugins.networks", "vprbench.runs.stopwatch", "vprbench.runs.fitting"),
    *("vprbench.runs.run", "vprbench.runs.answers", "vprbench.runs.scorers", "vprbench.runs.descriptors"),
    *("vprbench.runs.machine", "vprbench.runs.watch"),
    *("vprbench.runs.corruption", "vprbench.runs.viewpoints"),
)


def run_key(
    request: RunRequest,
    dataset: Dataset,
    *,
    images: str,
    code: str,
    files: Sequence[tuple[str, str]],
    network: str | None,
) -> str:
    """Return the hash of all that can change the record of a run, but for its timing protocol.

    Args:
        request: the run to be made; the place of its method's file does not count.
        dataset: its dataset, built.
        images: the fingerprint of the dataset.
        code: the `hash_code` of the method's class.
        files: name and hash of each data file behind the method.
        network: the hash of the file that the run loads; None for a run that trains.
    """
    arguments = {name: value for name, value in request.method.items() if name not in ("_target_", "device")}
    return hash_content(
        {
            "method": arguments,
            "code": code,
            "dataset": dataset.name,
            "protocol": dict(dataset.protocol),
            "images": images,
            "breaks": [None if at is None else at.tolist() for at in (dataset.query_breaks, dataset.place_breaks)],
            "held_out": None if dataset.held_out is None else dataset.held_out.fingerprint(),
            "tuned_on": request.tuned_on,
            "files": [[*each] for each in files],
            "seed": request.seed,
            "device": machine.classify_device(request.device),
            "threads": request.n_threads,
            "depth": request.depth,
            "libraries": machine.list_library_versions(),
            "network": network,
        }
    )


class DataRecord(TypedDict):
    """The frames of a dataset, references first and then queries, each in its order."""

    names_sha256: str  # of all names, joined by line feeds, in UTF-8
    content_sha256: str | None  # of the SHA-256 (32 bytes) of each file, joined; None if an image is no file
    images: int  # a frame that is used twice counts twice
    bytes: int | None  # of all files together; None if an image is no file


def hash_code(method: type[Method]) -> str:
    """Return the hash of the code that computes a method's answers, its class, and the version of the harness.

    Of a class without source it is another one each time: its runs are never found again.
    """
    try:
        code = sources.hash_class(method)
    except OSError:
        return uuid.uuid4().hex
    return hashlib.sha256(f"{code} {method.__qualname__} {VERSION}".encode()).hexdigest()


def hash_frames(dataset: Dataset) -> tuple[str, DataRecord]:
    """Return the hash of a dataset's images, order and ground truth, and the record of its frames.

    The record lets others tell whether they used the same frames. Raises BadInput if a file cannot be read.
    """
    traverses = dataset.references, dataset.queries
    hashes = [images.file_hashes() for images in traverses]  # None: images that are no files
    digest = hashlib.sha256()
    for images, files in zip(traverses, hashes, strict=True):
        digest.update(images.fingerprint(files).encode())
    digest.update(dataset.places.tobytes())
    for right in dataset.positives:
        digest.update(right.tobytes() + b";")
    known = [file for files in hashes for file in files or ()]
    are_files = None not in hashes
    return digest.hexdigest(), {
        "names_sha256": names_hash(*(images.names for images in traverses)).hexdigest(),
        "content_sha256": hashlib.sha256(b"".join(sha256 for _, sha256 in known)).hexdigest() if are_files else None,
        "images": sum(map(len, traverses)),
        "bytes": sum(size for size, _ in known) if are_files else None,
    }


def compute_fingerprint(dataset: Dataset) -> str:
    """Return the hash of a dataset's images, order and ground truth; raises BadInput if a file cannot be read."""
    return hash_frames(dataset)[0]

"""What identifies a run: the key of all that can change its outcome, and the hashes of its code and its frames."""

from __future__ import annotations

import hashlib
from dataclasses import asdict
from typing import TypedDict

from vprbench.api.dataset import Dataset
from vprbench.api.method import Method, calibration
from vprbench.run import harness, machine
from vprbench.run.record import content_key
from vprbench.run.request import Request
from vprbench.run.sources import source_hash


class DataRecord(TypedDict):
    """The frames of a dataset, references first and then queries, each in its order."""

    names_sha256: str  # of all names, joined by line feeds, in UTF-8
    content_sha256: str | None  # of the SHA-256 (32 bytes) of each file, joined; None where an image is no file
    images: int  # a frame that is used twice counts twice
    bytes: int | None  # of all files together; None where an image is no file


def run_key(request: Request) -> str:
    """Return the hash of all that can change the outcome of a run or the times it measures.

    Where files lie does not count: of the module of the method's class its name alone.
    A run that loads a network has the hash of that file in its key, a run that trains has none.
    """
    config, dataset = request.config, request.dataset
    arguments = {name: value for name, value in config["method"].items() if name not in ("_target_", "device")}
    held_out = calibration(request.method, dataset)
    return content_key(
        {
            "method": {"class": type(request.method).__qualname__, **arguments},
            "code": code_hash(type(request.method)),
            "dataset": dataset.name,
            "protocol": dict(dataset.protocol),
            "images": request.fingerprint,
            "held_out": None if held_out is None else held_out.fingerprint(),
            "files": config.get("files", []),
            "seed": config["seed"],
            "device": machine.device_class(config["device"]),
            "threads": request.threads,
            "depth": config["depth"],
            "timing": asdict(request.protocol),
            "libraries": machine.library_versions(),
            "network": request.files.sha256,
        }
    )


def code_hash(method: type[Method]) -> str:
    """Return the hash of the code that computes a method's answers, and of the version of the harness around it."""
    return hashlib.sha256(f"{source_hash(method)} {harness.VERSION}".encode()).hexdigest()


def fingerprint(dataset: Dataset) -> str:
    """Return the hash of a dataset's images, order and ground truth."""
    digest = hashlib.sha256()
    digest.update(dataset.references.fingerprint().encode())
    digest.update(dataset.queries.fingerprint().encode())
    digest.update(dataset.places.tobytes())
    for right in dataset.positives:
        digest.update(right.tobytes() + b";")
    return digest.hexdigest()


def data_record(dataset: Dataset) -> DataRecord:
    """Return what a run records of its frames, by which others can tell whether they used the same frames.

    Raises BadInput if a file cannot be read.
    """
    names = [*dataset.references.names, *dataset.queries.names]
    references, queries = dataset.references.file_hashes(), dataset.queries.file_hashes()
    files = None if references is None or queries is None else [*references, *queries]
    return {
        "names_sha256": hashlib.sha256("\n".join(names).encode(errors="surrogateescape")).hexdigest(),
        "content_sha256": None if files is None else hashlib.sha256(b"".join(f.sha256 for f in files)).hexdigest(),
        "images": len(names),
        "bytes": None if files is None else sum(file.size_bytes for file in files),
    }

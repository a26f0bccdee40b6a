"""A run that is asked for and what identifies it: the key of all that can change it, hashes of its code and frames."""

from __future__ import annotations

import hashlib
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

from vprbench.api.dataset import Dataset
from vprbench.api.images import names_hash
from vprbench.api.method import Method, calibration
from vprbench.plugins import networks
from vprbench.runs import machine, sources
from vprbench.runs.run_files import content_key
from vprbench.runs.timing_protocol import Protocol
from vprbench.runs.viewpoints import Viewpoints
from vprbench.storage.hashes import HashedFiles

if TYPE_CHECKING:
    from vprbench.runs.fitting import FitResult

#: Raise it with a change by which a run may have other answers or times; a test holds that nobody forgets to decide.
VERSION = 5

#: The modules whose changes are decided about, beside those of `vprbench.api`.
MODULES = (
    *("vprbench.metrics.ranking", "vprbench.plugins.networks", "vprbench.runs.stopwatch", "vprbench.runs.fitting"),
    *("vprbench.runs.runner", "vprbench.runs.answers", "vprbench.runs.descriptors", "vprbench.runs.machine"),
    *("vprbench.runs.corruption", "vprbench.runs.corrupted_frames", "vprbench.runs.viewpoints"),
)


_NO_FILES = networks.Files()
Hashed = tuple[HashedFiles | None, HashedFiles | None]  # references and queries; None: images that are no files


@dataclass(frozen=True)
class Identity:
    """All that can change the outcome of a run, or the times it measures by one timing protocol."""

    method_class: str  # its name alone: where its file lies does not count
    code: str  # its hash
    config: Mapping[str, Any]  # what was asked for: method, seed, device, depth, files
    dataset: Dataset
    images: str  # their fingerprint
    held_out: str | None  # fingerprint of the places that the method chooses its settings by
    threads: int
    network: str | None = None  # hash of the file that the run loads; a run that trains has another key

    def key(self) -> str:
        """Return the hash of all of it."""
        arguments = {name: value for name, value in self.config["method"].items() if name not in ("_target_", "device")}
        return content_key(
            {
                "method": {"class": self.method_class, **arguments},
                "code": self.code,
                "dataset": self.dataset.name,
                "protocol": dict(self.dataset.protocol),
                "images": self.images,
                "held_out": self.held_out,
                "files": self.config.get("files", []),
                "seed": self.config["seed"],
                "device": machine.device_class(self.config["device"]),
                "threads": self.threads,
                "depth": self.config["depth"],
                "libraries": machine.library_versions(),
                "network": self.network,
            }
        )


class DataRecord(TypedDict):
    """The frames of a dataset, references first and then queries, each in its order."""

    names_sha256: str  # of all names, joined by line feeds, in UTF-8
    content_sha256: str | None  # of the SHA-256 (32 bytes) of each file, joined; None if an image is no file
    images: int  # a frame that is used twice counts twice
    bytes: int | None  # of all files together; None if an image is no file


@dataclass(frozen=True)
class Request:
    """One run that is asked for."""

    name: str  # of the method
    method: Method
    dataset: Dataset
    config: Mapping[str, Any]  # method, dataset, seed, device, depth and what else was asked for, resolved
    fingerprint: str  # of the dataset
    protocol: Protocol
    threads: int
    files: networks.Files = _NO_FILES  # networks to load or to store
    cache: Path | None = None  # a folder for descriptors worth keeping
    scores: bool = False  # keep them all, however many
    stream: int = 0  # places from one stop of a growing map to the next, which changes no answer; 0: none is asked for
    views: Viewpoints | None = None  # from which the queries are asked; None: the frames as they are
    tuned_on: Mapping[str, Any] = field(default_factory=dict)  # places that chose the method's settings
    tuned_queries: Sequence[int] = ()  # which show frames of these places, by their content
    data: DataRecord | None = None  # of the dataset; None: its files are looked at when it runs
    shared_fit: list[FitResult] | None = None  # of runs that share the method: what its fit gave, once it was fitted

    def key(self) -> str:
        """Return the hash of its identity."""
        held_out = calibration(self.method, self.dataset)
        return Identity(
            method_class=type(self.method).__qualname__,
            code=code_hash(type(self.method)),
            config=self.config,
            dataset=self.dataset,
            images=self.fingerprint,
            held_out=None if held_out is None else held_out.fingerprint(),
            threads=self.threads,
            network=self.files.sha256,
        ).key()


def code_hash(method: type[Method]) -> str:
    """Return the hash of the code that computes a method's answers, and of the version of the harness around it.

    Of a class without source it is another one each time: its runs are never found again.
    """
    try:
        return _with_harness(sources.hash_class(method))
    except OSError:
        return uuid.uuid4().hex


def code_hash_of(target: str) -> str | None:
    """Return the `code_hash` of a class by its full name, without importing it; None where its file cannot be told."""
    code = sources.hash_target(target)
    return None if code is None else _with_harness(code)


def hashed(dataset: Dataset) -> Hashed:
    """Return the hashes of a dataset's files; raises BadInput if one cannot be read."""
    return dataset.references.file_hashes(), dataset.queries.file_hashes()


def fingerprint(dataset: Dataset, files: Hashed | None = None) -> str:
    """Return the hash of a dataset's images, order and ground truth; of its `files`, if these are hashed already."""
    references, queries = files or hashed(dataset)
    digest = hashlib.sha256()
    digest.update(dataset.references.fingerprint(references).encode())
    digest.update(dataset.queries.fingerprint(queries).encode())
    digest.update(dataset.places.tobytes())
    for right in dataset.positives:
        digest.update(right.tobytes() + b";")
    return digest.hexdigest()


def data_record(dataset: Dataset, files: Hashed | None = None) -> DataRecord:
    """Return what a run records of its frames, by which others can tell whether they used the same frames.

    Of its `files`, if these are hashed already. Raises BadInput if a file cannot be read.
    """
    names = dataset.references.names, dataset.queries.names
    known = [part for part in files or hashed(dataset) if part is not None]
    whole = len(known) == len(names)
    return {
        "names_sha256": names_hash(*names).hexdigest(),
        "content_sha256": hashlib.sha256(b"".join(part.sha256 for part in known)).hexdigest() if whole else None,
        "images": sum(map(len, names)),
        "bytes": sum(int(part.sizes.sum()) for part in known) if whole else None,
    }


def _with_harness(code: str) -> str:
    return hashlib.sha256(f"{code} {VERSION}".encode()).hexdigest()

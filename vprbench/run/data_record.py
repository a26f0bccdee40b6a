"""What a run records of its frames, by which others can tell whether they used the same ones."""

from __future__ import annotations

import hashlib
from typing import TypedDict

from vprbench.api.dataset import Dataset


class DataRecord(TypedDict):
    """The frames of a dataset, references first and then queries, each in its order."""

    names_sha256: str  # of all names, joined by line feeds, in UTF-8
    content_sha256: str | None  # of the SHA-256 (32 bytes) of each file, joined; None where an image is no file
    images: int  # a frame that is used twice counts twice
    bytes: int | None  # of all files together; None where an image is no file


def data_record(dataset: Dataset) -> DataRecord:
    """Return what is recorded of the frames of a dataset; raises BadInput where a file cannot be read."""
    names = [*dataset.references.names, *dataset.queries.names]
    references, queries = dataset.references.file_hashes(), dataset.queries.file_hashes()
    files = None if references is None or queries is None else [*references, *queries]
    return {
        "names_sha256": hashlib.sha256("\n".join(names).encode(errors="surrogateescape")).hexdigest(),
        "content_sha256": None if files is None else hashlib.sha256(b"".join(f.sha256 for f in files)).hexdigest(),
        "images": len(names),
        "bytes": None if files is None else sum(file.size_bytes for file in files),
    }

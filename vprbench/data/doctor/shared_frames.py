"""The check of queries that are among the references: by the content of files, or by the pixels of arrays."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from vprbench.api.dataset import Dataset
from vprbench.api.images import codes_to_compare
from vprbench.text import be, plural, some_of

from .finding import Finding
from .looking import look_at
from .pictures import IN_MAP


def allowed(dataset: Dataset) -> bool:
    """Tell whether queries of a dataset may be among its references."""
    return dataset.protocol.get("shared_frames") == "allow"


def shared_frames(dataset: Dataset) -> Iterator[Finding]:
    """Find queries that are among the references, under whatever names; black ones and those of one grey value pass.

    Rendered frames and windows of event recordings are not looked at. Raises BadInput for a file that cannot be read.
    """
    codes = codes_to_compare(dataset.references, dataset.queries)
    if codes is None:
        return
    references, queries = codes
    first = {code: number for number, code in reversed([*enumerate(references.tolist())])}
    shared = np.flatnonzero(np.isin(queries, references))
    if not len(shared):
        return
    seen = look_at(dataset.queries[shared], "queries that are in the map")
    telling = shared[~seen.black & ~seen.uniform]
    names, known = dataset.queries.names, dataset.references.names
    same = [(names[query], known[first[int(queries[query])]]) for query in telling.tolist()]
    pairs = [" = ".join(dict.fromkeys(pair)) for pair in same]
    if pairs:
        yield Finding(
            "warning" if allowed(dataset) else "error",
            "shared frames",
            f"{len(pairs):,} of {plural(len(queries), 'query')} {be(pairs)} among the references: {some_of(pairs)}",
            IN_MAP,
        )

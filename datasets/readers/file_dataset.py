"""A dataset made of lists of image files and their ground truth: one rule for queries that have no right place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, Dataset, FrameFolder, Images, Paths, Places

Unmatched = Literal["error", "keep", "drop"]  # of queries without a right place: keep counts them as misses


@dataclass(frozen=True)
class GroundTruth:
    """Which place each reference shows, and which places are right for each query."""

    places: Places  # (n_references,)
    positives: Sequence[npt.NDArray[np.int64]]  # per query, ascending
    lacking: str  # what a query without any lacks, as in "no reference within 25 m"


def each_a_place(n_references: int, right: Iterable[npt.ArrayLike], lacking: str) -> GroundTruth:
    """Return the ground truth of references that are a place each, with the right ones of every query, ascending."""
    return GroundTruth(np.arange(n_references), [np.array(found, dtype=np.int64) for found in right], lacking)


def dataset_of_files(
    name: str,
    references: Sequence[Path] | Images,
    queries: Sequence[Path] | Images,
    truth: GroundTruth,
    unmatched: Unmatched,
    protocol: Mapping[str, Any],
    notes: Sequence[str] = (),
) -> Dataset:
    """Return the dataset of these files or images; how queries without a right place are treated is noted.

    Raises BadInput if `unmatched` is error and such queries exist, or drop and no other queries exist.
    """
    mapped, asked = (part if isinstance(part, Images) else Images.from_files(part) for part in (references, queries))
    files = [Paths.of(part) for part in (references, queries) if not isinstance(part, Images)]
    shown = asked.names if isinstance(queries, Images) else files[-1]
    matched = [query for query, right in enumerate(truth.positives) if len(right)]
    kept = np.array(matched if unmatched == "drop" else range(len(queries)), dtype=np.int64)
    without = len(truth.positives) - len(matched)
    told = f"{without} of {len(queries)} queries have {truth.lacking}"
    if without and unmatched == "error":
        first = next(query for query, right in enumerate(truth.positives) if not len(right))
        raise BadInput(
            f"{told} (first: {shown[first]}): correct the data, pass dataset.unmatched=keep to count them as misses, "
            "or dataset.unmatched=drop to leave them out"
        )
    if not len(kept):
        raise BadInput(f"{told}, and dataset.unmatched=drop leaves none: check that both folders show the same places")
    outcome = "are left out" if unmatched == "drop" else "count as misses"
    return Dataset(
        name=name,
        references=mapped,
        places=truth.places,
        queries=asked[kept],
        positives=tuple(truth.positives[query] for query in kept.tolist()),
        protocol={**protocol, "unmatched": unmatched},
        query_breaks=np.flatnonzero(np.diff(matched) > 1) + 1 if unmatched == "drop" else None,
        folders=folders_of(Paths.joined(files)),
        notes=(*notes, *([f"{told}; they {outcome} (dataset.unmatched={unmatched})"] if without else ())),
    )


def folders_of(files: Sequence[Path]) -> tuple[FrameFolder, ...]:
    """Return the folders that hold the files, in order of appearance, each with the names used of it, each once."""
    files = Paths.of(files)
    return tuple(FrameFolder(folder, tuple(dict.fromkeys(files[which].names))) for folder, which in files.in_folders())

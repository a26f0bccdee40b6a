"""A dataset made of lists of image files and their ground truth: one rule for queries that have no right place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, Dataset, Exif, FrameFolder, Images, Paths, Places, decoding_of

from .drives import NO_STARTS, Breaks, Starts, drive_starts

NOT_JUDGED = "there is no ground truth, so no answer is judged (ground_truth=none)"

Unmatched = Literal["error", "keep", "drop"]  # of queries without a right place: keep counts them as misses


@dataclass(frozen=True)
class GroundTruth:
    """Which place each reference shows, and which places are right for each query."""

    places: Places  # (n_references,)
    positives: Sequence[npt.NDArray[np.int64]]  # per query, ascending
    lacking: str  # what a query without any lacks, as in "no reference within 25 m"
    by_order: bool = False  # whether the order of the images says what is right
    known: bool = True  # False: nobody knows which places are right
    references: npt.NDArray[np.int64] | None = None  # those of all that it is about, ascending; None: all
    queries: npt.NDArray[np.int64] | None = None
    jumps: tuple[Starts, Starts] = (NO_STARTS, NO_STARTS)  # of these references and queries, where the position jumps
    place_numbers: Places | None = None  # (n_places,), ascending, if places have numbers of their own
    protocol: Mapping[str, Any] = field(default_factory=dict)  # what was chosen where the data left a choice
    notes: Sequence[str] = ()


def each_a_place(n_references: int, right: Iterable[npt.ArrayLike], lacking: str) -> GroundTruth:
    """Return the ground truth of references that are a place each, with the right ones of every query, ascending."""
    return GroundTruth(np.arange(n_references), [np.array(found, dtype=np.int64) for found in right], lacking)


def unknown(n_references: int, n_queries: int) -> GroundTruth:
    """Return what stands in for a ground truth that there is none of (`dataset.ground_truth=none`).

    Every reference is a place, and no answer is judged.
    """
    return GroundTruth(np.arange(n_references), [np.empty(0, np.int64)] * n_queries, "no ground truth", known=False)


def dataset_of_files(
    name: str,
    references: Sequence[Path] | Images,
    queries: Sequence[Path] | Images,
    truth: GroundTruth,
    unmatched: Unmatched,
    protocol: Mapping[str, Any],
    notes: Sequence[str] = (),
    breaks: Breaks = "none",
    exif: Exif = "obey",
    levels: str | None = None,
) -> Dataset:
    """Return the dataset of these files or images; how queries without a right place are treated is noted.

    Under the `breaks` auto the journey breaks off where another drive begins. `exif` and `levels` say how all files are
    decoded (`decoding_of`). The protocol says either where it matters. Of an unknown ground truth all queries stay.
    Raises BadInput if `unmatched` is error and such queries exist, or drop and no other queries exist, and for levels
    that the files leave open.
    """
    if not truth.known:
        unmatched = "keep"
    files = [Paths.of(part) for part in (references, queries) if not isinstance(part, Images)]
    references, queries = _choose(references, truth.references), _choose(queries, truth.queries)
    shown = queries.names if isinstance(queries, Images) else Paths.of(queries)
    matched = [query for query, right in enumerate(truth.positives) if len(right)]
    kept = np.array(matched if unmatched == "drop" else range(len(queries)), dtype=np.int64)
    without = len(truth.positives) - len(matched)
    lack = f"{without} of {len(queries)} queries have {truth.lacking}"
    if without and unmatched == "error":
        first = next(query for query, right in enumerate(truth.positives) if not len(right))
        raise BadInput(
            f"{lack} (first: {shown[first]}): correct the data, pass dataset.unmatched=keep to count them as misses, "
            "or dataset.unmatched=drop to leave them out"
        )
    if not len(kept):
        raise BadInput(f"{lack}, and dataset.unmatched=drop leaves none: check that both folders show the same places")
    starts = drive_starts(references, queries, breaks, truth.jumps)
    place_starts = starts.of_places(truth.places)
    seen = {"breaks": starts.seen_by} if len(place_starts) or len(starts.queries) else {}
    place_gaps = NO_STARTS if truth.references is None else _after_gaps(truth.references)
    query_gaps = _after_gaps(kept if truth.queries is None else truth.queries[kept])
    has_place_breaks = seen or truth.references is not None or truth.place_numbers is not None
    has_query_breaks = seen or truth.queries is not None or unmatched == "drop"
    decoding, decoded = decoding_of(Paths.joined(files), exif, levels, "dataset.")
    map_images, query_images = (
        part if isinstance(part, Images) else Images.from_files(part, decoding) for part in (references, queries)
    )
    outcome = "are left out" if unmatched == "drop" else "count as misses"
    note = f"{lack}; they {outcome} (dataset.unmatched={unmatched})"
    return Dataset(
        name=name,
        references=map_images,
        places=truth.places,
        queries=query_images[kept],
        positives=tuple(truth.positives[query] for query in kept.tolist()),
        protocol={
            **protocol,
            **truth.protocol,
            **({"unmatched": unmatched} if truth.known else {"ground_truth": "none"}),
            **seen,
            **decoded,
        },
        place_numbers=truth.place_numbers,
        query_breaks=np.union1d(query_gaps, _first_from(starts.queries, kept)) if has_query_breaks else None,
        place_breaks=np.union1d(place_gaps, place_starts) if has_place_breaks else None,
        by_order=truth.by_order,
        folders=folders_of(Paths.joined(files)),
        notes=(*notes, *truth.notes, *([note if truth.known else NOT_JUDGED] if without else ())),
    )


def _choose(images: Sequence[Path] | Images, numbers: npt.NDArray[np.int64] | None) -> Sequence[Path] | Images:
    """Return the files or images of these numbers, all if there are no numbers."""
    if numbers is None:
        return images
    return images[numbers] if isinstance(images, Images) else Paths.of(images)[numbers]


def _after_gaps(numbers: npt.NDArray[np.int64]) -> Starts:
    """Return which of some numbers, by their rank, come after others that were left out."""
    return np.flatnonzero(np.diff(numbers) > 1) + 1


def _first_from(starts: Starts, kept: npt.NDArray[np.int64]) -> Starts:
    """Return the numbers, among the queries that are kept, of the first query of each drive after the first drive."""
    found = np.unique(np.searchsorted(kept, starts))
    return found[(found > 0) & (found < len(kept))]


def folders_of(files: Sequence[Path]) -> tuple[FrameFolder, ...]:
    """Return the folders that hold the files, in order of appearance, each with the names used of it, each once."""
    files = Paths.of(files)
    return tuple(FrameFolder(folder, tuple(dict.fromkeys(files[which].names))) for folder, which in files.in_folders())

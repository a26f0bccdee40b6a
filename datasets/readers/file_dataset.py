"""A dataset made of lists of image files and their ground truth: one rule for queries that have no right place."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, Dataset, Exif, FrameFolder, Images, Paths, Places, decoding_of

from .drives import NO_STARTS, Breaks, Starts, find_drives

Unmatched = Literal["error", "keep", "drop"]  # of queries without a right place: keep counts them as misses
Numbers = npt.NDArray[np.int64]


class FileOptions(TypedDict, total=False):
    """Options of every dataset of files; the protocol names each where it matters."""

    unmatched: Unmatched
    breaks: Breaks  # auto: another folder, or a position that jumps, begins another drive, where sequences end
    exif: Exif  # obey or ignore the tag of a camera that was held on its side
    levels: str | None  # LOW..HIGH, that become 0 and 255 where files are deeper than 8 bits; None: the files tell


OWN_FILES: FileOptions = {"unmatched": "error", "breaks": "auto", "exif": "obey", "levels": None}
PUBLISHED_FILES: FileOptions = {"unmatched": "keep", "breaks": "none", "exif": "ignore", "levels": None}


@dataclass(frozen=True)
class GroundTruth:
    """Which place each reference shows, and which places are right for each query."""

    places: Places  # (n_references,)
    positives: Sequence[Numbers]  # per query, ascending
    lacking: str  # what a query without any lacks, as in "no reference within 25 m"
    by_order: bool = False  # whether the order of the images says what is right
    known: bool = True  # False: nobody knows which places are right
    references: Numbers | None = None  # those of all that it is about, ascending; None: all
    queries: Numbers | None = None
    jumps: tuple[Starts, Starts] = (NO_STARTS, NO_STARTS)  # of these references and queries, where the position jumps
    place_numbers: Places | None = None  # (n_places,), ascending, if places have numbers of their own
    protocol: Mapping[str, Any] = field(default_factory=dict)  # what was chosen where the data left a choice
    notes: Sequence[str] = ()


def make_ground_truth(n_references: int, right: Iterable[npt.ArrayLike], lacking: str) -> GroundTruth:
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
    protocol: Mapping[str, Any],
    notes: Sequence[str] = (),
    **options: Unpack[FileOptions],
) -> Dataset:
    """Return the dataset of these files or images; options that are not given are those of published files.

    Args:
        name: the name of the dataset.
        references: the images of the map.
        queries: the images that are queried.
        truth: the ground truth; of an unknown one all queries stay.
        protocol: the protocol of the dataset.
        notes: what a reader of results has to know.
        options: how files are read, and what becomes of queries without a right place.

    Raises:
        BadInput: queries without a right place are an error, or no others are left; levels that the files leave open.
    """
    files = Paths.joined(Paths.of(part) for part in (references, queries) if not isinstance(part, Images))
    chosen = PUBLISHED_FILES | options
    unmatched = chosen["unmatched"]
    decoding, decoded = decoding_of(files, chosen["exif"], chosen["levels"], "dataset.")
    references, queries = _choose(references, truth.references), _choose(queries, truth.queries)
    kept, lack = _choose_queries(truth, unmatched, queries)
    starts = find_drives(references, queries, chosen["breaks"], truth.jumps)
    place_starts = starts.find_place_starts(truth.places)
    place_gaps = _find_gaps(np.arange(len(references)) if truth.references is None else truth.references)
    query_gaps = _find_gaps(kept if truth.queries is None else truth.queries[kept])
    query_starts = np.flatnonzero(np.diff(np.searchsorted(starts.queries, kept, side="right"))) + 1
    map_images, query_images = (
        part if isinstance(part, Images) else Images.from_files(part, decoding) for part in (references, queries)
    )
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
            **({"breaks": starts.seen_by} if len(place_starts) or len(starts.queries) else {}),
            **decoded,
        },
        place_numbers=truth.place_numbers,
        query_breaks=np.union1d(query_gaps, query_starts),
        place_breaks=np.union1d(place_gaps, place_starts),
        by_order=truth.by_order,
        folders=tuple(
            FrameFolder(folder, tuple(dict.fromkeys(files[which].names))) for folder, which in files.in_folders()
        ),
        notes=(*notes, *truth.notes, *lack),
    )


def _choose_queries(
    truth: GroundTruth, unmatched: Unmatched, queries: Sequence[Path] | Images
) -> tuple[Numbers, list[str]]:
    """Return the numbers of the queries that are kept, and a note on those without a right place, if any."""
    everything = np.arange(len(queries))
    if not truth.known:
        return everything, ["there is no ground truth, so no answer is judged (ground_truth=none)"]
    without = np.flatnonzero([not len(right) for right in truth.positives])
    if not len(without):
        return everything, []
    lack = f"{len(without)} of {len(queries)} queries have {truth.lacking}"
    if unmatched == "keep":
        return everything, [f"{lack}; they count as misses (dataset.unmatched=keep)"]
    if unmatched == "error":
        first = queries.names[without[0]] if isinstance(queries, Images) else queries[without[0]]
        raise BadInput(
            f"{lack} (first: {first}): correct the data, pass dataset.unmatched=keep to count them as misses, or "
            "dataset.unmatched=drop to leave them out"
        )
    if len(without) == len(queries):
        raise BadInput(f"{lack}, and dataset.unmatched=drop leaves none: check that both folders show the same places")
    return np.setdiff1d(everything, without), [f"{lack}; they are left out (dataset.unmatched=drop)"]


def _choose(images: Sequence[Path] | Images, numbers: Numbers | None) -> Paths | Images:
    """Return the files or images of these numbers, all if there are no numbers."""
    found = images if isinstance(images, Images) else Paths.of(images)
    return found if numbers is None else found[numbers]


def _find_gaps(numbers: Numbers) -> Starts:
    """Return which of some numbers, by their rank, come after others that were left out."""
    return np.flatnonzero(np.diff(numbers) > 1) + 1

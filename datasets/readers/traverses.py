"""Traverses of the same places: which are mapped, queried and held out, which are right, and what recordings refuse."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, Dataset, FrameFolder, HeldOut, Images

Evaluation = Literal["vprtempo", "vprsnn"]  # whose way to split places
Listed = TypeVar("Listed")
Numbers = npt.NDArray[np.int64]  # (n,), of places along the journey, ascending

_SET_ASIDE_SEED = 42  # QVPR/VPRSNN d38f30c


@dataclass(frozen=True)
class Split:
    """Which places of a journey are in the map, which are queried and which are held out, by their numbers there.

    The dataset numbers the places of its map anew: 0 is the first of `mapped`.
    """

    mapped: Numbers
    queried: Numbers
    held_out: Numbers
    held_out_in_map: bool  # whether the references of held-out places are searched too
    tolerance: int  # places along the journey
    query_stride: int = 1  # places of the map from one query to the next

    def list_needed_queries(self) -> list[int]:
        """Return the places whose images of the query traverse have to be there whatever the method.

        Those of held-out places that the map holds matter to a method that calibrates alone.
        """
        needed = self.queried if self.held_out_in_map else np.union1d(self.queried, self.held_out)
        return [int(place) for place in needed]

    def describe(self) -> dict[str, Any]:
        """Return what of the split belongs to the protocol of a dataset, but for its name."""
        held_out = len(self.held_out)
        return {
            "places": len(self.mapped) + (0 if self.held_out_in_map else held_out),
            "query_places": len(self.queried),
            **({"first_query_place": held_out} if self.held_out_in_map else {}),
            **({"query_stride": self.query_stride} if self.query_stride != 1 else {}),
            "reference_places": len(self.mapped),
            "held_out_places": held_out,
            "tolerance_places": self.tolerance,
        }


def split_places(
    protocol: Evaluation, places: int, first_query_place: int, query_places: int, tolerance: int, query_stride: int = 1
) -> Split:
    """Split the places 0 to `places` - 1 as the authors of VPRTempo or of VPRSNN do.

    vprtempo: all places are in the map, those before `first_query_place` are held out and `query_places` from there on
    are queried, `query_stride` apart. vprsnn: as many places as `first_query_place` says are set aside; the others
    alone are in the map, and `query_places` from the first of them on are queried. Raises BadInput for queries that do
    not fit, and for a stride that is no number of places.
    """
    if query_stride < 1 or (query_stride > 1 and protocol == "vprsnn"):
        raise BadInput(
            f"dataset.query_stride={query_stride} with dataset.protocol={protocol}: give 1 or more places from one "
            "query to the next, and 1 with vprsnn"
        )
    last = first_query_place + (query_places - 1) * query_stride
    if query_places < 1 or first_query_place < 0 or last >= places:
        raise BadInput(
            f"dataset.first_query_place={first_query_place} and dataset.query_places={query_places} "
            f"(dataset.query_stride={query_stride}, dataset.protocol={protocol}) need {last + 1} places, and there are "
            f"{places}: give 0 or more before the first query, or to set aside, and 1 or more queries, so that both fit"
        )
    numbers = np.arange(places, dtype=np.int64)
    if protocol == "vprtempo":
        queried = numbers[first_query_place::query_stride][:query_places]
        return Split(numbers, queried, numbers[:first_query_place], True, tolerance, query_stride)
    held_out = np.sort(np.random.RandomState(_SET_ASIDE_SEED).permutation(places)[:first_query_place])
    mapped = np.setdiff1d(numbers, held_out)
    return Split(mapped, mapped[:query_places], held_out, False, tolerance)


def make_dataset(
    name: str,
    split: Split,
    references: Sequence[str],
    query: str,
    show: Callable[[Sequence[tuple[str, int]]], Images],
    protocol: Mapping[str, Any],
    *,
    folders: Sequence[FrameFolder] = (),
    numbers: Sequence[int] | None = None,
    notes: Sequence[str] = (),
) -> Dataset:
    """Return the dataset of a split of traverses.

    Args:
        name: the name of the dataset.
        split: which places are mapped, queried and held out.
        references: the traverses of the map.
        query: the traverse of the queries.
        show: returns the images of (traverse, place), numbered along the journey.
        protocol: the protocol of the dataset.
        folders: where the frames lie.
        numbers: of the frames of all places; None: no frames are missing between them.
        notes: what a reader of results has to know.
    """

    def show_all(traverses: Sequence[str], places: Numbers) -> Images:
        return show([(traverse, place) for traverse in traverses for place in places.tolist()])

    held_out = (
        HeldOut(
            references=show_all(references, split.held_out),
            places=np.tile(np.arange(len(split.held_out)), len(references)),
            queries=show_all([query], split.held_out),
            right=np.arange(len(split.held_out)),
            in_map=split.held_out_in_map,
        )
        if len(split.held_out)
        else None
    )
    return Dataset(
        name=name,
        references=show_all(references, split.mapped),
        places=np.tile(np.arange(len(split.mapped)), len(references)),
        queries=show_all([query], split.queried),
        positives=match_numbers(split.queried, split.mapped, split.tolerance),
        protocol=protocol,
        held_out=held_out,
        place_numbers=None if split.held_out_in_map else split.mapped,
        query_breaks=find_breaks(split.queried, numbers),
        place_breaks=find_breaks(split.mapped, numbers),
        folders=tuple(folders),
        notes=tuple(notes),
    )


def find_breaks(places: Numbers, numbers: Sequence[int] | None = None) -> Numbers:
    """Return which of some places, by their rank, come after missing frames: a step longer than the shortest.

    `numbers` are those of the frames of all places; None: no frames are missing between them.
    """
    steps = np.diff(places if numbers is None else np.asarray(numbers)[places])
    return np.flatnonzero(steps > steps.min(initial=np.iinfo(np.int64).max)) + 1


def match_numbers(queried: Numbers, mapped: Numbers, tolerance: int) -> tuple[Numbers, ...]:
    """Return for each query which of the mapped places lie at most `tolerance` places away, by their places in it.

    Raises BadInput for a negative tolerance.
    """
    if tolerance < 0:
        raise BadInput(f"dataset.tolerance={tolerance}: give 0 or more places")
    reach = min(tolerance, int(max(queried.max(), mapped.max())))  # further than any place; sums stay 64-bit numbers
    first = np.searchsorted(mapped, queried - reach, side="left").tolist()
    last = np.searchsorted(mapped, queried + reach, side="right").tolist()
    return tuple(np.arange(low, high, dtype=np.int64) for low, high in zip(first, last, strict=True))


def take_every(listed: Sequence[Listed], stride: int, places: int) -> list[Listed]:
    """Return every `stride`-th entry of a list, one a place; raises BadInput if the list is too short."""
    most = len(listed[::stride]) if stride > 0 else 0
    if not 1 <= places <= most:
        raise BadInput(
            f"dataset.places={places}: the list of {len(listed)} names at dataset.stride={stride} has {most} places, "
            "so set dataset.places and dataset.query_places to fit, from 1 on"
        )
    return list(listed[: places * stride : stride])


def check_traverses(owner: str, kind: str, known: Collection[str], references: Sequence[str], query: str) -> None:
    """Raise BadInput for traverses that the recordings of `owner` lack, and for references named twice or not at all.

    `kind` is what a traverse is called there, as in "season".
    """
    check_references(references, kind)
    for option, traverse in [*(("references", traverse) for traverse in references), ("query", query)]:
        if traverse not in known:
            raise BadInput(f"dataset.{option}={traverse}: {owner} has {', '.join(known)}")


def check_references(references: Sequence[str], kind: str) -> None:
    """Raise BadInput for references that are no list, empty, or named twice; `kind` is as in "season"."""
    if isinstance(references, str) or not references or len(set(references)) < len(references):
        raise BadInput(f"dataset.references={references!r}: name at least one {kind}, each once, as a list")

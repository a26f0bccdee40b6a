"""Traverses of the same places: which are right for a query, and checks of what is asked of recordings."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
import numpy.typing as npt

from vprbench.interface import BadInput


def right_places(first: int, count: int, places: int, tolerance: int) -> tuple[npt.NDArray[np.int64], ...]:
    """Return for each of `count` queries, the first at place `first`, the places at most `tolerance` places away."""
    return tuple(
        np.arange(max(place - tolerance, 0), min(place + tolerance, places - 1) + 1, dtype=np.int64)
        for place in range(first, first + count)
    )


def places_of(places: int, traverses: int) -> npt.NDArray[np.int64]:
    """Return the place of every reference image of so many traverses, one after the other."""
    return np.tile(np.arange(places, dtype=np.int64), traverses)


def check_recorded(owner: str, kind: str, known: Collection[str], references: Sequence[str], query: str) -> None:
    """Raise BadInput for traverses that the recordings of `owner` lack, and for references named twice or not at all.

    `kind` is what a traverse is called there, as in "season".
    """
    for option, traverse in [*(("references", traverse) for traverse in references), ("query", query)]:
        if traverse not in known:
            raise BadInput(f"dataset.{option}={traverse}: {owner} has {', '.join(known)}")
    if not references or len(set(references)) < len(references):
        raise BadInput(f"dataset.references={[*references]}: name at least one {kind}, each once")


def check_recorded_range(places: int, first_query_place: int, query_places: int, tolerance: int) -> None:
    """Raise BadInput for queries outside of the places 0 to `places` - 1, and for a negative tolerance."""
    last = first_query_place + query_places
    if query_places < 1 or first_query_place < 0 or last > places:
        raise BadInput(
            f"dataset.first_query_place={first_query_place} and dataset.query_places={query_places} ask for places "
            f"{first_query_place} to {last - 1}; wanted are one or more of the places 0 to {places - 1}"
        )
    if tolerance < 0:
        raise BadInput(f"dataset.tolerance={tolerance}: give 0 or more places")

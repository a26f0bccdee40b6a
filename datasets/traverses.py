"""Traverses of the same places: checks of what was asked for, and which places are right for a query."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True)
class Rendered:
    """What a rendered dataset can be asked for, and what things are called there."""

    journey: str  # as in "the synthetic journey"
    kind: str  # what a traverse is called, as in "season"
    known: tuple[str, ...]
    fewest_places: int
    most_places: int
    skipped: tuple[int, int]  # without a first query place, this share of the places is not queried

    def check(
        self,
        places: int,
        references: Sequence[str],
        query: str,
        first_query_place: int | None,
        query_places: int | None,
        tolerance: int,
        seed: int,
    ) -> tuple[int, int]:
        """Return the first query place and the number of queries; raises BadInput for what cannot be rendered."""
        if not self.fewest_places <= places <= self.most_places:
            raise BadInput(
                f"dataset.places={places} came; {self.journey} has {self.fewest_places} to {self.most_places} places"
            )
        first, count = self._queries(places, first_query_place, query_places)
        if tolerance < 0:
            raise BadInput(f"dataset.tolerance={tolerance} came; a number of places, 0 or more, was wanted")
        if seed < 0:
            raise BadInput(f"dataset.seed={seed} came; a whole number, 0 or more, was wanted")
        self._check_traverses(references, query)
        return first, count

    def _queries(self, places: int, first_query_place: int | None, query_places: int | None) -> tuple[int, int]:
        part, whole = self.skipped
        first = round(places * part / whole) if first_query_place is None else first_query_place
        if not 0 <= first < places:
            raise BadInput(
                f"dataset.first_query_place={first} came, but the places run from 0 to {places - 1}: choose one"
            )
        count = places - first if query_places is None else query_places
        if not 1 <= count <= places - first:
            raise BadInput(
                f"dataset.query_places={count} came, but from place {first} to the last of {places} there are "
                f"1 to {places - first} to query"
            )
        return first, count

    def _check_traverses(self, references: Sequence[str], query: str) -> None:
        listed = ", ".join(self.known)
        if isinstance(references, str) or not references:
            raise BadInput(f"dataset.references={references!r} came; wanted at least one of {listed}, as a list")
        if len(set(references)) < len(references):
            raise BadInput(f"dataset.references={list(references)} came; name each {self.kind} once")
        for option, traverse in [("references", traverse) for traverse in references] + [("query", query)]:
            if traverse not in self.known:
                raise BadInput(f"dataset.{option}={traverse} came; the {self.kind}s are {listed}")

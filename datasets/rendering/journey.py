"""A journey that is rendered when looked at: what may be asked of it, and the dataset that answers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from vprbench.api import BadInput, Dataset, Image, Images

from ..traverses import Evaluation, dataset_of, split
from .film import HEIGHT, WIDTH

_BEYOND = 100  # places between the last one of the map and the first that has no right answer


class Painter(Protocol):
    """Renders any place of the journey of one seed; several threads may share it."""

    def render(self, traverse: str, place: int, /) -> Image:
        """Return the frame of a place, uint8 (HEIGHT, WIDTH, 3), RGB."""


@dataclass(frozen=True)
class Rendered:
    """What a rendered dataset can be asked for, what things are called there, and who renders it."""

    journey: str  # as in "the synthetic journey"
    kind: str  # what a traverse is called, as in "season"
    known: tuple[str, ...]
    fewest_places: int
    most_places: int
    skipped: tuple[int, int]  # without a first query place, this share of the places is not queried
    painter: Callable[[int], Painter]  # of a seed
    version: int  # of what the painter paints

    def dataset(
        self,
        name: str,
        places: int,
        references: Sequence[str],
        query: str,
        first_query_place: int | None,
        query_places: int | None,
        tolerance: int,
        seed: int,
        protocol: Evaluation = "vprtempo",
        query_shift: int = 0,
        unanswerable: int = 0,
    ) -> Dataset:
        """Return the dataset of what was asked for; raises BadInput for what cannot be rendered.

        Each query shows the place `query_shift` further on than its ground truth says, and `unanswerable` more queries
        show places that the map lacks and that have no right answer: damage on purpose, whose effect is known.
        """
        if not self.fewest_places <= places <= self.most_places:
            raise BadInput(
                f"dataset.places={places} came; {self.journey} has {self.fewest_places} to {self.most_places} places"
            )
        first, count = self._queries(places, first_query_place, query_places, protocol)
        if tolerance < 0:
            raise BadInput(f"dataset.tolerance={tolerance} came; a number of places, 0 or more, was wanted")
        if seed < 0:
            raise BadInput(f"dataset.seed={seed} came; a whole number, 0 or more, was wanted")
        self._check_traverses(references, query)
        if first + query_shift < 0:
            raise BadInput(
                f"dataset.query_shift={query_shift} came; the first query, of place {first}, has no such frame"
            )
        if unanswerable < 0:
            raise BadInput(f"dataset.unanswerable={unanswerable} came; a number of queries, 0 or more, was wanted")
        painter = self.painter(seed)
        parts = split(protocol, places, first, count, tolerance)
        dataset = dataset_of(
            name,
            parts,
            references,
            query,
            partial(_frames, painter),
            {
                "protocol": protocol,
                "references": list(references),
                "query": query,
                **parts.record(),
                "seed": seed,
                "width": WIDTH,
                "height": HEIGHT,
                "renderer": self.version,
                **({"query_shift": query_shift} if query_shift else {}),
                **({"unanswerable": unanswerable} if unanswerable else {}),
            },
        )
        if not query_shift and not unanswerable:
            return dataset
        beyond = np.arange(unanswerable) + places + _BEYOND + abs(query_shift)
        shown = [(query, place) for place in (*(parts.queried + query_shift).tolist(), *beyond.tolist())]
        none = np.array([], dtype=np.int64)
        return replace(dataset, queries=_frames(painter, shown), positives=(*dataset.positives, *[none] * unanswerable))

    def _queries(
        self, places: int, first_query_place: int | None, query_places: int | None, protocol: Evaluation
    ) -> tuple[int, int]:
        part, whole = self.skipped
        first = round(places * part / whole) if first_query_place is None else first_query_place
        if not 0 <= first < places:
            raise BadInput(
                f"dataset.first_query_place={first} came, but the places run from 0 to {places - 1}: choose one"
            )
        count = places - first if query_places is None else query_places
        if not 1 <= count <= places - first:
            left = f"from place {first} to the last of {places}"
            if protocol == "vprsnn":
                left = f"of {places} places, {first} of them set aside (dataset.first_query_place),"
            raise BadInput(f"dataset.query_places={count} came, but {left} there are 1 to {places - first} to query")
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


def _frames(painter: Painter, shown: Sequence[tuple[str, int]]) -> Images:
    """Return the frames of (traverse, place), each rendered when it is looked at."""
    return Images(lambda i: painter.render(*shown[i]), [f"{traverse}/place-{place:05d}" for traverse, place in shown])

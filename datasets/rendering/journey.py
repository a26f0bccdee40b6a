"""A journey that is rendered when looked at: what may be asked of it, and the dataset that answers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Protocol

import numpy as np

from vprbench.api import BadInput, Dataset, Image, Images

from ..readers.traverses import Evaluation, Traverses, dataset_of, split
from .film import HEIGHT, WIDTH

_BEYOND = 100  # places between the last one of the map and the first that has no right answer


class Painter(Protocol):
    """Renders any place of the journey of one seed; several threads may share it."""

    def render(self, traverse: str, place: int, /) -> Image:
        """Return the frame of a place, uint8 (HEIGHT, WIDTH, 3), RGB."""


@dataclass(frozen=True)
class World:
    """What can be rendered, what things are called there, and who renders it."""

    journey: str  # as in "the synthetic journey"
    kind: str  # what a traverse is called, as in "season"
    known: tuple[str, ...]
    fewest_places: int
    most_places: int
    skipped: tuple[int, int]  # without a first query place, this share of the places is not queried
    painter: Callable[[int], Painter]  # of a seed
    version: int  # of what the painter paints


@dataclass(frozen=True)
class Rendered:
    """The options of a rendered dataset.

    Each query shows the place `query_shift` further on than its ground truth says, and `unanswerable` more queries
    show places that the map lacks and that have no right answer: damage on purpose, whose effect is known.
    """

    name: str
    places: int
    references: Sequence[str]
    query: str
    first_query_place: int | None = None
    query_places: int | None = None
    tolerance: int = 0
    seed: int = 0
    protocol: Evaluation = "vprtempo"
    query_shift: int = 0
    unanswerable: int = 0
    world: ClassVar[World]

    def build(self) -> Dataset:
        """Return the dataset of these options; raises BadInput for what cannot be rendered."""
        first, count = self._checked()
        painter = self.world.painter(self.seed)
        parts = split(self.protocol, self.places, first, count, self.tolerance)
        dataset = dataset_of(
            self.name,
            parts,
            Traverses(self.references, self.query, partial(_frames, painter)),
            {
                "protocol": self.protocol,
                "references": list(self.references),
                "query": self.query,
                **parts.record(),
                "seed": self.seed,
                "width": WIDTH,
                "height": HEIGHT,
                "renderer": self.world.version,
                **({"query_shift": self.query_shift} if self.query_shift else {}),
                **({"unanswerable": self.unanswerable} if self.unanswerable else {}),
            },
        )
        if not self.query_shift and not self.unanswerable:
            return dataset
        beyond = np.arange(self.unanswerable) + self.places + _BEYOND + abs(self.query_shift)
        shown = [(self.query, place) for place in (*(parts.queried + self.query_shift).tolist(), *beyond.tolist())]
        none = [np.array([], dtype=np.int64)] * self.unanswerable
        return replace(dataset, queries=_frames(painter, shown), positives=(*dataset.positives, *none))

    def _checked(self) -> tuple[int, int]:
        """Return the first query place and the number of queries; raises BadInput for what cannot be rendered."""
        world = self.world
        if not world.fewest_places <= self.places <= world.most_places:
            raise BadInput(
                f"dataset.places={self.places} came; {world.journey} has {world.fewest_places} to {world.most_places} "
                "places"
            )
        first, count = self._queries()
        if self.tolerance < 0:
            raise BadInput(f"dataset.tolerance={self.tolerance} came; a number of places, 0 or more, was wanted")
        if self.seed < 0:
            raise BadInput(f"dataset.seed={self.seed} came; a whole number, 0 or more, was wanted")
        self._check_traverses()
        if first + self.query_shift < 0:
            raise BadInput(
                f"dataset.query_shift={self.query_shift} came; the first query, of place {first}, has no such frame"
            )
        if self.unanswerable < 0:
            raise BadInput(f"dataset.unanswerable={self.unanswerable} came; a number of queries, 0 or more, was wanted")
        return first, count

    def _queries(self) -> tuple[int, int]:
        places, (part, whole) = self.places, self.world.skipped
        first = round(places * part / whole) if self.first_query_place is None else self.first_query_place
        if not 0 <= first < places:
            raise BadInput(
                f"dataset.first_query_place={first} came, but the places run from 0 to {places - 1}: choose one"
            )
        count = places - first if self.query_places is None else self.query_places
        if not 1 <= count <= places - first:
            left = f"from place {first} to the last of {places}"
            if self.protocol == "vprsnn":
                left = f"of {places} places, {first} of them set aside (dataset.first_query_place),"
            raise BadInput(f"dataset.query_places={count} came, but {left} there are 1 to {places - first} to query")
        return first, count

    def _check_traverses(self) -> None:
        references, known, listed = self.references, self.world.known, ", ".join(self.world.known)
        if isinstance(references, str) or not references:
            raise BadInput(f"dataset.references={references!r} came; wanted at least one of {listed}, as a list")
        if len(set(references)) < len(references):
            raise BadInput(f"dataset.references={list(references)} came; name each {self.world.kind} once")
        for option, traverse in [("references", traverse) for traverse in references] + [("query", self.query)]:
            if traverse not in known:
                raise BadInput(f"dataset.{option}={traverse} came; the {self.world.kind}s are {listed}")


def _frames(painter: Painter, shown: Sequence[tuple[str, int]]) -> Images:
    """Return the frames of (traverse, place), each rendered when it is looked at."""
    return Images(lambda i: painter.render(*shown[i]), [f"{traverse}/place-{place:05d}" for traverse, place in shown])

"""A journey that is rendered when looked at: what may be asked of it, and the dataset that answers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Protocol

import numpy as np

from vprbench.api import BadInput, Dataset, Image, Images, cached_frames

from ..readers.traverses import Evaluation, Traverses, check_recorded, dataset_of, split
from .film import HEIGHT, WIDTH

_BEYOND = 100  # places between the last one of the map and the first that has no right answer


class Painter(Protocol):
    """Renders any place of the journey of one seed; several threads may share it."""

    def render(self, traverse: str, place: int, ahead: int = 0, /) -> Image:
        """Return the frame of a place, or from 1/16 metres `ahead` of it, uint8 (HEIGHT, WIDTH, 3), RGB."""


@dataclass(frozen=True)
class World:
    """What can be rendered, what things are called there, and who renders it."""

    journey: str  # as in "the synthetic journey"
    kind: str  # what a traverse is called, as in "season"
    known: tuple[str, ...]
    skipped: tuple[int, int]  # without a first query place, this share of the places is not queried
    painter: Callable[[int], Painter]  # of a seed
    version: int  # of what the painter paints
    fewest_places: int = 10
    most_places: int = 27_000


@dataclass(frozen=True)
class Rendered:
    """The options of a rendered dataset: traverses of one journey, as RGB frames of 160 x 90.

    Place k of a seed looks the same however many places are asked for: more places are a longer journey. Without
    `first_query_place` a share of the places (that of the world) is not queried; without `query_places` the queries run
    to the last place. A query's right places are those within `tolerance` places of its own. With the protocol of
    VPRSNN as many places, chosen as its authors do, are in neither map nor queries instead.

    Damage on purpose, whose effect is known, tests harnesses and methods: each query shows the place `query_shift`
    further on than its ground truth says, and `unanswerable` more queries show places beyond the map.
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
        self._check()
        world = self._world()
        part, whole = world.skipped
        first = round(self.places * part / whole) if self.first_query_place is None else self.first_query_place
        count = self.places - first if self.query_places is None else self.query_places
        parts = split(self.protocol, self.places, first, count, self.tolerance)
        if first + self.query_shift < 0:
            raise BadInput(
                f"dataset.query_shift={self.query_shift}: the first query, of place {first}, has no such frame"
            )
        frames = partial(_frames, world.painter(self.seed), {"journey": world.journey, **self._painted()})
        damage = {"query_shift": self.query_shift, "unanswerable": self.unanswerable}
        dataset = dataset_of(
            self.name,
            parts,
            Traverses(self.references, self.query, frames),
            {
                "protocol": self.protocol,
                "references": list(self.references),
                "query": self.query,
                **parts.record(),
                **self._painted(),
                **{name: amount for name, amount in damage.items() if amount},
            },
        )
        if not any(damage.values()):
            return dataset
        beyond = np.arange(self.unanswerable) + self.places + _BEYOND + abs(self.query_shift)
        shown = [(self.query, place) for place in (*(parts.queried + self.query_shift).tolist(), *beyond.tolist())]
        none = [np.array([], dtype=np.int64)] * self.unanswerable
        return replace(dataset, queries=frames(shown), positives=(*dataset.positives, *none))

    def _world(self) -> World:
        """Return what can be rendered under these options."""
        return self.world

    def _painted(self) -> dict[str, Any]:
        """Return what decides about the frame of a place, for a record."""
        return {"seed": self.seed, "width": WIDTH, "height": HEIGHT, "renderer": self._world().version}

    def _check(self) -> None:
        """Raise BadInput for traverses and numbers that nobody can render."""
        world = self._world()
        if not world.fewest_places <= self.places <= world.most_places:
            least, most = world.fewest_places, world.most_places
            raise BadInput(f"dataset.places={self.places}: {world.journey} has {least} to {most} places")
        check_recorded(world.journey, world.kind, world.known, self.references, self.query)
        for option, number in (("seed", self.seed), ("unanswerable", self.unanswerable)):
            if number < 0:
                raise BadInput(f"dataset.{option}={number}: give 0 or more")


def _frames(painter: Painter, painted: Mapping[str, Any], shown: Sequence[tuple[str, int]]) -> Images:
    """Return the frames of (traverse, place), each rendered when it is looked at; `painted` decides how they look."""
    names = [f"{traverse}/place-{place:05d}" for traverse, place in shown]
    return cached_frames(Images(lambda i: painter.render(*shown[i]), names), painted)

"""Dataset `synthetic`: a seeded railway journey in four seasons, rendered when looked at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from vprbench.api import BadInput, Dataset, Images, cached_frames

from ..readers.recipes import function_of
from ..readers.traverses import Evaluation, Traverses, check_recorded, dataset_of, split
from .film import HEIGHT, WIDTH
from .renderer import VERSION, Renderer
from .seasons import SEASONS

_JOURNEY = "the synthetic journey"
_FEWEST, _MOST = 10, 27_000  # places
_BEYOND = 100  # places between the last one of the map and the first that has no right answer


@dataclass(frozen=True)
class Synthetic:
    """Traverses of one journey in several seasons, as RGB frames of 160 x 90.

    Place k of a seed looks the same however many places there are: more places are a longer journey. Without
    `first_query_place` the first 2/11 of the places are not queried (600 of 3300, as in the VPRTempo paper); without
    `query_places` the queries run to the last place. A query's right places are those within `tolerance` places of its
    own. With the protocol of VPRSNN as many places, chosen as its authors do, are in neither map nor queries instead.

    Damage on purpose, whose effect is known, tests harnesses and methods: each query shows the place `query_shift`
    further on than its ground truth says, and `unanswerable` more queries show places beyond the map. Raises BadInput
    for a season that does not exist and for queries outside the journey.

    >>> synthetic(places=100, query="winter").queries.names[0]
    'winter/place-00018'
    """

    name: str = "synthetic"
    places: int = 3300
    references: Sequence[str] = ("spring", "fall")
    query: str = "summer"
    first_query_place: int | None = None
    query_places: int | None = None
    tolerance: int = 0
    seed: int = 0
    protocol: Evaluation = "vprtempo"
    query_shift: int = 0
    unanswerable: int = 0

    def build(self) -> Dataset:
        """Return the dataset of these options; raises BadInput for what cannot be rendered."""
        self._check()
        first = round(self.places * 2 / 11) if self.first_query_place is None else self.first_query_place
        count = self.places - first if self.query_places is None else self.query_places
        parts = split(self.protocol, self.places, first, count, self.tolerance)
        if first + self.query_shift < 0:
            raise BadInput(
                f"dataset.query_shift={self.query_shift}: the first query, of place {first}, has no such frame"
            )
        appearance = {"seed": self.seed, "width": WIDTH, "height": HEIGHT, "renderer": VERSION}
        frames = partial(_frames, Renderer(self.seed), {"journey": _JOURNEY, **appearance})
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
                **appearance,
                **{name: amount for name, amount in damage.items() if amount},
            },
        )
        if not any(damage.values()):
            return dataset
        beyond = np.arange(self.unanswerable) + self.places + _BEYOND + abs(self.query_shift)
        shown = [(self.query, place) for place in (*(parts.queried + self.query_shift).tolist(), *beyond.tolist())]
        none = [np.array([], dtype=np.int64)] * self.unanswerable
        return replace(dataset, queries=frames(shown), positives=(*dataset.positives, *none))

    def _check(self) -> None:
        """Raise BadInput for traverses and numbers that nobody can render."""
        if not _FEWEST <= self.places <= _MOST:
            raise BadInput(f"dataset.places={self.places}: {_JOURNEY} has {_FEWEST} to {_MOST} places")
        check_recorded(_JOURNEY, "season", tuple(SEASONS), self.references, self.query)
        for option, number in (("seed", self.seed), ("unanswerable", self.unanswerable)):
            if number < 0:
                raise BadInput(f"dataset.{option}={number}: give 0 or more")


synthetic = function_of(Synthetic)


def _frames(renderer: Renderer, appearance: Mapping[str, Any], shown: Sequence[tuple[str, int]]) -> Images:
    """Return the frames of (season, place), each rendered when it is looked at; `appearance` identifies them."""
    names = [f"{season}/place-{place:05d}" for season, place in shown]
    return cached_frames(Images(lambda i: renderer.render(*shown[i]), names), appearance)

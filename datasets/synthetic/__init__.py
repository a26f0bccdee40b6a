"""Dataset `synthetic`: a seeded railway journey in four seasons, rendered when looked at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from ..readers.recipes import function_of
from ..rendering.journey import Rendered, World
from .renderer import VERSION, Renderer
from .seasons import SEASONS


@dataclass(frozen=True)
class Synthetic(Rendered):
    """Traverses of one journey in several seasons, as RGB frames of 160 x 90.

    Place k of a seed looks the same however many places are asked for: more places are a longer journey.
    Without `first_query_place` the first 2/11 of the places are not queried (600 of 3300, as in the VPRTempo
    paper); without `query_places` the queries run to the last place. A query's right places are those within
    `tolerance` places of its own. With the protocol of VPRSNN as many places, chosen as its authors do, are in
    neither map nor queries instead. For tests of harnesses and methods, each query can show the place `query_shift`
    further on than its ground truth says, and `unanswerable` more queries places beyond the map.

    Raises BadInput for a season that does not exist and for queries outside the journey.

    >>> synthetic(places=100, query="winter").queries.names[0]
    'winter/place-00018'
    """

    name: str = "synthetic"
    places: int = 3300
    references: Sequence[str] = ("spring", "fall")
    query: str = "summer"
    world: ClassVar = World(
        journey="the synthetic journey",
        kind="season",
        known=tuple(SEASONS),
        fewest_places=10,
        most_places=27_000,
        skipped=(2, 11),
        painter=Renderer,
        version=VERSION,
    )


synthetic = function_of(Synthetic)

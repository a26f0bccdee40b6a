"""Dataset `street`: a seeded drive through a city in sun, in rain and at dusk, rendered when looked at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from ..readers.recipes import function_of
from ..rendering.journey import Rendered, World
from .renderer import VERSION, Renderer
from .weather import WEATHERS


@dataclass(frozen=True)
class Street(Rendered):
    """Traverses of one drive in several weathers, as RGB frames of 160 x 90.

    Place k of a seed looks the same however many places are asked for: more places are a longer drive. Without
    `first_query_place` the first fifth of the places is not queried (90 of 450, as the VPRTempo paper does with Oxford
    RobotCar); without `query_places` the queries run to the last place. A query's right places are those within
    `tolerance` places of its own. With the protocol of VPRSNN as many places, chosen as its authors do, are in
    neither map nor queries instead. For tests of harnesses and methods, each query can show the place `query_shift`
    further on than its ground truth says, and `unanswerable` more queries places beyond the map.

    Raises BadInput for a traverse that does not exist and for queries outside the drive.

    >>> street(places=100).queries.names[0]
    'dusk/place-00020'
    """

    name: str = "street"
    places: int = 450
    references: Sequence[str] = ("sun", "rain")
    query: str = "dusk"
    world: ClassVar = World(
        journey="the city street",
        kind="traverse",
        known=tuple(WEATHERS),
        fewest_places=10,
        most_places=27_000,
        skipped=(1, 5),
        painter=Renderer,
        version=VERSION,
    )


street = function_of(Street)

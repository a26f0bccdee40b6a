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
    """Traverses of one drive in several weathers; the options are those of `Rendered`.

    By default the first fifth of the places is not queried (90 of 450, as the VPRTempo paper does with Oxford
    RobotCar). Raises BadInput for a traverse that does not exist and for queries outside the drive.

    >>> street(places=100).queries.names[0]
    'dusk/place-00020'
    """

    name: str = "street"
    places: int = 450
    references: Sequence[str] = ("sun", "rain")
    query: str = "dusk"
    world: ClassVar = World("the city street", "traverse", tuple(WEATHERS), (1, 5), Renderer, VERSION)


street = function_of(Street)

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
    """Traverses of one journey in several seasons; the options are those of `Rendered`.

    By default the first 2/11 of the places are not queried (600 of 3300, as in the VPRTempo paper). Raises BadInput for
    a season that does not exist and for queries outside the journey.

    >>> synthetic(places=100, query="winter").queries.names[0]
    'winter/place-00018'
    """

    name: str = "synthetic"
    places: int = 3300
    references: Sequence[str] = ("spring", "fall")
    query: str = "summer"
    world: ClassVar = World("the synthetic journey", "season", tuple(SEASONS), (2, 11), Renderer, VERSION)


synthetic = function_of(Synthetic)

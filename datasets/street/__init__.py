"""Dataset `street`: a seeded drive through a city in sun, in rain and at dusk, rendered when looked at."""

from __future__ import annotations

from collections.abc import Sequence

from vprbench.interface import Dataset

from ..rendering.film import HEIGHT, WIDTH, frames
from ..traverses import Rendered, places_of, right_places
from .renderer import VERSION, Renderer
from .weather import WEATHERS

_DRIVE = Rendered("the city street", "traverse", tuple(WEATHERS), 10, 27_000, skipped=(1, 5))


def street(
    name: str = "street",
    places: int = 450,
    references: Sequence[str] = ("sun", "rain"),
    query: str = "dusk",
    first_query_place: int | None = None,
    query_places: int | None = None,
    tolerance: int = 0,
    seed: int = 0,
) -> Dataset:
    """Return traverses of one drive in several weathers, as RGB frames of 160 x 90.

    Place k of a seed looks the same however many places are asked for: more places are a longer drive. Without
    `first_query_place` the first fifth of the places is not queried (90 of 450, as the VPRTempo paper does with Oxford
    RobotCar); without `query_places` the queries run to the last place. A query's right places are those within
    `tolerance` places of its own.

    Raises BadInput for a traverse that does not exist and for queries outside the drive.

    >>> street(places=100).queries.names[0]
    'dusk/place-00020'
    """
    first, count = _DRIVE.check(places, references, query, first_query_place, query_places, tolerance, seed)
    renderer = Renderer(seed)
    return Dataset(
        name=name,
        references=frames(renderer.render, [(traverse, place) for traverse in references for place in range(places)]),
        places=places_of(places, len(references)),
        queries=frames(renderer.render, [(query, place) for place in range(first, first + count)]),
        positives=right_places(first, count, places, tolerance),
        protocol={
            "places": places,
            "references": list(references),
            "query": query,
            "first_query_place": first,
            "query_places": count,
            "tolerance_places": tolerance,
            "seed": seed,
            "width": WIDTH,
            "height": HEIGHT,
            "renderer": VERSION,
        },
    )

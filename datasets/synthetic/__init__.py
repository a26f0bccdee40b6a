"""Dataset `synthetic`: a seeded railway journey in four seasons, rendered when looked at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vprbench.images import Images
from vprbench.interface import BadInput, Dataset, Image

from .camera import HEIGHT, WIDTH
from .renderer import VERSION, Renderer
from .seasons import SEASONS

MOST_PLACES = 27_000
FEWEST_PLACES = 10


def synthetic(
    name: str = "synthetic",
    places: int = 3300,
    references: Sequence[str] = ("spring", "fall"),
    query: str = "summer",
    first_query_place: int | None = None,
    query_places: int | None = None,
    tolerance: int = 0,
    seed: int = 0,
) -> Dataset:
    """Return traverses of one journey in several seasons, as RGB frames of 160 x 90.

    Place k of a seed looks the same however many places are asked for: more places are a longer journey.
    Without `first_query_place` the first 2/11 of the places are not queried (600 of 3300, as in the VPRTempo
    paper); without `query_places` the queries run to the last place. A query's right places are those within
    `tolerance` places of its own.

    Raises BadInput for a season that does not exist and for queries outside the journey.

    >>> synthetic(places=100, query="winter").queries.names[0]
    'winter/place-00018'
    """
    if not FEWEST_PLACES <= places <= MOST_PLACES:
        raise BadInput(
            f"dataset.places={places} came; the synthetic journey has {FEWEST_PLACES} to {MOST_PLACES} places"
        )
    first = round(places * 2 / 11) if first_query_place is None else first_query_place
    if not 0 <= first < places:
        raise BadInput(f"dataset.first_query_place={first} came, but the places run from 0 to {places - 1}: choose one")
    count = places - first if query_places is None else query_places
    if not 1 <= count <= places - first:
        raise BadInput(
            f"dataset.query_places={count} came, but from place {first} to the last of {places} there are "
            f"1 to {places - first} to query"
        )
    if tolerance < 0:
        raise BadInput(f"dataset.tolerance={tolerance} came; a number of places, 0 or more, was wanted")
    if seed < 0:
        raise BadInput(f"dataset.seed={seed} came; a whole number, 0 or more, was wanted")
    if isinstance(references, str) or not references:
        raise BadInput(f"dataset.references={references!r} came; wanted at least one of {_seasons()}, as a list")
    if len(set(references)) < len(references):
        raise BadInput(f"dataset.references={list(references)} came; name each season once")
    for option, season in [("references", season) for season in references] + [("query", query)]:
        if season not in SEASONS:
            raise BadInput(f"dataset.{option}={season} came; the seasons are {_seasons()}")

    renderer = Renderer(seed)
    queried = np.arange(first, first + count)
    return Dataset(
        name=name,
        references=_traverses(renderer, [(season, place) for season in references for place in range(places)]),
        places=np.tile(np.arange(places, dtype=np.int64), len(references)),
        queries=_traverses(renderer, [(query, place) for place in queried.tolist()]),
        positives=tuple(
            np.arange(max(place - tolerance, 0), min(place + tolerance, places - 1) + 1, dtype=np.int64)
            for place in queried.tolist()
        ),
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


def _traverses(renderer: Renderer, frames: list[tuple[str, int]]) -> Images:
    def read(i: int) -> Image:
        return renderer.render(*frames[i])

    return Images(read, [f"{season}/place-{place:05d}" for season, place in frames])


def _seasons() -> str:
    return ", ".join(SEASONS)

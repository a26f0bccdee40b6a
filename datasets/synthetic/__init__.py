"""Dataset `synthetic`: a seeded railway journey in four seasons, rendered when looked at."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from vprbench.api import BadInput, Dataset, Images, cached_frames

from ..readers.traverses import Evaluation, check_traverses, make_dataset, split_places
from .film import HEIGHT, WIDTH
from .renderer import VERSION, Renderer
from .seasons import SEASONS

_JOURNEY = "the synthetic journey"
_FEWEST, _MOST = 10, 27_000  # places
_BEYOND = 100  # places between the last one of the map and the first that has no right answer


def synthetic(
    name: str = "synthetic",
    places: int = 3300,
    references: Sequence[str] = ("spring", "fall"),
    query: str = "summer",
    first_query_place: int | None = None,
    query_places: int | None = None,
    tolerance: int = 0,
    seed: int = 0,
    protocol: Evaluation = "vprtempo",
    query_shift: int = 0,
    unanswerable: int = 0,
) -> Dataset:
    """Return traverses of one journey in several seasons, as RGB frames of 160 x 90.

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
    if not _FEWEST <= places <= _MOST:
        raise BadInput(f"dataset.places={places}: {_JOURNEY} has {_FEWEST} to {_MOST} places")
    check_traverses(_JOURNEY, "season", tuple(SEASONS), references, query)
    for option, number in (("seed", seed), ("unanswerable", unanswerable)):
        if number < 0:
            raise BadInput(f"dataset.{option}={number}: give 0 or more")
    first = round(places * 2 / 11) if first_query_place is None else first_query_place
    count = places - first if query_places is None else query_places
    parts = split_places(protocol, places, first, count, tolerance)
    if first + query_shift < 0:
        raise BadInput(f"dataset.query_shift={query_shift}: the first query, of place {first}, has no such frame")
    appearance = {"seed": seed, "width": WIDTH, "height": HEIGHT, "renderer": VERSION}
    frames = partial(_frames, Renderer(seed), {"journey": _JOURNEY, **appearance})
    damage = {"query_shift": query_shift, "unanswerable": unanswerable}
    dataset = make_dataset(
        name,
        parts,
        references,
        query,
        frames,
        {
            "protocol": protocol,
            "references": list(references),
            "query": query,
            **parts.describe(),
            **appearance,
            **{option: amount for option, amount in damage.items() if amount},
        },
    )
    if not any(damage.values()):
        return dataset
    beyond = np.arange(unanswerable) + places + _BEYOND + abs(query_shift)
    shown = [(query, place) for place in (*(parts.queried + query_shift).tolist(), *beyond.tolist())]
    none = [np.array([], dtype=np.int64)] * unanswerable
    return replace(dataset, queries=frames(shown), positives=(*dataset.positives, *none))


def _frames(renderer: Renderer, appearance: Mapping[str, Any], shown: Sequence[tuple[str, int]]) -> Images:
    """Return the frames of (season, place), each rendered when it is looked at; `appearance` identifies them."""
    names = [f"{season}/place-{place:05d}" for season, place in shown]
    return cached_frames(Images(lambda i: renderer.render(*shown[i]), names), appearance)

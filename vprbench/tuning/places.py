"""Which places may be searched: none that a reported result queries, and some of them held back for a check."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import yaml

from vprbench.api.dataset import Dataset
from vprbench.errors import BadInput
from vprbench.report.plan import Column
from vprbench.tuning.settings import FEWEST_PLACES
from vprbench.tuning.space import SCATTERING

_ELSEWHERE = "search on dataset=synthetic, which has journeys that no result uses"


@dataclass(frozen=True)
class Searchable:
    """A dataset and two stretches of its places that no reported result queries."""

    dataset: Mapping[str, Any]  # the configuration, under which all places of both stretches are queried
    searched: range
    checked: range


def choose_places(name: str, config: Mapping[str, Any], places: int, columns: Iterable[Column]) -> Searchable:
    """Return where to search with `places` places, and where to check what was found.

    A rendered dataset is another journey than the reported ones, `places` to search and as many to check. Of a
    recorded one there are the places that neither its own protocol nor a column of the table queries, those on request
    aside: the longest stretch is searched, the longest left then is checked. Raises BadInput if there are too few,
    and for a protocol that sets places aside here and there.
    """
    if config.get("protocol") in SCATTERING:
        raise BadInput(
            f"dataset.protocol={config['protocol']}: a search needs places in a row, and that protocol draws those "
            "that it sets aside: leave it out"
        )
    shown = [column for column in columns if f"dataset={name}" in column.options and not column.on_request]
    reported = [config, *({**config, **_read_column_arguments(column)} for column in shown)]
    if "seed" in config:
        journey = 1 + max(each["seed"] for each in reported)
        other = {"seed": journey, "places": 2 * places, "first_query_place": 0, "query_places": 2 * places}
        return Searchable({**config, **other}, range(places), range(places, 2 * places))
    if not {"places", "first_query_place", "query_places"} <= config.keys():
        raise BadInput(f"dataset={name}: nothing says which of its places no reported result queries; {_ELSEWHERE}")
    free = np.ones(config["places"], np.bool_)
    for each in reported:
        first = 0 if each.get("protocol") in SCATTERING else each["first_query_place"]
        count = len(free) if each.get("protocol") in SCATTERING else each["query_places"] * each.get("query_stride", 1)
        free[first : first + count] = False
    searched = _find_longest(free)[:places]
    free[searched.start : searched.stop] = False
    checked = _find_longest(free)[:places]
    if len(searched) < places or len(checked) < FEWEST_PLACES:
        raise BadInput(
            f"places={places}: of dataset={name} {len(searched)} places in a row are queried by no reported result, "
            f"and {FEWEST_PLACES} or more have to be left to check what is found: give fewer, or {_ELSEWHERE}"
        )
    whole = {"first_query_place": 0, "query_places": config["places"]}
    return Searchable({**config, **whole}, searched, checked)


def cut_dataset(dataset: Dataset, stretch: range) -> Dataset:
    """Return the references of some places, and the queries all of whose right places are among them; none held out."""
    shown = np.flatnonzero(np.isin(dataset.places, stretch))
    asked = [n for n, right in enumerate(dataset.positives) if len(right) and np.isin(right, stretch).all()]
    return replace(
        dataset,
        references=dataset.references[shown],
        places=dataset.places[shown] - stretch.start,
        queries=dataset.queries[np.array(asked, np.int64)],
        positives=tuple(dataset.positives[n] - stretch.start for n in asked),
        protocol={**dataset.protocol, "stretch": [stretch.start, stretch.stop - 1]},
        held_out=None,
        place_numbers=None,
        query_breaks=None,
        place_breaks=None,
    )


def _read_column_arguments(column: Column) -> dict[str, Any]:
    """Return the arguments of its dataset that a column changes."""
    pairs = (option.partition("=") for option in column.options)
    return {name.removeprefix("dataset."): yaml.safe_load(value) for name, _, value in pairs if "." in name}


def _find_longest(free: np.typing.NDArray[np.bool_]) -> range:
    """Return the longest run of places that are free, of equals the first."""
    edges = np.flatnonzero(np.diff(free, prepend=False, append=False)).tolist()
    runs = [range(first, last) for first, last in zip(edges[::2], edges[1::2], strict=True)]
    return max(runs, key=len, default=range(0))

"""Which places may be searched: none that a reported result queries, and some of them held back for a check."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from vprbench.api.dataset import Dataset
from vprbench.errors import BadInput
from vprbench.report.plan import PlannedColumn
from vprbench.runs.record import Run
from vprbench.tuning.settings import FEWEST_PLACES
from vprbench.tuning.space import SCATTERING

_ELSEWHERE = "search on dataset=synthetic, which has journeys that no result uses"


@dataclass(frozen=True)
class Searchable:
    """A dataset and two stretches of its places that no reported result queries."""

    dataset: Mapping[str, Any]  # the configuration, under which all places of both stretches are queried
    searched: range
    checked: range


def searchable(name: str, config: Mapping[str, Any], places: int, columns: Iterable[PlannedColumn]) -> Searchable:
    """Return where to search with `places` places, and where to check what was found.

    A rendered dataset is another journey than the reported ones, `places` to search and as many to check. Of a
    recorded one there are the places that neither its own protocol nor a column of the table queries, those on request
    aside: the longest stretch is searched, the longest left then is checked. Raises BadInput if there are too few,
    and for a protocol that sets places aside here and there.
    """
    if _scatters(config):
        raise BadInput(
            f"dataset.protocol={config['protocol']}: a search needs places in a row, and that protocol draws those "
            "that it sets aside: leave it out"
        )
    shown = [column for column in columns if f"dataset={name}" in column.options and not column.on_request]
    reported = [config, *({**config, **_arguments(column)} for column in shown)]
    if "seed" in config:
        journey = 1 + max(each["seed"] for each in reported)
        other = {"seed": journey, "places": 2 * places, "first_query_place": 0, "query_places": 2 * places}
        return Searchable({**config, **other}, range(places), range(places, 2 * places))
    if not {"places", "first_query_place", "query_places"} <= config.keys():
        raise BadInput(f"dataset={name}: nothing says which of its places no reported result queries; {_ELSEWHERE}")
    free = np.ones(config["places"], np.bool_)
    for each in reported:
        first, count = (0, len(free)) if _scatters(each) else (each["first_query_place"], each["query_places"])
        count *= each.get("query_stride", 1)
        free[first:][:count] = False
    longest = _longest(free)
    if not longest:
        raise BadInput(f"dataset={name}: reported results query all of its {config['places']} places; {_ELSEWHERE}")
    searched = longest[:places]
    free[searched.start : searched.stop] = False
    checked = _longest(free)[:places]
    if len(searched) < places or len(checked) < FEWEST_PLACES:
        raise BadInput(
            f"places={places}: of dataset={name} {len(longest)} places in a row are queried by no reported result, and "
            f"{FEWEST_PLACES} or more have to be left to check what is found: give fewer, or {_ELSEWHERE}"
        )
    whole = {"first_query_place": 0, "query_places": config["places"]}
    return Searchable({**config, **whole}, searched, checked)


def querying(runs: Iterable[Run], allowed: Searchable) -> list[str]:
    """Return which stored runs query places that are searched or checked, as `<dataset>/<method>-<key>`.

    A run does if dataset and seed are the same and a right place of a query lies in either stretch. One whose
    protocol draws places here and there, and numbers the others anew, may query any.
    """
    first = allowed.dataset.get("first_place", 0)  # a run's places are numbered along the journey
    mine = {first + place for place in (*allowed.searched, *allowed.checked)}
    return [
        f"{run.dataset}/{run.method}-{run.key}"
        for run in runs
        if _journey(run.config["dataset"]) == _journey(allowed.dataset)
        and (
            _scatters(run.config["dataset"])
            or not mine.isdisjoint(place for right in run.positives for place in _numbered(run, right))
        )
    ]


def cut(dataset: Dataset, stretch: range) -> Dataset:
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


def _numbered(run: Run, places: npt.NDArray[np.int64]) -> list[int]:
    """Return the numbers along the journey of some places of a run's map."""
    return [int(number) for number in (places if run.place_numbers is None else run.place_numbers[places])]


def _scatters(dataset: Mapping[str, Any]) -> bool:
    """Tell whether a dataset's protocol draws the places that it does not query from all over its journey."""
    return dataset.get("protocol") in SCATTERING


def _journey(dataset: Mapping[str, Any]) -> tuple[Any, Any]:
    return dataset.get("name"), dataset.get("seed")


def _arguments(column: PlannedColumn) -> dict[str, Any]:
    """Return the arguments of its dataset that a column changes."""
    pairs = (option.partition("=") for option in column.options)
    return {name.removeprefix("dataset."): yaml.safe_load(value) for name, _, value in pairs if "." in name}


def _longest(free: np.typing.NDArray[np.bool_]) -> range:
    """Return the longest run of places that are free, of equals the first."""
    edges = np.flatnonzero(np.diff(free, prepend=False, append=False)).tolist()
    runs = [range(first, last) for first, last in zip(edges[::2], edges[1::2], strict=True)]
    return max(runs, key=len, default=range(0))

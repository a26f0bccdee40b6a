"""A map that grows while queries come: what one place more costs, and what becomes of the first ones."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.adaptation import adapt_traverse
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.metrics.accuracy import hits_at
from vprbench.metrics.intervals import share_interval
from vprbench.metrics.ranking import PlacesPerQuery, concatenate, outcome
from vprbench.metrics.registry import METRICS
from vprbench.runs.record import Run
from vprbench.runs.scorers import block_size
from vprbench.runs.stopwatch import Stopwatch, synchroniser
from vprbench.terminal.console import table_text

if TYPE_CHECKING:
    from vprbench.runs.experiment import Experiment

_STOPS = 10  # where nobody says how many places lie between two


def step(asked: bool | int, method: Method, n_places: int) -> int:
    """Return how many places the first map has and each stop adds; 0 if no growing map is asked for.

    Raises BadInput for more than the map has, and for a method that learns its places together.
    """
    if asked and not method.extends:
        raise BadInput(f"stream={asked}: {type(method).__name__} learns its places together: leave stream out")
    if asked is not True and not 0 <= asked < n_places:
        raise BadInput(f"stream={asked}: give 1 to {n_places - 1} places, for the map has {n_places}, or true")
    return places_of_a_step(asked, n_places)


def places_of_a_step(asked: bool | int, n_places: int) -> int:
    """Return how many places the option `stream` adds at a time to a map that ends with `n_places`; 0 for none."""
    return -(-n_places // _STOPS) if asked is True else int(asked)


def grown(experiment: Experiment) -> list[dict[str, Any]]:
    """Fit the first places, add the others one by one, and ask at every stop; the method stays as it is.

    Of each stop, as plain values: the `places` of the map, for each query with a right place among them the chance
    `hits` that the best is right, and the `seconds` of each place since the stop before, its images read beforehand.
    """
    method, dataset, first = copy(experiment.method), experiment.dataset, experiment.stream
    references, size = dataset.references.unnamed(), block_size(method, dataset.n_places)
    old = np.flatnonzero(dataset.places < first)
    method.fit(references[old], dataset.places[old])
    codes = np.concatenate([method.encode(block) for block in dataset.queries.unnamed().blocks(size)])
    codes = adapt_traverse(method, codes)
    stopwatch = Stopwatch(experiment.request.timing, synchronise=synchroniser(experiment.request.device))
    stops: list[dict[str, Any]] = []
    seconds: list[float] = []
    for n in range(first, dataset.n_places + 1):
        if n > first:
            images = Images.from_arrays([*references[np.flatnonzero(dataset.places == n - 1)]])
            with progress.listening(lambda *_: None), stopwatch.lap() as lap:  # a place is no stage of its own
                method.extend(images, np.full(len(images), n - 1))
            seconds.append(lap[0])
        progress.report("growing map", n / dataset.n_places)
        if n % first == 0 or n == dataset.n_places:
            blocks = np.split(asked := _answerable_queries(dataset.positives, n), range(size, len(asked), size))
            right = [[dataset.positives[query][dataset.positives[query] < n] for query in block] for block in blocks]
            found = concatenate([outcome(method.match(codes[b]), r) for b, r in zip(blocks, right, strict=True)])
            stops.append({"places": n, "hits": hits_at(found, 1).tolist(), "seconds": seconds})
            seconds = []
    return stops


def _answerable_queries(positives: PlacesPerQuery, n: int) -> npt.NDArray[np.int64]:
    """Return the queries that have a right place among the first `n`."""
    return np.flatnonzero([bool((right < n).any()) for right in positives])


def stream_numbers(run: Run) -> list[dict[str, Any]]:
    """Return of each stop of a growing map R@1, 0 to 1, with its 95 % interval, and the seconds of a place.

    R@1 of the queries whose place the map knows, and of those of its first places.
    """
    lines, stops = [], run.stream or ()
    for stop in stops:
        hits, seconds = np.array(stop["hits"]), stop["seconds"]
        first = hits[
            np.isin(
                _answerable_queries(run.positives, stop["places"]),
                _answerable_queries(run.positives, stops[0]["places"]),
            )
        ]
        interval = share_interval(hits) if len(hits) else None
        line = {
            "places": stop["places"],
            "queries": len(hits),
            "recall_at_1": float(hits.mean()) if interval else None,
            "recall_at_1_low": interval.low if interval else None,
            "recall_at_1_high": interval.high if interval else None,
            "recall_at_1_of_first": float(first.mean()) if len(first) else None,
            "seconds_a_place": float(np.median(seconds)) if seconds else None,
            "most_seconds_a_place": max(seconds, default=None),
        }
        lines.append(line)
    return lines


def stream_text(run: Run) -> str:
    """Return a growing map as a small table, whose last line is the map that was learnt at once."""
    lines, percent = stream_numbers(run), METRICS["recall_at_1"].text
    rows = [[f"{run.outcome.n_places:,} at once", percent(METRICS["recall_at_1"].of(run)), *[""] * 4]]
    for line in reversed(lines):
        shares = [percent(line[f"recall_at_1{of}"]) for of in ("", "_low", "_high", "_of_first")]
        times = [line["seconds_a_place"], line["most_seconds_a_place"]]
        told = ["-" if seconds is None else f"{1000 * seconds:.2f}" for seconds in times]
        rows.insert(0, [f"{line['places']:,}", shares[0], f"[{shares[1]}, {shares[2]}]", shares[3], *told])
    first = f"of the first {lines[0]['places']:,}"
    return table_text(["places", "R@1 %", "[95 %]", first, "ms a place", "most ms"], rows)

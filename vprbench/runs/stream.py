"""A map that grows while queries come: the seconds of each place, and R@1 of all and of the first places."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING, Any

import numpy as np

from vprbench import progress
from vprbench.api.adaptation import adapt_traverse
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.metrics.accuracy import count_hits
from vprbench.metrics.catalogue import METRICS
from vprbench.metrics.intervals import Values, share_interval
from vprbench.metrics.ranking import concatenate, judge_scores
from vprbench.runs.record import Run
from vprbench.runs.scorers import choose_block_size
from vprbench.runs.stopwatch import Stopwatch, make_synchroniser
from vprbench.terminal.console import format_table
from vprbench.text import NOTHING, format_three_digits

if TYPE_CHECKING:
    from vprbench.runs.experiment import Experiment

_STOPS = 10  # where nobody says how many places lie between two


def parse_step(step: bool | int, method: Method, n_places: int) -> int:
    """Return how many places the first map has and each stop adds; 0 without a growing map.

    Raises BadInput for more than the map has, and for a method that learns its places together.
    """
    if step and not method.extends:
        raise BadInput(f"stream={step}: {type(method).__name__} learns its places together: leave stream out")
    if step is not True and not 0 <= step < n_places:
        raise BadInput(f"stream={step}: give 1 to {n_places - 1} places, for the map has {n_places}, or true")
    return count_step_places(step, n_places)


def count_step_places(step: bool | int, n_places: int) -> int:
    """Return how many places the option `stream` adds at a time to a map that ends with `n_places`; 0 for none."""
    return -(-n_places // _STOPS) if step is True else int(step)


def grow_map(experiment: Experiment) -> list[dict[str, Any]]:
    """Fit the first places, add the others one by one, and ask at every stop; the method stays as it is.

    Of each stop, as plain values: the `places` of the map, how many `queries` have a right place among them, their R@1,
    0 to 1, with its 95 % interval, `recall_at_1_of_first` over the queries of the first places, and the median and the
    most seconds of a place since the stop before, its images read beforehand.
    """
    method, dataset, first = copy(experiment.method), experiment.dataset, experiment.stream
    references, size = dataset.references.unnamed(), choose_block_size(method, dataset.n_places)
    old = np.flatnonzero(dataset.places < first)
    method.fit(references[old], dataset.places[old])
    codes = np.concatenate([method.encode(block) for block in dataset.queries.unnamed().blocks(size)])
    codes = adapt_traverse(method, codes)
    stopwatch = Stopwatch(experiment.request.timing, synchronise=make_synchroniser(experiment.request.device))
    earliest = np.array([right.min(initial=dataset.n_places) for right in dataset.positives])  # right place of a query
    stops: list[dict[str, Any]] = []
    seconds: list[float] = []
    for n in range(first, dataset.n_places + 1):
        if n > first:
            images = Images.from_arrays([*references[np.flatnonzero(dataset.places == n - 1)]])
            with progress.send_reports_to(lambda *_: None), stopwatch.lap() as lap:  # a place is no stage of its own
                method.extend(images, np.full(len(images), n - 1))
            seconds.append(lap[0])
        progress.report("growing map", n / dataset.n_places)
        if n % first == 0 or n == dataset.n_places:
            answerable = np.flatnonzero(earliest < n)
            blocks = np.split(answerable, range(size, len(answerable), size))
            right = [[dataset.positives[query][dataset.positives[query] < n] for query in block] for block in blocks]
            found = concatenate([judge_scores(method.match(codes[b]), r) for b, r in zip(blocks, right, strict=True)])
            hits = count_hits(found, 1)
            stops.append(_describe_stop(n, hits, hits[earliest[answerable] < first], seconds))
            seconds = []
    return stops


def _describe_stop(n_places: int, hits: Values, of_first: Values, seconds: list[float]) -> dict[str, Any]:
    interval = share_interval(hits) if len(hits) else None
    return {
        "places": n_places,
        "queries": len(hits),
        "recall_at_1": float(hits.mean()) if interval else None,
        "recall_at_1_low": interval.low if interval else None,
        "recall_at_1_high": interval.high if interval else None,
        "recall_at_1_of_first": float(of_first.mean()) if len(of_first) else None,
        "seconds_a_place": float(np.median(seconds)) if seconds else None,
        "most_seconds_a_place": max(seconds, default=None),
    }


def format_stops(run: Run) -> str:
    """Return a growing map as a small table, with a last line for the map that was learnt at once."""
    stops, percent, rows = run.stream or [], METRICS["recall_at_1"].text, []
    for stop in stops:
        recall, low, high, of_first = (percent(stop[f"recall_at_1{end}"]) for end in ("", "_low", "_high", "_of_first"))
        times = (stop["seconds_a_place"], stop["most_seconds_a_place"])
        milliseconds = [NOTHING if seconds is None else format_three_digits(1000 * seconds) for seconds in times]
        rows.append([f"{stop['places']:,}", recall, f"[{low}, {high}]", of_first, *milliseconds])
    rows.append([f"{run.outcome.n_places:,} at once", percent(METRICS["recall_at_1"].of(run)), *[""] * 4])
    first = f"of the first {stops[0]['places']:,}"
    return format_table(["places", "R@1 %", "[95 %]", first, "ms a place", "most ms"], rows)

"""Methods whose settings were chosen on places of a run's dataset: which queries show them, and runs of the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from vprbench.plugins.entries import find_entries
from vprbench.plugins.tuned_places import parse_places
from vprbench.runs.notes import Note, make_notes
from vprbench.runs.record import Run
from vprbench.runs.views import get_window_length, list_shown_queries, select_queries

#: Arguments of a dataset that choose among its places, which keep their numbers.
_CHOOSING = {
    *("_target_", "name", "suffix", "on_disk", "references", "query", "protocol", "shared_frames"),
    *("places", "query_places", "query_stride", "tolerance", "first_place", "first_query_place"),
}

ONE_SEED = "one seed of a method that draws at random: seeds=3 of vprbench compare says how far seeds differ"


def find_tuned_queries(run: Run) -> npt.NDArray[np.bool_] | None:
    """Return which queries have a right place that the method was tuned on, (n_queries,); None: that is not known.

    In a view of sequences the queries near such a query are among them: their answers may rest on its scores.
    """
    shown = list_shown_queries(run)
    tuned = np.zeros(int(shown.max(initial=0)) + 1)  # of the stored queries
    if run.tuned_queries:  # known by the content of their frames
        tuned[[query for query in run.tuned_queries if query < len(tuned)]] = 1
    elif places := _format_tuned_places(run):
        on_places = _find_queries_of_places(run, places)
        if on_places is None:
            return None
        tuned[shown[on_places]] = 1
    reach = get_window_length(run) - 1  # to either side
    return np.convolve(tuned, np.ones(2 * reach + 1))[reach:][: len(tuned)][shown] > 0


def _find_queries_of_places(run: Run, places: str) -> npt.NDArray[np.bool_] | None:
    """Return which queries have a right place of the declared numbers, (n_queries,); None: the numbers do not tell."""
    known, entry = parse_places(places), find_entries("dataset").get(run.dataset)
    if known is None or entry is None or entry.rivals:
        return None
    given, usual = run.config["dataset"], entry.values()
    ignored = {*_CHOOSING, *given.get("on_disk", ())}
    if any((name, value) not in usual.items() for name, value in given.items() if name not in ignored):
        return None
    numbers = np.arange(run.outcome.n_places) if run.place_numbers is None else run.place_numbers
    tuned = np.any([(numbers >= first) & (numbers <= last) for first, last in known], axis=0)
    return np.array([tuned[right].any() for right in run.positives], np.bool_)


def _format_tuned_places(run: Run) -> str:
    """Return the places of a run's dataset that its method was tuned on, as declared; empty if there are none."""
    declared = run.tuned_on
    return str({**declared.get("also_in", {}), declared.get("dataset"): declared.get("places")}.get(run.dataset, ""))


def overlaps_tuning_places(run: Run) -> bool:
    """Tell whether a run's queries show, or may show, places on which the method's settings were chosen."""
    tuned = find_tuned_queries(run)
    return tuned is None or bool(tuned.any())


def without_tuning_places(run: Run) -> Run | None:
    """Return a run of a tuned method as if the other queries alone had been asked of the same map, and not timed.

    None if its method was not tuned on places of its queries, if no query is left, or if it is not known which.
    """
    tuned = find_tuned_queries(run)
    if tuned is None or tuned.all() or not tuned.any():
        return None
    return select_queries(replace(run, scores=None, timing=None), np.flatnonzero(~tuned), {"tuned_places": "left out"})


def all_without_tuning_places(runs: Sequence[Run]) -> tuple[Run, ...]:
    """Return `without_tuning_places` of the runs of one row; empty if any of them has none."""
    found = [other for run in runs if (other := without_tuning_places(run)) is not None]
    return tuple(found) if len(found) == len(runs) else ()


def describe_tuning(runs: Sequence[Run]) -> str:
    """Return a remark on the places that a row's method was tuned on; empty if its queries show none of them.

    `runs` are the runs of the row, which differ in their seed alone.
    """
    if not any(map(overlaps_tuning_places, runs)):
        return ""
    declared, tuned = runs[0].tuned_on, find_tuned_queries(runs[0])
    places = "places " * bool(parse_places(declared["places"]))
    others = "unknown" if tuned is None else f"{np.count_nonzero(~tuned)} of {len(tuned)}"
    return f"tuned on {places}{declared['places']} of {declared['dataset']}, in no contest; queries elsewhere: {others}"


def list_notes(run: Run) -> tuple[Note, ...]:
    """Return the notes of a run, before them the tuning of its method, and that it is of one seed."""
    tuning, one_seed = filter(None, [describe_tuning([run])]), [ONE_SEED] * draws_at_random(run)
    return (*make_notes("tuned", tuning), *make_notes("seed", one_seed), *run.notes)


def draws_at_random(run: Run) -> bool:
    """Tell whether a run's method drew at random: it takes a seed, and learnt in this run."""
    return "seed" in run.config["method"] and run.network is None

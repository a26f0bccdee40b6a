"""Methods whose settings were chosen on places of a run's dataset: which queries show them, and R@1 of the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from statistics import mean

import numpy as np
import numpy.typing as npt

from vprbench.metrics.accuracy import recall_at
from vprbench.metrics.catalogue import METRICS
from vprbench.plugins.entries import entries
from vprbench.plugins.tuned_places import parse_places
from vprbench.runs.notes import Note, make_notes
from vprbench.runs.recall_intervals import recall_interval
from vprbench.runs.record import Run
from vprbench.runs.views import queries_shown, select_queries, window_of

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
    n_stored = int(queries_shown(run).max(initial=0)) + 1
    if run.tuned_queries or not _format_declared_places(run):  # known by the content of their frames
        tuned = np.isin(np.arange(n_stored), np.array(run.tuned_queries or (), np.int64))
    elif (shown := _show_declared_places(run)) is not None:
        tuned = np.bincount(queries_shown(run)[shown], minlength=n_stored) > 0
    else:
        return None
    reach = window_of(run) - 1  # to either side: an answer may rest on their scores
    return np.convolve(tuned, np.ones(2 * reach + 1))[reach:][:n_stored][queries_shown(run)] > 0


def _show_declared_places(run: Run) -> npt.NDArray[np.bool_] | None:
    """Return which queries have a right place of the declared numbers, (n_queries,); None: the numbers do not tell."""
    known, entry = parse_places(_format_declared_places(run)), entries("dataset").get(run.dataset)
    if known is None or entry is None or entry.rivals:
        return None
    listed = entry.values()
    given = run.config["dataset"]
    ignored = {*_CHOOSING, *given.get("on_disk", ())}
    if not all(name in ignored or (name, value) in listed.items() for name, value in given.items()):
        return None
    numbers = np.arange(run.outcome.n_places) if run.place_numbers is None else run.place_numbers
    tuned = np.any([(numbers >= first) & (numbers <= last) for first, last in known], axis=0)
    return np.array([tuned[right].any() for right in run.positives], np.bool_)


def _format_declared_places(run: Run) -> str:
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
    declared = runs[0].tuned_on
    places = "places " * bool(parse_places(declared["places"]))
    words = f"tuned on {places}{declared['places']} of {declared['dataset']}, in no contest"
    if others := all_without_tuning_places(runs):
        return f"{words}; {describe_recalls(others)} on the {len(others[0].outcome)} queries of other places"
    unknown = find_tuned_queries(runs[0]) is None
    return f"{words}; {'not known which queries show these' if unknown else 'all queries show these'}"


def describe_recalls(runs: Sequence[Run]) -> str:
    """Return R@1 in percent over the seeds, with its interval."""
    metric = METRICS["recall_at_1"]
    interval, recalls = recall_interval(runs), [recall_at(run.outcome, 1) for run in runs]
    found = [recall.expected for recall in recalls if recall is not None]
    ends = "" if interval is None else f" [{metric.text(interval.low)}, {metric.text(interval.high)}]"
    return f"{metric.text(mean(found) if found else None)}{ends}"


def list_notes(run: Run) -> tuple[Note, ...]:
    """Return the notes of a run, before them the tuning of its method, and that it is of one seed."""
    tuning, one_seed = filter(None, [describe_tuning([run])]), [ONE_SEED] * draws_at_random(run)
    return (*make_notes("tuned", tuning), *make_notes("seed", one_seed), *run.notes)


def draws_at_random(run: Run) -> bool:
    """Tell whether a run's method drew at random: it takes a seed, and learnt in this run."""
    return "seed" in run.config["method"] and run.network is None

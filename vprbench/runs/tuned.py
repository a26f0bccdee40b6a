"""What a reader has to know of a run whose method was tuned: which queries show those places, and R@1 of the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import mean

import numpy as np
import numpy.typing as npt

from vprbench.metrics.accuracy import recall_at
from vprbench.metrics.registry import METRICS
from vprbench.plugins.entries import entries
from vprbench.plugins.tuned_places import UNKNOWN, parse_places
from vprbench.runs.notes import Note, noted
from vprbench.runs.recall_intervals import recall_interval
from vprbench.runs.record import Run
from vprbench.runs.views import queries_shown, restricted, window_of

#: Arguments of a dataset that choose among its places, or say where its frames lie: the places keep their numbers.
_CHOOSING = {
    *("_target_", "name", "root", "default_root", "source", "download", "suffix", "calibration", "processed", "lists"),
    *("references", "query", "protocol", "shared_frames", "places", "query_places", "query_stride", "tolerance"),
    *("first_place", "first_query_place"),
}


def tuned_queries(run: Run) -> npt.NDArray[np.bool_] | None:
    """Return which queries have a right place that the method was tuned on, (n_queries,); None: that is not known.

    In a view of sequences those near such a query are among them: their answers may rest on its scores.
    """
    of_stored = _by_content(run) if run.tuned_queries or _here(run) == "" else _by_number(run)
    if of_stored is None:
        return None
    reach = window_of(run) - 1  # to either side: whose scores the answer may rest on
    return np.convolve(of_stored, np.ones(2 * reach + 1))[reach:][: len(of_stored)][queries_shown(run)] > 0


def _by_content(run: Run) -> npt.NDArray[np.bool_]:
    """Return which of the stored queries show frames of the tuning, (n_stored,)."""
    return np.isin(np.arange(_n_stored(run)), np.array(run.tuned_queries or (), np.int64))


def _by_number(run: Run) -> npt.NDArray[np.bool_] | None:
    """Return which of the stored queries have a right place of the declared numbers, (n_stored,); None: not known."""
    numbers = np.arange(run.outcome.n_places) if run.place_numbers is None else run.place_numbers
    known = parse_places(_here(run))
    if known is None or not _numbered_as_listed(run):
        return None
    tuned = np.zeros(len(numbers), np.bool_)
    for first, last in known:
        tuned |= (numbers >= first) & (numbers <= last)
    queries = np.repeat(queries_shown(run), [len(right) for right in run.positives])
    shown = tuned[np.concatenate([np.empty(0, np.int64), *run.positives])]
    return np.bincount(queries[shown], minlength=_n_stored(run)) > 0


def _n_stored(run: Run) -> int:
    return int(queries_shown(run).max(initial=0)) + 1


def tuned_here(run: Run) -> bool:
    """Tell whether a run's queries show, or may show, places on which the method's settings were chosen."""
    found = tuned_queries(run)
    return found is None or bool(found.any())


def other_places(run: Run) -> Run | None:
    """Return a run of a tuned method as if the other queries alone had been asked of the same map, and not timed.

    None if its method was not tuned on places of its queries, if no query is left, or if it is not known which.
    """
    found = tuned_queries(run)
    if found is None or found.all() or not found.any():
        return None
    return restricted(replace(run, scores=None, timing=None), np.flatnonzero(~found), {"tuned_places": "left out"})


def others_of(runs: Sequence[Run]) -> tuple[Run, ...]:
    """Return `other_places` of the runs of one row; empty if any of them has none."""
    found = [other_places(run) for run in runs]
    return tuple(other for other in found if other is not None) if None not in found else ()


def tuned_note(runs: Sequence[Run]) -> str:
    """Return what a reader has to know of the settings behind a row; empty if its queries show no place of the tuning.

    `runs` are those of the row, which differ in their seed alone.
    """
    if not any(map(tuned_here, runs)):
        return ""
    run, others = runs[0], others_of(runs)
    declared, here = run.tuned_on, _here(run)
    words = (
        f"tuned on {'places ' * bool(parse_places(declared['places']))}{declared['places']} of {declared['dataset']}"
    )
    words += ", whose frames are among these" if not here else ""
    words += f" ({here} here)" if run.dataset != declared["dataset"] and parse_places(here) else ""
    if others:
        elsewhere = f"{describe_recalls(others)} on the {len(others[0].outcome)} queries of other places"
        return f"{words}, in no contest; {elsewhere}"
    if tuned_queries(run) is None:
        return f"{words}, in no contest; which queries show these is not known: all are under suspicion"
    return f"{words}, which all queries show, in no contest; to be judged on others"


def describe_recalls(runs: Sequence[Run]) -> str:
    """Return R@1 in percent over the seeds, with its interval."""
    metric = METRICS["recall_at_1"]
    interval, recalls = recall_interval(runs), [recall_at(run.outcome, 1) for run in runs]
    found = [recall.expected for recall in recalls if recall is not None]
    ends = "" if interval is None else f" [{metric.text(interval.low)}, {metric.text(interval.high)}]"
    return f"{metric.text(mean(found) if found else None)}{ends}"


def all_notes(run: Run) -> tuple[Note, ...]:
    """Return the notes of a run, before them on what its method was tuned, and that it is of one seed."""
    return (*noted("tuned", filter(None, [tuned_note([run])])), *noted("seed", [ONE_SEED] * draws(run)), *run.notes)


ONE_SEED = "one seed of a method that draws at random: seeds=3 of vprbench compare says how far seeds differ"


def draws(run: Run) -> bool:
    """Tell whether a run's method drew at random: it takes a seed, and learnt what it knows in this run."""
    return "seed" in run.config["method"] and run.network is None


def _here(run: Run) -> str:
    """Return which places of a run's dataset its method was tuned on, as declared; empty if on none."""
    declared = run.tuned_on
    also = declared.get("also_in", ())  # of earlier versions it names datasets alone
    named = also if isinstance(also, Mapping) else dict.fromkeys(also, UNKNOWN)
    return str({**named, declared.get("dataset"): declared.get("places")}.get(run.dataset, ""))


def _numbered_as_listed(run: Run) -> bool:
    """Tell whether a run's dataset numbers its places as its yaml alone would."""
    entry = entries("dataset").get(run.dataset)
    listed = {} if entry is None else entry.values()
    return bool(listed) and all(
        name in _CHOOSING or (name in listed and listed[name] == value) for name, value in run.config["dataset"].items()
    )

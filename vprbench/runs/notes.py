"""Notes that a reader of a run's numbers needs: on files, caches, scorers, disturbances and the stopwatch."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from vprbench.api.dataset import Dataset
from vprbench.api.method import Method
from vprbench.runs.scorers import NearestScorer, Scorer, ViewsScorer

if TYPE_CHECKING:
    from vprbench.runs.record import Run
    from vprbench.runs.stopwatch import Timing

_NOISE = 0.05  # drift of a fixed computation that marks a run as noisy
_BUSY = 15.0  # percent of the time in which a process waits for a core, that marks a run as noisy
_SAME_SCORE = 1e-4  # relative difference that counts as the same answer in the timed and in the scored run
_ADAPTED = {
    "references": "the mean of the references is taken off the descriptors of references and queries",
    "running": "adapted to the queries so far: their mean is taken off each query, so the order of the queries counts",
    "traverse": "adapted to all queries: their mean is taken off each query, which can be done only offline",
}

NoteKind = Literal[
    "dataset",  # a sentence of the dataset
    "method",  # a sentence of the method
    "tuned",  # the places on which its settings were chosen
    "seed",  # the only seed of a method that draws at random
    "loaded",  # the network that it did not train
    "calibrated",  # the held-out places that chose its settings
    "described",  # descriptors that a run had from the cache
    "fitted",  # a fit beside other runs
    "noisy",  # a machine that did other things too
    "invalid",  # too few laps
    "offline",  # too few laps of a batch size
    "answers",  # other answers when it was timed
    "index",  # an approximate search
    "shortlist",  # a large map, of which the best places of a query alone are kept
    "adapted",  # the mean that is taken off descriptors
    "views",  # the viewpoints of queries
    "spikes",  # why no spikes were counted
]

#: Kinds of notes on a machine that was disturbed, or timed too shortly.
DISTURBED: frozenset[NoteKind] = frozenset({"noisy", "invalid"})


@dataclass(frozen=True)
class Note:
    """One line, and its kind."""

    kind: NoteKind
    text: str


def make_notes(kind: NoteKind, texts: Iterable[str]) -> Iterator[Note]:
    """Yield a note of one kind for each text."""
    return (Note(kind, text) for text in texts)


def note_cache(dataset: Dataset, references: int, queries: int) -> Iterator[Note]:
    """Yield how many descriptors were not encoded because they were kept."""
    traverses = (("references", references, len(dataset.references)), ("queries", queries, len(dataset.queries)))
    kept = [f"{n if n == of else f'{n} of {of}'} {images}" for images, n, of in traverses if n]
    if kept:
        everything = all(n == of for _, n, of in traverses)
        nothing = "nothing was encoded" if everything else "none of these was encoded"
        text = f"descriptors of {' and '.join(kept)} were kept from an earlier run: {nothing} but the timed sample"
        yield Note("described", text)


def note_scorer(scorer: Scorer, method: Method, n_places: int) -> Iterator[Note]:
    """Yield a note for shortlists of best places, for adaptation and for several viewpoints."""
    if isinstance(scorer, NearestScorer):
        best = f"of {n_places:,} places the best {scorer.depth} of each query are kept"
        yield Note("shortlist", f"large map: {best}, and a right place that is none of these is no candidate")
    if method.adapt != "none":
        yield Note("adapted", _ADAPTED[method.adapt])
    if isinstance(scorer, ViewsScorer):
        shown = ", ".join(map(str, scorer.views))
        text = f"asked from {len(scorer.views)} viewpoints, shifts in widths of the frame (/heights): {shown}"
        yield Note("views", text)


def note_measurements(run: Run) -> Iterator[Note]:
    """Yield notes on a run's machine, rates and index."""
    around = run.environment
    slowdown, waited = around["canary_slowdown"], around["cpu_waited_percent"]
    if abs(slowdown - 1) > _NOISE:
        yield Note("noisy", f"noisy: a fixed computation took {slowdown:.2f} times as long afterwards as before")
    if waited is not None and waited > _BUSY:
        yield Note("noisy", f"noisy: processes waited for a core in {waited:.0f} % of the time")
    if not around.get("fitted_alone", True):
        yield Note("fitted", "fitted beside other runs, which made it slower")
    if run.timing is not None:
        yield from _note_rates(run, run.timing)
    if run.search is not None and run.search["index"] != "exact":
        found = run.search
        again = f", the best {found['rerank']} compared again" if found["rerank"] else ""
        yield Note(
            "index",
            f"index {found['index']}{again}: {100 * found['recall_at_1']:.1f} % of the exactly best places found, "
            f"{100 * found['recall_at_10']:.1f} % of the best 10; {found['bytes_per_place']:,} bytes a place, "
            f"built in {found['build_seconds']:.1f} s",
        )


def _note_rates(run: Run, timing: Timing) -> Iterator[Note]:
    limit = "maximum" if run.timed_by.total_seconds is None else "total"
    unmet = f"a minimum of the timing protocol was not met within timing.{limit}_seconds"
    if not timing.streaming.valid:
        yield Note("invalid", f"invalid rates: {unmet}")
    elif not all(laps.valid for laps in timing.offline):
        yield Note("offline", f"invalid rates in batches: {unmet}")
    in_order = run.config["method"].get("adapt") == "running"  # the sample comes in another order
    if not in_order and not _gives_same_answers(run, timing):
        yield Note("answers", "the timed run gave other answers than the scored run")


def _gives_same_answers(run: Run, timing: Timing) -> bool:
    """Return whether the places that the timed run named score best in the stored answers too."""
    queries = timing.sample[timing.answers >= 0]
    named = timing.answers[timing.answers >= 0]
    places, scores = run.top_places[queries], run.top_scores[queries]
    largest = np.abs(scores).max(1, initial=0, where=scores > -np.inf, keepdims=True)
    close = scores >= scores[:, :1] - _SAME_SCORE * largest
    return bool(((places == named[:, None]) & close).any(axis=1).all())

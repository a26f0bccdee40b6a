"""Notes that a reader of a run's numbers needs: on large maps, disturbances and the stopwatch."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from vprbench.runs.scorers import QueryScorer
from vprbench.text import format_percent, format_seconds, format_three_digits

if TYPE_CHECKING:
    from vprbench.runs.record import Run
    from vprbench.runs.stopwatch import Timing

_NOISE = 0.05  # drift of a fixed computation that marks a run as noisy
_BUSY = 15.0  # percent of the time in which a process waits for a core, that marks a run as noisy
_SAME_SCORE = 1e-4  # relative difference that counts as the same answer in the timed and in the scored run

NoteKind = Literal[
    "dataset",  # a sentence of the dataset
    "method",  # a sentence of the method
    "tuned",  # the places on which its settings were chosen
    "seed",  # the only seed of a method that draws at random
    "loaded",  # the network that it did not train
    "calibrated",  # the held-out places that chose its settings
    "fitted",  # a fit beside other runs
    "noisy",  # a machine that did other things too
    "invalid",  # too few laps
    "offline",  # too few laps of a batch size
    "answers",  # other answers when it was timed
    "index",  # an approximate search
    "shortlist",  # a large map, of which the best places of a query alone are kept
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


def note_scorer(scorer: QueryScorer, n_places: int) -> Iterator[Note]:
    """Yield a note for a map that is too large to score every place."""
    if scorer.n_best is not None:
        best = f"of {n_places:,} places the best {scorer.n_best} of each query are kept"
        yield Note("shortlist", f"large map: {best}, and a right place that is none of these is no candidate")


def note_measurements(run: Run) -> Iterator[Note]:
    """Yield notes on a run's machine, rates and index."""
    slowdown, waited = run.environment["canary_slowdown"], run.environment["cpu_waited_percent"]
    if abs(slowdown - 1) > _NOISE:
        times = format_three_digits(slowdown)
        yield Note("noisy", f"noisy: a fixed computation took {times} times as long afterwards as before")
    if waited is not None and waited > _BUSY:
        yield Note("noisy", f"noisy: processes waited for a core in {format_percent(waited / 100, 0)} % of the time")
    if not run.environment.get("fitted_alone", True):
        yield Note("fitted", "fitted beside other runs, which made it slower")
    if run.timing is not None:
        yield from _note_rates(run, run.timing)
    if run.search is not None and run.search["index"] != "exact":
        again = f", the best {run.search['rerank']} compared again" if run.search["rerank"] else ""
        first, ten = (format_percent(run.search[f"recall_at_{n}"]) for n in (1, 10))
        text = f"{first} % of the exactly best places found, {ten} % of the best 10"
        built = format_seconds(run.search["build_seconds"])
        size = f"{run.search['bytes_per_place']:,} bytes a place, built in {built} s"
        yield Note("index", f"index {run.search['index']}{again}: {text}; {size}")


def _note_rates(run: Run, timing: Timing) -> Iterator[Note]:
    unmet = "a minimum of the timing protocol was not met within timing.maximum_seconds"
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

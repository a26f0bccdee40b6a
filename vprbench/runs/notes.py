"""Notes that a reader of a run's numbers needs, each with its kind."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

NoteKind = Literal[
    "dataset",  # a sentence of the dataset
    "method",  # a sentence of the method
    "tuned",  # the places on which its settings were chosen
    "seed",  # the only seed of a method that draws at random
    "loaded",  # the network that it did not train
    "opened",  # files that its fit read and its key does not hold
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

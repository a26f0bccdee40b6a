"""Whether queries show the places that they should: a traverse that is shifted, in part or whole, or reversed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vprbench.api.dataset import Dataset
from vprbench.text import format_count, join_names

from .finding import Finding, Level
from .frames import Looks, Small
from .traverse import Middles, Traverse, advances, split_traverses

Descriptors = npt.NDArray[np.float32]  # (n, 512), unit rows; a row of zeros if there is no picture
Shifts = npt.NDArray[np.int64]  # (n_queries,), numbers of places

_LEAST = 20  # frames of a traverse
_PATCH = 8
_NOISE = 2.0  # of 255 grey values: what differs less in a patch is no structure
_AT_ONCE = 1024  # queries
_TIE = 1e-4  # likeness by which another place has to be better than that of the ground truth
_CHANGE = 8  # votes that one more change of the shift along a traverse costs
_CANDIDATES = 20  # shifts that most queries vote for
_SURE = 20  # votes
_PARTS_NAMED = 3
_SPOILT = 0.1  # share of the queries


@dataclass(frozen=True)
class _Part:
    """Compared queries in a row, by their numbers, that show other places than they should."""

    first: int
    last: int
    shift: int  # places
    votes: int  # of its queries, those that look most like the place under this shift


@dataclass(frozen=True)
class _Comparison:
    """The queries that have a right place, against one reference traverse."""

    numbers: Shifts  # (n,), of the queries
    middles: Middles  # (n,), the place that each query should show
    best: Shifts  # (n,), the place that looks most like each query
    n_places: int

    @property
    def is_reversed(self) -> bool:
        """Whether queries look like the places counted from the last to the first."""
        backwards = int(np.bincount(self.best + self.middles).max())
        return backwards > _CHANGE and backwards > 2 * int(np.unique(self.shifts, return_counts=True)[1].max())

    @property
    def shifts(self) -> Shifts:
        """By how many places each query looks later than it should."""
        return self.best - self.middles

    def find_parts(self) -> list[_Part]:
        """Return the stretches under one shift other than 0, by the sequence of shifts that most queries vote for.

        The best path through the shifts (Viterbi 1967), on which each change costs some votes.
        """
        voted, counts = np.unique(self.shifts, return_counts=True)
        states = np.union1d(voted[np.argsort(-counts, kind="stable")[:_CANDIDATES]], 0)
        gains = (self.shifts[:, None] == states).astype(float)
        total = np.where(states == 0, 0.0, -_CHANGE)
        came_from = np.empty(gains.shape, np.int64)
        for query, gain in enumerate(gains):
            leader = int(total.argmax())
            came_from[query] = np.where(total[leader] - _CHANGE > total, leader, np.arange(len(states)))
            total = np.maximum(total, total[leader] - _CHANGE) + gain
        path, state = np.empty(len(gains), np.int64), int(total.argmax())
        for query in range(len(gains) - 1, -1, -1):
            path[query], state = states[state], int(came_from[query, state])
        ends = np.append(np.flatnonzero(np.diff(path)), len(path) - 1).tolist()
        firsts = [0, *(end + 1 for end in ends[:-1])]
        return [
            _Part(first, last, int(path[first]), int((self.shifts[first : last + 1] == path[first]).sum()))
            for first, last in zip(firsts, ends, strict=True)
            if path[first]
        ]


def check_alignment(dataset: Dataset, looks: Sequence[Looks]) -> Iterator[Finding]:
    """Compare the query traverse, the last of `looks`, with every reference traverse by small pictures of frames.

    Only if the right place advances with the query: else nothing says what a shift would be.
    """
    references, queries = split_traverses(dataset)
    seen = looks[-1]
    numbers = np.flatnonzero((queries.places >= 0) & seen.readable)
    fewest = min(len(numbers), *(int(each.readable.sum()) for each in looks[:-1]))
    if not advances(queries.places):
        yield _make_note("not checked: the right place does not advance from query to query")
        return
    if fewest < _LEAST:
        yield _make_note(
            f"not checked: a traverse has {format_count(fewest, 'frame')} to compare, and {_LEAST} are needed"
        )
        return
    descriptors, middles = describe(seen.small[numbers]), queries.places[numbers]
    for traverse, each in zip(references, looks[:-1], strict=True):
        places = np.zeros((dataset.n_places, descriptors.shape[1]), np.float32)
        np.add.at(places, traverse.places[each.readable], describe(each.small[each.readable]))
        best = find_most_alike(descriptors, middles, _normalise_rows(places))
        yield _judge(dataset, queries, traverse, _Comparison(numbers, middles, best, dataset.n_places))


def describe(small: Small) -> Descriptors:
    """Return patch-normalised frames without what all frames of the traverse share, as unit rows."""
    n, height, width = small.shape
    patches = small.reshape(n, height // _PATCH, _PATCH, width // _PATCH, _PATCH).astype(np.float32)
    patches -= patches.mean((2, 4), keepdims=True)
    patches /= patches.std((2, 4), keepdims=True) + _NOISE
    rows = patches.reshape(n, height * width)
    return _normalise_rows(rows - rows.mean(0))


def find_most_alike(queries: Descriptors, middles: Middles, places: Descriptors) -> Shifts:
    """Return the place that looks most like each query; that of the ground truth where none is better."""
    best = middles.copy()
    for start in range(0, len(queries), _AT_ONCE):
        part = slice(start, start + _AT_ONCE)
        likeness = queries[part] @ places.T
        rows = np.arange(len(likeness))
        better = likeness.max(1) > likeness[rows, middles[part]] + _TIE
        best[part][better] = likeness[better].argmax(1)
    return best


def _judge(dataset: Dataset, queries: Traverse, shown: Traverse, compared: _Comparison) -> Finding:
    """Return what the votes of the queries say about one reference traverse."""
    n = len(compared.numbers)
    names = queries.images.names
    if compared.is_reversed:
        advice = "compare some frames by eye; then reverse the order of one of them"
        return Finding("error", "alignment", f"{queries.name} runs the other way than {shown.name}", advice)
    parts = compared.find_parts()
    if not parts:
        at_truth = int((np.abs(compared.shifts) <= 1).sum())
        votes = f"{at_truth:,} of {format_count(n, 'query')} look most like their place or one beside it"
        if at_truth > max(_SURE, 12 * n / compared.n_places):
            return _make_note(f"{queries.name} and {shown.name} are aligned: {votes}")
        text = f"{queries.name} and {shown.name} look too different to tell whether they are aligned: {votes}"
        return _make_note(text, "compare some frames by eye")
    texts, spoilt = [], 0
    for part in parts:
        numbers = np.arange(part.first, part.last + 1)
        places = compared.middles[numbers] + part.shift
        there = (places >= 0) & (places < compared.n_places)
        right = [dataset.positives[query] for query in compared.numbers[numbers[there]]]
        spoilt += sum(place not in own for place, own in zip(places[there].tolist(), right, strict=True))
        ends = [names[compared.numbers[number]] for number in (part.first, part.last)]
        texts.append(
            f"about {ends[0]} to {ends[1]} ({len(numbers):,} of {format_count(n, 'query')}) show what it shows "
            f"{format_count(abs(part.shift), 'place')} {'later' if part.shift > 0 else 'earlier'}, "
            f"by {part.votes:,} of them"
        )
    level: Level = "error" if spoilt > _SPOILT * n else "warning" if spoilt else "note"
    text = f"{queries.name} is shifted against {shown.name}: {join_names(texts, _PARTS_NAMED)}"
    if not spoilt:
        return Finding(level, "alignment", text, "the ground truth counts these places as right")
    amid = (parts[0].first + parts[0].last) // 2
    place = min(max(0, int(compared.middles[amid]) + parts[0].shift), compared.n_places - 1)
    image = shown.images.names[int(np.abs(shown.places - place).argmin())]
    advice = (
        f"compare {names[compared.numbers[amid]]} of {queries.name} with {image} of {shown.name} by eye; then look for "
        "a file too many or too few, or for a traverse that begins at another frame"
    )
    return Finding(level, "alignment", text, advice)


def _make_note(text: str, advice: str = "") -> Finding:
    return Finding("note", "alignment", text, advice)


def _normalise_rows(rows: Descriptors) -> Descriptors:
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    unit: Descriptors = np.divide(rows, norms, out=np.zeros_like(rows), where=norms > 1e-6)
    return unit

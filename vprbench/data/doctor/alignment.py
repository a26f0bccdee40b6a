"""Whether queries show the places that they should: a traverse that is shifted, in part or whole, or reversed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vprbench.api.dataset import Dataset
from vprbench.text import plural

from . import offsets
from .finding import Finding, Level
from .looking import Looks
from .offsets import Descriptors, Shifts
from .traverse import Traverse, advances, middles_of, traverses_of

_LEAST = 20  # frames of a traverse
_PARTS_NAMED = 3
_SPOILT = 0.1  # share of the queries
_MOST = 0.5


@dataclass(frozen=True)
class _Part:
    """Queries in a row, by their numbers among the compared queries, that show other places than they should."""

    first: int
    last: int
    shift: int  # places

    @property
    def queries(self) -> Shifts:
        """The numbers of its queries."""
        return np.arange(self.first, self.last + 1)


@dataclass(frozen=True)
class _Comparison:
    """The queries that have a right place, against one reference traverse."""

    query_numbers: Shifts  # (n,), the numbers of the queries
    middles: Shifts  # (n,), the place each should show
    queries: Descriptors  # (n, 512)
    places: Descriptors  # (n_places, 512)
    right: Sequence[npt.NDArray[np.int64]]  # per query, all places that count as right

    def wrong(self, part: _Part) -> int:
        """Return how many queries of a part show a place of the map that does not count as right."""
        shown = zip(part.queries, self.middles[part.queries] + part.shift, strict=True)
        return sum(0 <= place < len(self.places) and place not in self.right[number] for number, place in shown)

    def under(self, shifts: Shifts | int) -> Descriptors:
        """Return how alike queries and places are under some shifts, (n,)."""
        return offsets.under(self.queries, self.middles + shifts, self.places)


@dataclass(frozen=True)
class _Verdict:
    """What a comparison says."""

    parts: tuple[_Part, ...]  # shifted parts; a single part of all queries if the whole traverse is shifted
    backwards: bool
    sure: bool  # whether the traverses look more alike there than elsewhere
    won: int  # stretches of the traverse that speak for this
    stretches: int
    before: float  # mean likeness at the ground truth; elsewhere, if nothing is shifted
    after: float  # the same under the shift; at the ground truth, if nothing is shifted


def alignment(dataset: Dataset, references: Sequence[Looks], query: Looks) -> list[Finding]:
    """Compare the query traverse with every reference traverse, by small pictures of their frames.

    Only if the right place advances with the query: else nothing says what a shift would be.
    """
    middles = middles_of(dataset)
    if not advances(middles):
        return [_note("not checked: the right place does not advance from query to query")]
    query_numbers = np.flatnonzero((middles >= 0) & query.readable)
    fewest = min(len(query_numbers), *(int(looks.readable.sum()) for looks in references))
    if fewest < _LEAST:
        told = f"a traverse has {plural(fewest, 'frame')} to compare, and {_LEAST} are needed"
        return [_note(f"not checked: {told}")]
    traverses, queries = traverses_of(dataset)
    right = [dataset.positives[query] for query in query_numbers]
    described = offsets.described(query.small[query_numbers])
    compared = []
    for traverse, looks in zip(traverses, references, strict=True):
        there = looks.readable
        shown = offsets.described(looks.small[there])
        places = offsets.of_places(shown, traverse.places[there], dataset.n_places)
        compared.append(_Comparison(query_numbers, middles[query_numbers], described, places, right))
    verdicts = [_verdict(comparison) for comparison in compared]
    moves = {(verdict.backwards, *(part.shift for part in verdict.parts)) for verdict in verdicts}
    if len(verdicts) > 1 and len(moves) == 1 and moves != {(False,)}:  # then the queries are what differs
        everyone = f"each of the {len(verdicts)} reference traverses"
        return [_finding(queries, traverses[0], compared[0], verdicts[0], everyone)]
    return [
        _finding(queries, traverse, comparison, verdict, traverse.name)
        for traverse, comparison, verdict in zip(traverses, compared, verdicts, strict=True)
    ]


def _verdict(compared: _Comparison) -> _Verdict:
    path = offsets.shifts_along(offsets.around(compared.queries, compared.middles, compared.places))
    along = compared.under(path)
    at_truth = compared.under(0)
    peak = offsets.peak(compared.queries, compared.middles, compared.places)
    won, stretches, sure = offsets.stretches_won(peak.likeness, along)
    if sure and (peak.backwards or abs(peak.shift) > offsets.REACH):
        whole = _Part(0, len(path) - 1, peak.shift)
        return _Verdict((whole,), peak.backwards, True, won, stretches, _mean(at_truth), _mean(peak.likeness))
    parts = tuple(
        part for part in _shifted(path) if offsets.stretches_won(along[part.queries], at_truth[part.queries])[2]
    )
    if parts:
        inside = np.concatenate([part.queries for part in parts])
        won, stretches, _ = offsets.stretches_won(along[inside], at_truth[inside])
        return _Verdict(parts, False, True, won, stretches, _mean(at_truth[inside]), _mean(along[inside]))
    elsewhere = compared.queries @ compared.places.mean(0)
    won, stretches, alike = offsets.stretches_won(at_truth, elsewhere)
    elsewhere_best = compared.wrong(_Part(0, len(path) - 1, peak.shift)) > _MOST * len(path)
    sure = alike and not peak.backwards and not elsewhere_best
    return _Verdict((), False, sure, won, stretches, _mean(elsewhere), _mean(at_truth))


def _shifted(path: Shifts) -> list[_Part]:
    """Return the stretches of a path that are shifted by one number of places other than 0."""
    ends = np.append(np.flatnonzero(np.diff(path)), len(path) - 1).tolist()
    firsts = [0, *(end + 1 for end in ends[:-1])]
    return [_Part(first, last, int(path[first])) for first, last in zip(firsts, ends, strict=True) if path[first]]


def _finding(queries: Traverse, shown: Traverse, compared: _Comparison, verdict: _Verdict, other: str) -> Finding:
    """Return what is said of a verdict on `shown`; `other` names all reference traverses that it holds for."""
    after, before = (f"{round(likeness, 2) + 0.0:.2f}" for likeness in (verdict.after, verdict.before))
    agree = f"{verdict.won} of {verdict.stretches} stretches agree"
    if not verdict.parts:
        text = f"likeness {after} at the ground truth, {before} elsewhere; {agree}"
        if verdict.sure:
            return _note(f"{queries.name} and {other} are aligned: {text}")
        text = f"{queries.name} and {other} look too different to tell whether they are aligned: {text}"
        return _note(text, "compare some frames by eye")
    evidence = f"likeness {after} there, {before} at the ground truth; {agree}"
    compare = f"compare {_pair(queries, shown, compared, verdict)} by eye"
    if verdict.backwards:
        text = f"{queries.name} runs the other way than {other} ({evidence})"
        return Finding("error", "alignment", text, f"{compare}; then reverse the order of one of them")
    spoilt = sum(compared.wrong(part) for part in verdict.parts)
    level: Level = "error" if spoilt > _SPOILT * len(compared.query_numbers) else "warning" if spoilt else "note"
    told = "; ".join(_part(queries, compared, part, other) for part in verdict.parts[:_PARTS_NAMED])
    more = len(verdict.parts) - _PARTS_NAMED
    told += f"; and {plural(more, 'part')} more" * (more > 0)
    text = f"{queries.name} is shifted against {other}: {told} ({evidence})"
    if not spoilt:
        return Finding(level, "alignment", text, "the ground truth counts these places as right")
    advice = f"{compare}; then look for a file too many or too few, or for a traverse that begins at another frame"
    return Finding(level, "alignment", text, advice)


def _part(queries: Traverse, compared: _Comparison, part: _Part, other: str) -> str:
    size = part.last - part.first + 1
    names = queries.images.names
    first, last = names[compared.query_numbers[part.first]], names[compared.query_numbers[part.last]]
    whole = size == len(compared.query_numbers)
    who = (
        "all of it shows"
        if whole
        else f"about {first} to {last} ({size:,} of {len(compared.query_numbers):,} queries) show"
    )
    return f"{who} what {other} shows {plural(abs(part.shift), 'place')} {'later' if part.shift > 0 else 'earlier'}"


def _pair(queries: Traverse, shown: Traverse, compared: _Comparison, verdict: _Verdict) -> str:
    """Return the names of two frames that look alike where they should not, from the middle of the first part."""
    part = verdict.parts[0]
    last_place = len(compared.places) - 1
    places = compared.middles[part.queries] + part.shift
    there = np.flatnonzero((places >= 0) & (places <= last_place))
    amid = there[len(there) // 2]
    place = last_place - places[amid] if verdict.backwards else places[amid]
    query = queries.images.names[compared.query_numbers[part.first + amid]]
    image = shown.images.names[int(np.abs(shown.places - place).argmin())]
    return f"{query} of {queries.name} with {image} of {shown.name}"


def _note(text: str, advice: str = "") -> Finding:
    return Finding("note", "alignment", text, advice)


def _mean(likeness: Descriptors) -> float:
    return float(np.nanmean(likeness)) if np.isfinite(likeness).any() else 0.0

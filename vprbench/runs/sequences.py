"""Sequences and filters as views of stored runs, and the options that ask for them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields, replace
from functools import partial
from typing import Any, TypeVar, get_type_hints

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Scores
from vprbench.errors import BadInput
from vprbench.metrics.sequences import (
    Filter,
    Sequences,
    Stretches,
    filtered_scores,
    local_contrast,
    sequence_scores,
    stretches,
)
from vprbench.plugins.checked import checked
from vprbench.plugins.entries import read
from vprbench.runs.record import Run
from vprbench.runs.views import queries_shown, rescored, restricted
from vprbench.text import near

Views = Callable[[Run], Run]  # a view; raises NoScoresError for a run that kept no scores, BadInput for what cannot be
Asked = TypeVar("Asked", Sequences, Filter)


class NoScoresError(BadInput):
    """A run keeps no scores, which a view of it needs; the message says what to do."""


def in_sequences(run: Run, options: Sequences) -> Run:
    """Return a run whose queries are answered by the sequences of queries that they are in.

    The right places are those of the query itself, which ends a causal window and is in the middle of a centred one.
    """
    if options.window == "lens":
        return _as_lens(run, options)
    queries, places, told_gaps = _parts(run, options.gaps)
    protocol = {"sequence": f"{options.length} {options.window}"}
    if options.velocities != (1.0,):
        protocol["sequence_velocities"] = "+".join(f"{velocity:g}" for velocity in options.velocities)
    protocol |= {"sequence_contrast": str(options.contrast)} if options.contrast else {}
    scores = _scores(run)
    if options.contrast:
        scores = local_contrast(scores, options.contrast, places)
    found, counts = sequence_scores(scores, options, queries, places, float(run.protocol.get("query_stride", 1)))
    short = int(np.count_nonzero(counts < options.length))
    protocol |= {"sequence_gaps": told_gaps} if told_gaps and options.length > 1 else {}
    protocol |= (
        {"sequence_incomplete": f"{short} of {len(counts)} queries {options.incomplete.replace('_', ' ')}"}
        if short
        else {}
    )
    view = rescored(run, found, protocol, options.length)
    if not short or options.incomplete == "shortened":
        return view
    if short == len(counts):
        raise BadInput(
            f"sequence={options.length}: no query of {run.dataset} has a full window (gaps: {told_gaps or 'none'}); "
            "give fewer queries, or gaps:bridge or incomplete:shortened, as in sequence={length:4,gaps:bridge}"
        )
    return restricted(view, np.flatnonzero(counts == options.length), {})


def _as_lens(run: Run, options: Sequences) -> Run:
    """Return a run under the protocol of LENS (run_model.py and create_GTtol.py of its public code).

    Right is what lies within 3 places of a right place. A query whose window is not full is a miss, a place whose
    window is not is never the best, gaps of the journey count as none, and only queries with a right place are asked.
    """
    n_queries, n_places = len(run.outcome), run.outcome.n_places
    found, counts = sequence_scores(_scores(run), options, np.zeros(n_queries, np.int64), np.zeros(n_places, np.int64))
    found[counts < options.length] = -np.inf
    right = tuple(np.unique(np.clip(own[:, None] + np.arange(-3, 4), 0, n_places - 1)) for own in run.positives)
    protocol = {"sequence": f"{options.length} lens, within 3 places"}
    view = rescored(replace(run, positives=right), found, protocol, window=options.length)
    return restricted(view, np.flatnonzero(view.outcome.answerable), {})


def filtered(run: Run, options: Filter) -> Run:
    """Return a run whose queries are answered by a Bayes filter over the places, from the first query on.

    Moves are multiples of the usual step, the places from one query to the next.
    """
    queries, _, told_gaps = _parts(run, options.gaps)
    step = int(run.protocol.get("query_stride", 1))
    options = replace(options, back=options.back * step, ahead=options.ahead * step)
    protocol = {"filter": f"topological, moves {options.back} to {options.ahead}, ratio {options.ratio:g}"}
    protocol |= {"filter_gaps": told_gaps} if told_gaps else {}
    return rescored(run, filtered_scores(_scores(run), options, queries), protocol, window=_MEMORY)


_MEMORY = 10  # queries that a belief is taken to rest on: blocks of an interval are no shorter


def views(sequence: Any, filter: Any = None) -> tuple[Views, ...]:
    """Return the views that options ask for, one for each length of sequences; none for null and null.

    A sequence is a length, a list of lengths, or a mapping of the options of `Sequences`; a filter is true or a mapping
    of those of `Filter`. A text in the words of the command line, {length:4,window:centred}, will do for a mapping.
    Raises BadInput for anything else.
    """
    given = _mapping("sequence", sequence, "length")
    lengths = given.pop("length", []) if given is not None else []
    sequences = [_made("sequence", Sequences, {**(given or {}), "length": length}) for length in _several(lengths)]
    if given is not None and (not sequences or len({one.length for one in sequences}) < len(sequences)):
        raise BadInput(f"sequence={sequence}: give a length, or several different ones, as in sequence=[2,4]")
    found: list[Views] = [partial(in_sequences, options=one) for one in sequences]
    options = _mapping("filter", {} if filter is True else None if filter is False else filter, "")
    if options is not None:
        found.append(partial(filtered, options=_made("filter", Filter, options)))
    return tuple(found)


def suffix(seen: Iterable[Views]) -> str:
    """Return what the names of files of some views end in: -sequence-2-4, -sequence-4-centred, -filter-ahead3."""
    options = [one.keywords["options"] for one in seen if isinstance(one, partial)]
    lengths = [str(one.length) for one in options if isinstance(one, Sequences)]
    chosen = dict.fromkeys(word for one in options for word in _chosen(one))
    kinds = ["", *(["sequence", *lengths] if lengths else []), *["filter"] * (len(lengths) < len(options))]
    return "-".join([*kinds, *chosen])


def _chosen(options: Sequences | Filter) -> Iterable[str]:
    """Yield a word for each option beside the length that is not its default."""
    for option in fields(options):
        value = getattr(options, option.name)
        if option.default not in (MISSING, value):
            said = "" if isinstance(value, tuple) else str(value)
            yield said if isinstance(value, str) else option.name + said


def _scores(run: Run) -> Scores:
    if run.scores is None:
        raise NoScoresError(
            f"{run.method} on {run.dataset} kept no scores to make sequences of: run it with scores=true"
        )
    return run.scores


def _parts(run: Run, gaps: str) -> tuple[Stretches, Stretches, str]:
    """Return the unbroken parts of the journey that queries and places are in, and what is told of its gaps."""
    shown, n_places = queries_shown(run), run.outcome.n_places
    place_breaks = _breaks(run.place_breaks, run.place_numbers)
    known = max(len(one) for one in (run.query_breaks, place_breaks, ()) if one is not None)
    protocol = f"{known} {'bridged' if gaps == 'bridge' else 'break it'}" if known else ""
    if gaps == "bridge":
        return np.zeros(len(shown), np.int64), np.zeros(n_places, np.int64), protocol
    stored = stretches(int(shown[-1]) + 1, None if run.query_breaks is None else run.query_breaks)[shown]
    left_out = shown - np.arange(len(shown))  # grows where a view left queries out
    return stored + left_out, stretches(n_places, place_breaks), protocol


def _breaks(
    breaks: npt.NDArray[np.int64] | None, numbers: npt.NDArray[np.int64] | None
) -> npt.NDArray[np.int64] | None:
    """Return the breaks between places, of an older run those that its numbers along the journey tell."""
    if breaks is not None or numbers is None or len(numbers) < 2:
        return breaks
    steps = np.diff(numbers)
    return np.flatnonzero(steps != steps.min()) + 1


def _mapping(option: str, value: Any, short: str) -> dict[str, Any] | None:
    """Return an option as a mapping; a plain value is that of `short`."""
    if isinstance(value, str):
        value = read(value.replace(":", ": "))
    if value is None or isinstance(value, Mapping):
        return None if value is None else dict(value)
    if not short:
        raise BadInput(f"{option}={value}: give true, or a mapping of its options, as in {option}={{back:0,ahead:2}}")
    return {short: value}


def _several(value: Any) -> list[Any]:
    return list(value) if isinstance(value, list | tuple) else [value]


def _made(option: str, kind: type[Asked], given: Mapping[str, Any]) -> Asked:
    """Return the options of a view, checked; raises BadInput."""
    hints = get_type_hints(kind)
    for name in given:
        if name not in hints:
            raise BadInput(f"option {option}.{name} is unknown: {near(name, hints)}")
    needed = [one.name for one in fields(kind) if one.default is MISSING and one.name not in given]
    if needed:
        raise BadInput(f"option {option}.{needed[0]} is missing")
    plain = {
        name: checked(f"{option}.{name}", _several(value) if name == "velocities" else value, hints[name])
        for name, value in given.items()
    }
    try:
        return kind(**plain)
    except ValueError as error:
        raise BadInput(f"{option}: {error}") from error

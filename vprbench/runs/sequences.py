"""Sequences and filters as views of stored runs, and the options that ask for them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, fields, replace
from functools import partial
from typing import Any

import numpy as np

from vprbench.api.arrays import Scores
from vprbench.errors import BadInput
from vprbench.metrics.sequences import (
    Filter,
    Sequences,
    Stretches,
    filter_scores,
    local_contrast,
    sequence_scores,
    stretches,
)
from vprbench.plugins.options import build_options
from vprbench.runs.record import Run
from vprbench.runs.views import list_shown_queries, replace_scores, select_queries

_MEMORY = 10  # queries that a belief of a filter is taken to rest on: blocks of an interval are no shorter

Views = Callable[[Run], Run]  # raises NoScoresError for a run without scores, BadInput for an impossible view


class NoScoresError(BadInput):
    """A run keeps no scores, which a view of it needs; the message names the remedy."""


def apply_sequences(run: Run, options: Sequences) -> Run:
    """Return a run whose queries are answered by the sequences of queries that they are in.

    A query keeps its own right places. It ends a causal window and is in the middle of a centred one. Raises
    NoScoresError for a run without scores, BadInput where no query has a full window.
    """
    if options.window == "lens":
        return _apply_lens(run, options)
    queries, places = _number_parts(run, options.gaps)
    scores = _require_scores(run)
    if options.contrast:
        scores = local_contrast(scores, options.contrast, places)
    found, counts = sequence_scores(scores, options, queries, places, float(run.protocol.get("query_stride", 1)))
    text = ", ".join([f"{options.length} {options.window}", *_list_changes(replace(options, window="causal"))])
    view = replace_scores(run, found, {"sequence": text}, options.length)
    if options.incomplete == "shortened":
        return view
    full = np.flatnonzero(counts >= options.length)
    if not len(full):
        raise BadInput(
            f"sequence={options.length}: no query has a full window; give fewer queries, or gaps:bridge "
            "or incomplete:shortened, as in sequence={length:4,gaps:bridge}"
        )
    return select_queries(view, full, {})


def _apply_lens(run: Run, options: Sequences) -> Run:
    """Return a run under the protocol of LENS (run_model.py and create_GTtol.py of its public code).

    Right is what lies within 3 places of a right place. A query whose window is not full is a miss, a place whose
    window is not is never the best, gaps of the journey count as none, and only queries with a right place are asked.
    """
    n_queries, n_places = len(run.outcome), run.outcome.n_places
    no_gaps = np.zeros(n_queries, np.int64), np.zeros(n_places, np.int64)
    found, counts = sequence_scores(_require_scores(run), options, *no_gaps)
    found[counts < options.length] = -np.inf
    right = tuple(np.unique(np.clip(own[:, None] + np.arange(-3, 4), 0, n_places - 1)) for own in run.positives)
    protocol = {"sequence": f"{options.length} lens, within 3 places"}
    view = replace_scores(replace(run, positives=right), found, protocol, window=options.length)
    return select_queries(view, np.flatnonzero(view.outcome.answerable), {})


def apply_filter(run: Run, options: Filter) -> Run:
    """Return a run whose queries are answered by a Bayes filter over the places, from the first query on.

    Moves are multiples of the usual step, the places from one query to the next.
    """
    queries, _ = _number_parts(run, options.gaps)
    step = int(run.protocol.get("query_stride", 1))
    options = replace(options, back=options.back * step, ahead=options.ahead * step)
    gaps = "" if options.gaps == "break" else f", gaps {options.gaps}"
    text = f"topological, moves {options.back} to {options.ahead}, ratio {options.ratio:g}{gaps}"
    return replace_scores(run, filter_scores(_require_scores(run), options, queries), {"filter": text}, _MEMORY)


def parse_views(sequence: Any, filter: Any = None) -> tuple[Views, ...]:
    """Return the views that options ask for, one for each length of sequences; none for null and null.

    A sequence is a length, a list of lengths, or a mapping of the options of `Sequences`; a filter is true or a mapping
    of those of `Filter`. Raises BadInput for anything else.
    """
    found: list[Views] = []
    if sequence is not None:
        given = sequence if isinstance(sequence, Mapping) else {"length": sequence}
        lengths = given.get("length")
        lengths = [*lengths] if isinstance(lengths, list | tuple) else [lengths]
        if not lengths or len({*map(str, lengths)}) < len(lengths):
            raise BadInput(f"sequence={sequence}: give a length, or several different ones, as in sequence=[2,4]")
        each = (build_options("sequence", Sequences, {**given, "length": length}) for length in lengths)
        found += [partial(apply_sequences, options=options) for options in each]
    if filter not in (None, False):
        given = {} if filter is True else filter
        if not isinstance(given, Mapping):
            raise BadInput(f"filter={filter}: give true, or a mapping of its options, as in filter={{back:0,ahead:2}}")
        found.append(partial(apply_filter, options=build_options("filter", Filter, given)))
    return tuple(found)


def format_view_suffix(views: Iterable[Views]) -> str:
    """Return the ending of names of files of some views: -sequence-2-4, -sequence-4-window=centred, -filter-ahead=3."""
    options = [view.keywords["options"] for view in views if isinstance(view, partial)]
    lengths = [str(one.length) for one in options if isinstance(one, Sequences)]
    kinds = ["sequence"] * bool(lengths) + lengths + ["filter"] * (len(options) > len(lengths))
    changes = dict.fromkeys(change for one in options for change in _list_changes(one))
    return "".join(f"-{word.replace(' ', '=')}" for word in [*kinds, *changes])


def _list_changes(options: Sequences | Filter) -> list[str]:
    """Return name and value of each option beside the length that is not its default."""
    values = [(option, getattr(options, option.name)) for option in fields(options)]
    return [
        f"{option.name} {'+'.join(map(str, value)) if isinstance(value, tuple) else value}"
        for option, value in values
        if option.default not in (MISSING, value)
    ]


def _require_scores(run: Run) -> Scores:
    if run.scores is None:
        raise NoScoresError(
            f"{run.method} on {run.dataset} kept no scores to make sequences of: run it with scores=true"
        )
    return run.scores


def _number_parts(run: Run, gaps: str) -> tuple[Stretches, Stretches]:
    """Return the number of the unbroken part that each query and each place is in."""
    shown, n_places = list_shown_queries(run), run.outcome.n_places
    if gaps == "bridge":
        return np.zeros(len(shown), np.int64), np.zeros(n_places, np.int64)
    stored = stretches(int(shown[-1]) + 1, run.query_breaks)[shown]
    left_out = shown - np.arange(len(shown))  # grows where a view left queries out
    return stored + left_out, stretches(n_places, run.place_breaks)

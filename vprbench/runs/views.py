"""Views of stored runs: each is a pure function of a run that returns a run, so all that shows runs shows views too."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Scores
from vprbench.metrics.ranking import Outcome, judge_scores, rank_places

if TYPE_CHECKING:
    from vprbench.runs.record import Run

Queries = npt.NDArray[np.int64]  # (n_shown,), ascending


@dataclass(frozen=True, eq=False)
class View:
    """The queries of a view of a stored run; it is never stored."""

    queries: Queries  # the stored queries that it still asks
    window: int = 1  # neighbouring queries that one answer rests on: no block of an interval is shorter


def list_shown_queries(run: Run) -> Queries:
    """Return which of the stored queries a run or a view of it asks, (n_queries,)."""
    return np.arange(len(run.outcome)) if run.view is None else run.view.queries


def get_window_length(run: Run) -> int:
    """Return on how many neighbouring queries an answer of a run, or of a view of it, rests."""
    return 1 if run.view is None else run.view.window


def replace_scores(run: Run, scores: Scores, protocol: Mapping[str, Any], window: int = 1) -> Run:
    """Return a run whose queries are answered by other `scores` (n_queries, n_places).

    `protocol` joins that of the run, which tells the view from the run. Raises BadInput as `ranking.outcome` does.
    """
    places, values = rank_places(scores, run.top_places.shape[1])
    return replace(
        run,
        protocol={**run.protocol, **protocol},
        outcome=judge_scores(scores, run.positives),
        top_places=places,
        top_scores=values,
        scores=scores,
        view=View(list_shown_queries(run), max(window, get_window_length(run))),
    )


def select_queries(run: Run, queries: Queries, protocol: Mapping[str, Any]) -> Run:
    """Return a run of some of its queries (n_shown,), numbered as it has them; `protocol` joins its own."""
    rows = np.asarray(queries, np.int64)
    columns = [field.name for field in fields(Outcome) if field.name != "n_places"]
    return replace(
        run,
        protocol={**run.protocol, **protocol},
        outcome=replace(run.outcome, **{name: getattr(run.outcome, name)[rows] for name in columns}),
        positives=tuple(run.positives[row] for row in rows.tolist()),
        top_places=run.top_places[rows],
        top_scores=run.top_scores[rows],
        scores=None if run.scores is None else run.scores[rows],
        view=View(list_shown_queries(run)[rows], get_window_length(run)),
    )

"""The result of a run, for Python programs and notebooks: numbers, tables of its queries, and figures."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from pydantic import NonNegativeInt

from vprbench.api.arrays import Scores
from vprbench.api.dataset import Dataset
from vprbench.data.doctor import step_in_dictionary_order
from vprbench.errors import BadInput
from vprbench.metrics.accuracy import PRCurve, compute_pr_curve, compute_recall, count_hits
from vprbench.metrics.catalogue import METRICS
from vprbench.metrics.intervals import WiderInterval
from vprbench.metrics.ranking import outcome_of_best
from vprbench.plugins.options import check_value
from vprbench.report.selection import MethodRuns
from vprbench.runs import frame, rows
from vprbench.runs.predictions import require_depth, tabulate_predictions
from vprbench.runs.query_results import RIGHT, UNANSWERABLE, UNJUDGED, judge_answers
from vprbench.runs.recall_intervals import estimate_recall_difference, estimate_recall_interval
from vprbench.runs.record import Run
from vprbench.runs.sequences import Views, parse_views
from vprbench.runs.stopwatch import Timing, compute_streaming_rate
from vprbench.runs.tuned import list_notes
from vprbench.runs.views import list_shown_queries
from vprbench.text import shorten

if TYPE_CHECKING:
    from vprbench.report.figures.style import Figure

NAN = float("nan")

logger = logging.getLogger(__name__)


@dataclass(frozen=True, repr=False, eq=False)
class Result:
    """One finished run: how often its best places are right, how fast it was, and where it failed."""

    run: Run  # the record: raw answers and raw times
    folder: Path | None  # that holds the run; None: it is not stored
    queries: tuple[str, ...]  # names of the query images
    from_store: bool = False  # it was run before
    dataset: Dataset | None = None  # whose images `predictions` names

    @property
    def name(self) -> str:
        """The name of the method, with the arguments given."""
        return frame.format_label(self.run)

    @property
    def metrics(self) -> dict[str, float]:
        """Every accuracy by its name, 0 to 1, and every cost; NaN where it is undefined or not measured."""
        found = {name: metric.of(self.run) for name, metric in METRICS.items()}
        return {name: NAN if value is None else value for name, value in found.items()}

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the run that its numbers need, a line each."""
        return tuple(note.text for note in list_notes(self.run))

    @property
    def hz(self) -> float:
        """Queries per second, one at a time, encode and match together; NaN if the run was not timed."""
        timing: Timing | None = self.run.timing
        return NAN if timing is None else compute_streaming_rate(timing.streaming.total_seconds)

    def recall(self, n: int = 1, tolerance: int = 0) -> float:
        """Return the share of queries with a right place among the best `n`, 0 to 1; NaN if none has a right place.

        With a `tolerance` the places at most so many from a right one, along the journey, are right too; the best
        places that the run keeps (`depth`) decide. Raises BadInput for n below 1, a tolerance below 0, and with a
        tolerance for more places than the run keeps.
        """
        run, answers = self.run, self.run.outcome
        if tolerance:
            check_value("tolerance", tolerance, NonNegativeInt)
            require_depth(n, run.top_places.shape[1], answers.n_places)
            numbers = np.arange(answers.n_places) if run.place_numbers is None else run.place_numbers
            reach = np.arange(-tolerance, tolerance + 1)
            wider = [np.flatnonzero(np.isin(numbers, np.add.outer(numbers[right], reach))) for right in run.positives]
            answers = outcome_of_best(run.top_scores, run.top_places.astype(np.int64), wider, answers.n_places)
        found = compute_recall(answers, n)
        return NAN if found is None else found.expected

    def top(self, n: int = 5) -> npt.NDArray[np.int64]:
        """Return the best `n` places of each query, (n_queries, n), best first; -1 where there is no candidate.

        Raises BadInput below 1, and for more places than the run keeps (`depth`).
        """
        require_depth(n, self.run.top_places.shape[1], self.run.outcome.n_places)
        return np.where(self.run.top_scores > -np.inf, self.run.top_places, -1)[:, :n].astype(np.int64)

    def pr(self) -> PRCurve:
        """Return precision and recall over the best place of each query, (n_points,) each, 0 to 1, and the thresholds.

        Raises BadInput if no query has a right place.
        """
        curve = compute_pr_curve(self.run.outcome, "A")
        if curve is None:
            raise BadInput(f"{self.name}: precision and recall are undefined, for no query has a right place")
        return curve

    def similarity(self) -> Scores:
        """Return the scores of all places for all queries, (n_queries, n_places) float32; -inf: no candidate.

        Raises BadInput if the run kept none.
        """
        if self.run.scores is None:
            raise BadInput(f"{self.name} on {self.run.dataset} kept no scores: run it with scores=True")
        return np.asarray(self.run.scores)

    def interval(self, other: Result | None = None, confidence: float = 0.95) -> WiderInterval | None:
        """Return the interval of R@1, or of R@1 less that of another result on the same queries (-1 to 1).

        None if no query has a right place, or if fewer than 20 queries tell two results apart. Raises BadInput for
        results on different data.
        """
        if other is None:
            return estimate_recall_interval([self.run], confidence)
        if (self.run.fingerprint, self.run.protocol) != (other.run.fingerprint, other.run.protocol):
            raise BadInput(
                f"{self.run.dataset} and {other.run.dataset}: a difference needs results on the same queries"
            )
        return estimate_recall_difference(self.run, other.run, confidence)

    def to_frame(self) -> pd.DataFrame:
        """Return a row for each query.

        `score` is that of the best place, of equals a wrong one. `rank` is that of the best right place, from 1, 0 if
        none was found; `hit` the chance that the best place is right, ties broken at random; `margin` the score of the
        best right place less that of the best wrong one, NaN where that is undefined. Without a ground truth `hit` is
        NaN, `rank` 0, and `margin` the score of the best place less that of the second.
        """
        answers = judge_answers(self.run)
        return pd.DataFrame(
            {
                "query": self.queries,
                "best_place": answers.places[:, 0],
                "score": answers.scores[:, 0],
                "right_places": [right.tolist() for right in self.run.positives],
                "rank": answers.ranks,
                "hit": count_hits(self.run.outcome, 1) if self.run.is_judged else NAN,
                "margin": answers.margins,
            }
        )

    def failures(self) -> pd.DataFrame:
        """Return the rows of `to_frame` that are not answered right, the surest errors first.

        Queries that have no right place are left out, and without a ground truth all are.
        """
        verdicts = np.array([*judge_answers(self.run).verdicts])
        wrong = self.to_frame()[~np.isin(verdicts, (RIGHT, UNANSWERABLE, UNJUDGED))]
        return wrong.sort_values("margin", kind="stable")

    def predictions(self, n: int = 10) -> pd.DataFrame:
        """Return the best `n` places of each query, a row each, best first; nothing runs again.

        `query` is the query's number and `query_image` its file, or its name if it is no file. `rank` begins at 1.
        `place` is the place's number and `reference_image` its first reference image. `score` is the method's, higher
        means more alike. `right` says whether it is a right place; None without a ground truth. Raises BadInput below
        1, and for more places than the run keeps (`depth`, 100 unless another was given).
        """
        return tabulate_predictions(self.run, n, self.dataset)

    def in_sequences(self, length: int, **options: Any) -> Result:
        """Return the answers of `length` neighbouring queries together, a result like any other.

        The options are those of `sequence`: window="centred", velocities=[0.8, 1, 1.2], contrast=10,
        incomplete="shortened", gaps="bridge". Raises BadInput for what does not fit, and for a run that kept no scores.
        """
        return self.apply_view(parse_views({"length": length, **options})[0])

    def filter(self, **options: Any) -> Result:
        """Return the answers of a Bayes filter over the places, a result like any other.

        The options are those of `filter`: back=-2, ahead=10, ratio=5, gaps="bridge". Raises what `in_sequences` does.
        """
        return self.apply_view(parse_views(None, options)[0])

    def apply_view(self, view: Views) -> Result:
        """Return the result of a view of its run; a warning is logged if the queries are in dictionary order."""
        if step := step_in_dictionary_order(self.queries):
            logger.warning(
                "neighbouring queries are in dictionary order, not in that of their numbers: ... %s ...", step
            )
        run = view(self.run)
        kept = np.searchsorted(list_shown_queries(self.run), list_shown_queries(run)).tolist()
        return replace(self, run=run, queries=tuple(self.queries[query] for query in kept))

    def plot_pr(self) -> Figure:
        """Return the figure of precision and recall; raises BadInput if no query has a right place."""
        from vprbench.report.figures.accuracy import draw_precision_recall

        return draw_precision_recall([MethodRuns(self.name, (self.run,))]).figure

    def plot_matrix(self) -> Figure:
        """Return the figure of ground truth and scores; raises BadInput if there were too many scores to keep."""
        from vprbench.report.figures.pictures import draw_similarity

        return draw_similarity(self.run, self.name).figure

    def __repr__(self) -> str:
        recall = rows.format_row(self.run).get(rows.RECALL)
        found = "no ground truth" if recall is None else f"R@1 {recall} %"
        where = ", ".join(filter(None, [self.run.dataset, rows.describe_sequence(self.run)]))
        return shorten(f"<{self.name} on {where}: {found}, {len(self.queries):,} queries>")

    def _repr_html_(self) -> str:
        row = pd.DataFrame([{"dataset": self.run.dataset, **rows.format_row(self.run)}])
        notes = pd.DataFrame({"notes": self.notes}, dtype=object)
        return "".join(table.to_html(index=False, border=0) for table in (row, notes) if len(table))

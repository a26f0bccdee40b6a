"""Every accuracy and cost by its name: an entry of `METRICS` is known to runs, tables, figures and pages."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from importlib.metadata import entry_points
from typing import Any

import numpy as np

from vprbench.errors import BadInput
from vprbench.metrics.accuracy import (
    PRCurve,
    Ties,
    Values,
    auc,
    auc_roc,
    average_precision,
    compute_pr_curve,
    count_hits,
    extended_precision,
    f1_max,
    pr_curve_multi,
    precision_at_full_recall,
    recall_at_full_precision,
)
from vprbench.metrics.ranking import Outcome
from vprbench.text import format_three_digits

RECALLS = (1, 5, 10, 25)
ENTRY_POINTS = "vprbench.metrics"  # group of a package's metrics

#: A stored run: `outcome`, `positives`, `top_places` and `top_scores` (n_queries, depth), `energy`.
Answers = Any


@dataclass(frozen=True)
class Metric:
    """A number of the answers of one run: a share or an area, 0 to 1, or a cost.

    A metric with `per_query` has an interval, and a paired test of every two methods. `average_metric` makes one.
    """

    name: str  # in options, JSON and CSV
    words: str  # at the head of a column, without the unit
    of: Callable[[Answers], float | None]  # the number in JSON and in the CSV of runs; None if it is undefined
    meaning: str  # in a few words, after the head
    digits: int = 1  # behind the point
    unit: str = "%"  # for people
    higher_is_better: bool = True
    cost: float | None = None  # the stored value of one unit, printed with three digits; None: an accuracy
    per_query: Callable[[Answers, Ties], Values] | None = None  # (n_queries,), 0 to 1, of which `of` is the mean

    @property
    def head(self) -> str:
        """Return the head of a column, with the unit."""
        return f"{self.words} {self.unit}".rstrip()

    @property
    def explained(self) -> str:
        """Return its meaning and which way is better, in one sentence."""
        return f"{self.words}: {self.meaning}; {'higher' if self.higher_is_better else 'lower'} is better."

    def list_values(self, answers: Answers, ties: Ties = "expected") -> Values:
        """Return the value of each query, (n_queries,), from 0 to 1.

        Raises BadInput for values beyond, of which no interval of shares is right, ValueError without `per_query`.
        """
        if self.per_query is None:
            raise ValueError(f"{self.name} has no value per query")
        values = self.per_query(answers, ties)
        if not ((values >= 0) & (values <= 1)).all():
            ends = f"{values.min():g} to {values.max():g}"
            remedy = "scale them, or make a Metric of the whole run, without per_query"
            raise BadInput(f"metric {self.name}: its values per query run from {ends}, wanted 0 to 1: {remedy}")
        return values

    def shown(self, value: float) -> float:
        """Return a stored value in the unit that people read."""
        if self.cost is not None:
            return value / self.cost
        return 100 * value if self.unit == "%" else value

    def text(self, value: float | None) -> str:
        """Return a stored value for people, without its unit."""
        return "-" if value is None else self.rounded_text(self.shown(value))

    def rounded_text(self, shown: float) -> str:
        """Return a value that `shown` gave, rounded: of a cost to three digits, or to all before the point."""
        return f"{shown:.{self.digits}f}" if self.cost is None else format_three_digits(shown)


def average_metric(
    name: str, words: str, per_query: Callable[[Answers, Ties], Values], meaning: str, **written: Any
) -> Metric:
    """Return a metric that is the mean of `per_query` over all queries; undefined if no query has a right place.

    `per_query` takes a run and "expected", "pessimistic" or "optimistic", the way to break ties between scores, and
    returns a value for each query, (n_queries,), 0 to 1. `written` are further fields of `Metric`, as digits and unit.
    """

    def average(answers: Answers) -> float | None:
        return float(metric.list_values(answers).mean()) if answers.outcome.answerable.any() else None

    metric = Metric(name, words, average, meaning, per_query=per_query, **written)
    return metric


@cache
def load_plug_in_metrics() -> None:
    """Add the metrics of installed packages to `METRICS`; raises BadInput for one that is none, or whose name is taken.

    An entry point of the group `vprbench.metrics` names a `Metric`.
    """
    for point in entry_points(group=ENTRY_POINTS):
        metric = point.load()
        if not isinstance(metric, Metric):
            raise BadInput(f"{point.value} of {ENTRY_POINTS} is {type(metric).__name__}: a Metric is wanted")
        if metric.name in GROUPS or METRICS.setdefault(metric.name, metric) is not metric:
            raise BadInput(f"{point.value}: {metric.name} is the name of another metric: rename it")


def _make_share(name: str, words: str, function: Callable[[Outcome], float | None], meaning: str) -> Metric:
    return Metric(name, words, lambda answers: function(answers.outcome), meaning)


def _make_area(name: str, words: str, function: Callable[[Outcome], float | None], meaning: str) -> Metric:
    return replace(_make_share(name, words, function, meaning), digits=3, unit="")


def _make_cost(name: str, words: str, unit: str, one: float, meaning: str) -> Metric:
    def read_energy(answers: Answers) -> float | None:
        return None if answers.energy is None else answers.energy["values"].get(name)

    return Metric(name, words, read_energy, meaning, unit=unit, higher_is_better=False, cost=one)


def _make_recall(n: int) -> Metric:
    meaning = f"the share of queries with a right place among the best {n}"
    return average_metric(
        f"recall_at_{n}", f"R@{n}", lambda answers, ties: count_hits(answers.outcome, n, ties), meaning
    )


def _compute_area_under_a(outcome: Outcome, area: Callable[[PRCurve], float]) -> float | None:
    curve = compute_pr_curve(outcome, "A")
    return None if curve is None else area(curve)


def _sum_steps_under_c(answers: Answers) -> float | None:
    """Return the average precision over all pairs of a query and a place; None if a run kept few of its places."""
    n_queries, depth = answers.top_scores.shape
    if depth < answers.outcome.n_places:
        return None
    scores = np.empty((n_queries, depth), np.float32)
    np.put_along_axis(scores, answers.top_places.astype(np.int64), answers.top_scores, axis=1)
    curve = pr_curve_multi(scores, answers.positives)
    return None if curve is None else average_precision(curve)


_PAIRS = "step sum under curve C, over all pairs, of runs that keep the whole map (depth)"
_ACCURACIES = (
    *map(_make_recall, RECALLS),
    _make_area("auc_pr_a", "AUC-PR (A)", partial(_compute_area_under_a, area=auc), "trapezoids under curve A"),
    _make_area(
        "average_precision_a",
        "AP (A)",
        partial(_compute_area_under_a, area=average_precision),
        "step sum under curve A",
    ),
    _make_share("r100p", "R@100P", recall_at_full_precision, "the share answered before the first error"),
    _make_share("p100r", "P@100R", precision_at_full_recall, "precision where every query is answered"),
    _make_area("auc_roc", "AUC-ROC", auc_roc, "the chance that a right match outscores a wrong one"),
    _make_area("ep", "EP", extended_precision, "extended precision, (P_R0 + R_P100) / 2"),
    _make_area("f1_max", "F1-max", f1_max, "the highest F1 on curve A"),
    Metric("ap_c", "AP (C)", _sum_steps_under_c, _PAIRS, digits=3, unit=""),
)
_COSTS = (
    _make_cost("synops_ac", "ACs", "k", 1e3, "accumulates a query, spikes that are all alike x existing synapses"),
    _make_cost(
        "synops_mac", "MACs", "k", 1e3, "multiply-accumulates a query, spikes with amplitudes x existing synapses"
    ),
    _make_cost("operations", "Ops", "M", 1e6, "operations a query, encode and match, a multiply-add being two"),
    _make_cost(
        "joules_estimated", "Estimate", "µJ", 1e-6, "an estimate of joules a query by a 45 nm table, without memory"
    ),
    _make_cost(
        "joules_measured", "Measured", "mJ", 1e-3, "joules a query by a counter, less those of the idle machine"
    ),
    _make_cost("map_bytes", "Map", "B/place", 1.0, "bytes of the map that answers need, a place"),
)

#: Names that stand for several.
GROUPS: Mapping[str, tuple[str, ...]] = {"energy": tuple(cost.name for cost in _COSTS)}

#: By name, in the order of a list for people.
METRICS: dict[str, Metric] = {metric.name: metric for metric in (*_ACCURACIES, *_COSTS)}

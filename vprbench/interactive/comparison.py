"""Several methods on one dataset, ranked: a table, a sentence and a figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Unpack

import numpy as np
import pandas as pd

from vprbench.errors import BadInput
from vprbench.interactive.choices import AnyDataset, AnyMethod, place
from vprbench.interactive.result import NAN, Result
from vprbench.interactive.running import Options, Prepared, finished, prepared
from vprbench.metrics.registry import METRICS, Metric
from vprbench.paper.ranking import Ranked, Ranking, ranked
from vprbench.paper.selection import Series
from vprbench.run.settings import insist_on_metrics

if TYPE_CHECKING:
    from vprbench.paper.figures.style import Figure


@dataclass(frozen=True, repr=False, eq=False)
class Comparison:
    """Results of several methods on the same queries, and their ranking by R@1."""

    results: tuple[Result, ...]  # of all methods and seeds, as they were asked for
    ranking: Ranking
    metrics: tuple[str, ...] = ()  # more columns of the table

    @property
    def table(self) -> pd.DataFrame:
        """A row for each method, the best first: mean R@1, 0 to 1, its 95 % interval, queries per second, seconds."""
        return pd.DataFrame([self._row(row) for row in self.ranking.rows])

    @property
    def sentence(self) -> str:
        """What a test says of the best method."""
        return self.ranking.sentences[0]

    def plot_pr(self) -> Figure:
        """Return the figure of precision and recall of all methods; raises BadInput if no query has a right place."""
        from vprbench.paper.figures.accuracy import precision_recall

        spiking = {result.name for result in self.results if result.run.spikes is not None}
        return precision_recall([Series(row.name, row.name in spiking, row.runs) for row in self.ranking.rows]).figure

    def to_markdown(self) -> str:
        """Return the table in Markdown."""
        return str(self._text().to_markdown(index=False, disable_numparse=True))

    def to_latex(self) -> str:
        """Return the table in LaTeX; it needs the package booktabs."""
        return str(self._text().to_latex(index=False, escape=True))

    def __repr__(self) -> str:
        names = ", ".join(row.name for row in self.ranking.rows)
        return f"<{names} on {self.results[0].run.dataset}: {self.sentence}>"

    def _repr_html_(self) -> str:
        sentences = pd.DataFrame({self.results[0].run.dataset: self.ranking.sentences})
        return "".join(table.to_html(index=False, border=0) for table in (self._text(), sentences))

    def _row(self, row: Ranked) -> dict[str, str | float | int]:
        of_seeds = {name: [METRICS[name].of(run) for run in row.runs] for name in self.metrics}
        more = {name: [value for value in values if value is not None] for name, values in of_seeds.items()}
        return {
            "method": row.name,
            "recall_at_1": _known(row.recall),
            "low": _known(row.low),
            "high": _known(row.high),
            **{name: float(np.mean(values)) if values else NAN for name, values in more.items()},
            "hz": _known(row.hz),
            "fit_seconds": _known(row.fit_seconds),
            "seeds": len(row.runs),
        }

    def _text(self) -> pd.DataFrame:
        """Return the table as text for people: percent, and a dash for what there is not."""
        table = self.table

        def told(name: str, metric: Metric) -> pd.Series[str]:
            return table[name].map(metric.text, na_action="ignore").fillna("-")

        recall = METRICS["recall_at_1"]
        shown = {
            "Method": table["method"],
            recall.head: told("recall_at_1", recall),
            "95 %": "[" + told("low", recall) + ", " + told("high", recall) + "]",
            **{METRICS[name].head: told(name, METRICS[name]) for name in self.metrics},
            "Queries/s": table["hz"].map("{:,.0f}".format).where(table["hz"].notna(), "not timed"),
            "Fit s": table["fit_seconds"].map("{:,.1f}".format).where(table["fit_seconds"].notna(), "-"),
        }
        return pd.DataFrame(shown)


def compare(
    methods: Sequence[AnyMethod],
    dataset: AnyDataset,
    seeds: int | Sequence[int] = 1,
    metrics: Sequence[str] = (),
    **options: Unpack[Options],
) -> Comparison:
    """Run methods on a dataset, as `run` does, or find their stored runs, and rank them by R@1.

    `seeds` is how many there are, from 0 on, or which; a method that takes no seed runs once. `metrics` are more
    columns of the table. All methods are built and checked before the first runs. Raises what `run` raises, and
    BadInput for no methods and for one that is asked for twice.
    """
    insist_on_metrics(metrics)
    numbers = list(range(seeds)) if isinstance(seeds, int) else list(seeds)
    if not len(methods) or isinstance(methods, str) or not numbers or "seed" in options:
        raise BadInput(f"methods={methods}, seeds={seeds}: give a list of methods, and at least one seed with seeds=")
    where = place(dataset)
    first = [prepared(method, where, {**options, "seed": numbers[0]}) for method in methods]
    names = [_asked(ready) for ready in first]
    for name in names:
        if names.count(name) > 1:
            raise BadInput(f"methods: {' '.join(name)} is asked for twice")
    of_methods: list[list[Result]] = []
    for method, ready in zip(methods, first, strict=True):
        more = numbers[1:] if "seed" in ready.request.config["method"] else []
        others = (prepared(method, where, {**options, "seed": seed}) for seed in more)
        of_methods.append([finished(each) for each in (ready, *others)])
    series = [Series(each[0].name, each[0].run.spikes is not None, tuple(r.run for r in each)) for each in of_methods]
    return Comparison(tuple(result for each in of_methods for result in each), ranked(series), tuple(metrics))


def _asked(ready: Prepared) -> tuple[str, ...]:
    asked = ready.request.config["overrides"]
    return (ready.request.name, *(text for text in asked if text.startswith("method.")))


def _known(value: float | None) -> float:
    return NAN if value is None else value

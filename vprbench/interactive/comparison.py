"""Several methods on one dataset, ranked: a table, a sentence and a figure."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
import pandas as pd

from vprbench.errors import BadInput, NotThere
from vprbench.interactive import short
from vprbench.interactive.choices import AnyDataset, AnyMethod, DatasetChoice, choose_dataset, choose_method
from vprbench.interactive.result import Result
from vprbench.interactive.running import Options, finish, prepare
from vprbench.metrics.registry import METRICS
from vprbench.paper.ranking import NUMBERS, Ranking, rank_rows
from vprbench.paper.selection import Series
from vprbench.paper.table.quantities import RATES
from vprbench.runs import frame, rows
from vprbench.runs.experiment import Experiment
from vprbench.runs.frame import iterate_rows
from vprbench.runs.record import Failure
from vprbench.runs.request import spell_out_metrics
from vprbench.runs.sequences import parse_views
from vprbench.text import NOTHING, format_two_digits, plural

if TYPE_CHECKING:
    from vprbench.paper.figures.style import Figure

logger = logging.getLogger(__name__)


@dataclass(frozen=True, repr=False, eq=False)
class Comparison:
    """Results of several methods on the same queries, and their ranking by R@1."""

    results: tuple[Result, ...]  # of all methods and seeds, as they were asked for
    ranking: Ranking
    metrics: tuple[str, ...] = ()  # more columns of the table
    left_out: tuple[Failure, ...] = ()  # methods whose weights are not there

    @property
    def table(self) -> pd.DataFrame:
        """A row for each method, the best first: mean R@1, 0 to 1, its 95 % interval, queries per second, seconds.

        `elsewhere` is R@1 on places that a method was not tuned on, of one that was tuned on others of these. Those
        that were left out stand last, with the reason.
        """
        found = self.ranking.table.drop(columns="runs").assign(left_out="")
        for name in self.metrics:
            of_seeds = ([METRICS[name].of(run) for run in runs] for runs in self.ranking.table["runs"])
            found.insert([*found].index("hz"), name, [pd.Series(each, dtype=float).mean() for each in of_seeds])
        last = [{"method": frame.format_label(one), "seeds": 0, "left_out": one.error} for one in self.left_out]
        every = pd.concat([found, pd.DataFrame(last)], ignore_index=True) if last else found
        return every.astype({**dict.fromkeys(NUMBERS, float), "method": str, "seeds": int, "left_out": str})

    def seen_as(self, sequence: int | Mapping[str, Any] | None, filter: bool | Mapping[str, Any] = False) -> Comparison:
        """Return the comparison of the same runs by sequences, as 4 or {"length": 4, "gaps": "bridge"}, or by a filter.

        Raises BadInput for anything but one view, and for a run that kept no scores.
        """
        asked = parse_views(sequence, filter)
        if len(asked) != 1:
            raise BadInput(f"sequence={sequence}, filter={filter}: give one view, and ask again for each other one")
        results = tuple(result.seen(asked[0]) for result in self.results)
        new = {id(old.run): one for old, one in zip(self.results, results, strict=True)}
        of_rows = [(one.name, [new[id(run)].run for run in one.runs]) for one in self._series()]
        series = [Series(name, runs[0].spikes is not None, tuple(runs)) for name, runs in of_rows]
        return replace(self, results=results, ranking=rank_rows(series))

    @property
    def sentence(self) -> str:
        """The result of the test of the best method, as a sentence."""
        return self.ranking.sentences[0]

    def plot_pr(self) -> Figure:
        """Return the figure of precision and recall of all methods; raises BadInput if no query has a right place."""
        from vprbench.paper.figures.accuracy import draw_precision_recall

        return draw_precision_recall(self._series()).figure

    def to_markdown(self) -> str:
        """Return the table in Markdown."""
        return str(self._text().to_markdown(index=False, disable_numparse=True))

    def to_latex(self) -> str:
        """Return the table in LaTeX; it needs the package booktabs."""
        return str(self._text().to_latex(index=False, escape=True))

    def __repr__(self) -> str:
        methods = plural(len(self.ranking.table), "method")
        return short(f"<{methods} on {self.results[0].run.dataset}: {self.sentence}>")

    def _repr_html_(self) -> str:
        sentences = pd.DataFrame({self.results[0].run.dataset: self.ranking.sentences})
        return "".join(table.to_html(index=False, border=0) for table in (self._text(), sentences))

    def _series(self) -> list[Series]:
        return [
            Series(row.method, row.runs[0].spikes is not None, row.runs) for row in iterate_rows(self.ranking.table)
        ]

    def _text(self) -> pd.DataFrame:
        """Return the table as text for people: percent, and a dash for what there is not."""
        table = self.table

        def column(name: str, text: Callable[[float], str], absent: str = NOTHING) -> list[str]:
            return [absent if np.isnan(value) else text(value) for value in table[name]]

        recall = METRICS["recall_at_1"]

        def interval(low: str, high: str) -> list[str]:
            ends = zip(column(low, recall.text), column(high, recall.text), strict=True)
            return [NOTHING if low == NOTHING else f"[{low}, {high}]" for low, high in ends]

        others = map(
            " ".join, zip(column("elsewhere", recall.text), interval("elsewhere_low", "elsewhere_high"), strict=True)
        )
        judged = self.results[0].run.is_judged
        accuracy = {recall.head: column("recall_at_1", recall.text), "95 %": interval("low", "high")}
        metrics = [METRICS[name] for name in self.metrics if judged or METRICS[name].cost is not None]
        shown = {
            "Method": table["method"],
            **(accuracy if judged else {}),
            **({"Elsewhere": [*others]} if table["elsewhere"].notna().any() else {}),
            **{metric.head: column(metric.name, metric.text) for metric in metrics},
            "Queries/s": column("hz", RATES[0].text, rows.UNTIMED),
            "Fit s": column("fit_seconds", format_two_digits),
            **({"Left out": table["left_out"].map(short)} if self.left_out else {}),
        }
        return pd.DataFrame(shown)


def compare(
    methods: Sequence[AnyMethod],
    dataset: AnyDataset,
    seeds: int | Sequence[int] = 1,
    metrics: Sequence[str] = (),
    sequence: int | Mapping[str, Any] | None = None,
    **options: Unpack[Options],
) -> Comparison:
    """Run methods on a dataset, as `run` does, or find their stored runs, and rank them by R@1.

    `seeds` is how many there are, from 0 on, or which; a method that takes no seed runs once. `metrics` are more
    columns of the table. With a `sequence`, as 4 or {"length": 4, "window": "centred"}, they are ranked by the answers
    of so many neighbouring queries; `Comparison.seen_as` gives other views without another run. All methods are built
    and checked before the first runs; one whose weights are not there is left out, with a warning. Raises what `run`
    raises, and BadInput, a line for each thing that is wrong.
    """
    metrics = spell_out_metrics(metrics)
    asked = parse_views(sequence)
    numbers = list(range(seeds)) if isinstance(seeds, int) else list(seeds)
    unusable = not numbers or min(numbers) < 0 or len({*numbers}) < len(numbers)
    if not len(methods) or isinstance(methods, str) or unusable or "seed" in options:
        raise BadInput(f"methods={methods}, seeds={seeds}: give a list of methods, and different seeds with seeds=")
    where = choose_dataset(dataset)
    there, left_out = _checked(methods, where, {**options, "seed": numbers[0]})
    of_methods: list[list[Result]] = []
    for method, ready in there:
        more = numbers[1:] if "seed" in ready.request.method else []
        others = (prepare(method, where, {**options, "seed": seed}) for seed in more)
        of_methods.append([finish(each) for each in (ready, *others)])
    series = [Series(each[0].name, each[0].run.spikes is not None, tuple(r.run for r in each)) for each in of_methods]
    results = tuple(result for each in of_methods for result in each)
    found = Comparison(results, rank_rows(series), tuple(metrics), tuple(left_out))
    return found.seen_as(sequence) if asked else found


def _checked(
    methods: Sequence[AnyMethod], where: DatasetChoice, options: Options
) -> tuple[list[tuple[AnyMethod, Experiment]], list[Failure]]:
    """Return the methods that can run, and those whose weights are not there; raises BadInput, a line for each error.

    Raises NotThere if no method can run.
    """
    there: list[tuple[AnyMethod, Experiment]] = []
    left_out: list[Failure] = []
    wrong: dict[str, list[str]] = {}  # the methods of each error
    names: list[str] = []
    for method in methods:
        try:
            there.append((method, prepare(method, where, options)))
            request = there[-1][1].request
            names.append(frame.format_label(Failure(request.method_name, request.dataset_name, request.record(), "")))
        except NotThere as error:
            chosen = choose_method(method, None, None)
            asked = {"overrides": chosen.overrides}
            left_out.append(Failure(chosen.name, where.dataset.name, asked, str(error), missing=True))
            names.append(frame.format_label(left_out[-1]))
        except Exception as error:  # whatever a plug-in raises
            told = str(error) if isinstance(error, BadInput) else f"{type(error).__name__}: {error}"
            wrong.setdefault(told, []).append(short(method if isinstance(method, str) else repr(method)))
    if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
        wrong["asked for twice"] = twice
    if wrong:
        raise BadInput("\n".join(f"{', '.join(of)}: {error}" for error, of in wrong.items()))
    if not there:
        raise NotThere("\n".join(f"{frame.format_label(one)}: {one.error}" for one in left_out))
    for one in left_out:
        logger.warning("%s is left out: %s", frame.format_label(one), one.error)
    return there, left_out

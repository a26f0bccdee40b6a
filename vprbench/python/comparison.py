"""Several methods on one dataset, ranked: a table, a sentence and a figure."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import pandas as pd

from vprbench.api.dataset import Dataset
from vprbench.errors import BadInput, MissingData
from vprbench.metrics.catalogue import METRICS
from vprbench.python.choices import AnyDataset, AnyMethod, Choice, choose_dataset, choose_method
from vprbench.python.result import Result
from vprbench.python.running import Options, finish, prepare
from vprbench.report.folder import report_runs
from vprbench.report.gather import Report
from vprbench.report.ranking import NUMBERS, Ranking, rank_rows
from vprbench.report.robustness import Robustness, measure_robustness
from vprbench.report.selection import MethodRuns
from vprbench.report.table.quantities import RATES
from vprbench.runs.corruption import Corruption, parse_corruptions
from vprbench.runs.experiment import Experiment, corrupt_experiment
from vprbench.runs.frame import iterate_rows
from vprbench.runs.request import spell_out_metrics
from vprbench.runs.rows import UNTIMED
from vprbench.runs.sequences import parse_views
from vprbench.runs.timing_protocol import Protocol
from vprbench.text import NOTHING, format_count, format_interval, format_percent, format_two_digits, shorten

if TYPE_CHECKING:
    from vprbench.report.figures.style import Figure

logger = logging.getLogger(__name__)


@dataclass(frozen=True, repr=False, eq=False)
class Comparison:
    """Results of several methods on the same queries, and their ranking by R@1; printed, it is its table."""

    methods: tuple[tuple[Result, ...], ...]  # of each method a result a seed, in the order given
    metrics: tuple[str, ...] = ()  # more columns of the table
    left_out: Mapping[str, str] = field(default_factory=dict)  # the reason of each method that could not run
    corrupted: Mapping[Corruption, tuple[tuple[Result, ...], ...]] = field(default_factory=dict)  # as `methods`

    @property
    def results(self) -> tuple[Result, ...]:
        """The results of all methods and seeds, in the order given."""
        return tuple(result for of_seeds in self.methods for result in of_seeds)

    @cached_property
    def ranking(self) -> Ranking:
        """The methods, best first, and the sentences of the tests."""
        return rank_rows(_list_runs(self.methods))

    @cached_property
    def robustness(self) -> Robustness:
        """R@1 under the corruptions, beside that on clean frames: `points` is a DataFrame, a line for each.

        Raises BadInput if no query has a right place.
        """
        corrupted = {one: _list_runs(methods) for one, methods in self.corrupted.items()}
        return measure_robustness(_list_runs(self.methods), corrupted)

    @property
    def table(self) -> pd.DataFrame:
        """A row for each method, the best first: mean R@1, 0 to 1, its 95 % interval, queries per second, seconds.

        `elsewhere` is R@1 on the places that a method was not tuned on, if it was tuned on others of these. Methods
        that were left out stand last, with the reason.
        """
        found = self.ranking.table.drop(columns="runs").assign(left_out="")
        for name in self.metrics:
            of_seeds = ([METRICS[name].of(run) for run in runs] for runs in self.ranking.table["runs"])
            found.insert([*found].index("hz"), name, [pd.Series(each, dtype=float).mean() for each in of_seeds])
        last = [{"method": name, "seeds": 0, "left_out": reason} for name, reason in self.left_out.items()]
        every = pd.concat([found, pd.DataFrame(last)], ignore_index=True) if last else found
        return every.astype({**dict.fromkeys(NUMBERS, float), "method": str, "seeds": int, "left_out": str})

    @property
    def sentence(self) -> str:
        """The result of the test of the best method, as a sentence."""
        return self.ranking.sentences[0]

    def in_sequences(self, length: int, **options: Any) -> Comparison:
        """Return the comparison of the same runs by sequences, with the options of `Result.in_sequences`."""
        return self._change(lambda result: result.in_sequences(length, **options))

    def filter(self, **options: Any) -> Comparison:
        """Return the comparison of the same runs by a Bayes filter, with the options of `Result.filter`."""
        return self._change(lambda result: result.filter(**options))

    def plot_pr(self) -> Figure:
        """Return the figure of precision and recall of all methods; raises BadInput if no query has a right place."""
        from vprbench.report.figures.accuracy import draw_precision_recall

        ranked = [row.method for row in iterate_rows(self.ranking.table)]
        return draw_precision_recall(sorted(_list_runs(self.methods), key=lambda one: ranked.index(one.name))).figure

    @cached_property
    def report(self) -> Report:
        """The report of the runs, as `vprbench compare` and `vprbench report` make it."""
        first = self.results[0]
        folder = "" if first.folder is None else str(first.folder.parents[1])
        return report_runs([result.run for result in self.results], (), first.run.dataset, folder, self.metrics)

    def figures(self) -> dict[str, Figure]:
        """Return all figures of the comparison by their names, as `vprbench compare` draws them."""
        from vprbench.report.figures.make import draw_all

        return {name: drawing.figure for name, drawing in draw_all(self.report, self.report.runs)}

    def write(self, folder: str | Path = "results", name: str = "") -> list[Path]:
        """Write table (Markdown, CSV, LaTeX), runs, best places, figures and page into a folder; returns the files.

        They are the files of `vprbench compare`, named after the dataset unless a `name` is given. Raises BadInput if
        the folder cannot be written.
        """
        from vprbench.report.comparison import predict_places, write_comparison

        best = predict_places(self.report, self.results[0].dataset, None)
        robust = self.robustness if self.corrupted else None
        return write_comparison(self.report, Path(folder).expanduser(), name, robust, best)

    def to_markdown(self) -> str:
        """Return the table in Markdown."""
        return str(self._format_table().to_markdown(index=False, disable_numparse=True))

    def to_latex(self) -> str:
        """Return the table in LaTeX; it needs the package booktabs."""
        return str(self._format_table().to_latex(index=False, escape=True))

    def __str__(self) -> str:
        return "\n".join([self._format_table().to_string(index=False), *self.ranking.sentences])

    def __repr__(self) -> str:
        methods = format_count(len(self.methods), "method")
        return shorten(f"<{methods} on {self.results[0].run.dataset}: {self.sentence}>")

    def _repr_html_(self) -> str:
        sentences = pd.DataFrame({self.results[0].run.dataset: self.ranking.sentences})
        return "".join(table.to_html(index=False, border=0) for table in (self._format_table(), sentences))

    def _change(self, change: Callable[[Result], Result]) -> Comparison:
        parts = [self.methods, *self.corrupted.values()]
        methods, *corrupted = (tuple(tuple(map(change, of_seeds)) for of_seeds in part) for part in parts)
        return replace(self, methods=methods, corrupted=dict(zip(self.corrupted, corrupted, strict=True)))

    def _format_table(self) -> pd.DataFrame:
        """Return the table as text for people: percent, and a dash where there is no number."""
        numbers = self.table.astype(object).where(self.table.notna(), None)
        judged = self.results[0].run.is_judged
        elsewhere = self.table["elsewhere"].notna().any()
        metrics = [METRICS[name] for name in self.metrics if judged or METRICS[name].cost is not None]
        lines = []
        for row in iterate_rows(numbers):
            accuracy = {"R@1 %": format_percent(row.recall_at_1), "95 %": _format_ends(row.low, row.high)}
            others = f"{format_percent(row.elsewhere)} {_format_ends(row.elsewhere_low, row.elsewhere_high)}"
            lines.append(
                {
                    "Method": row.method,
                    **(accuracy if judged else {}),
                    **({"Elsewhere": others} if elsewhere else {}),
                    **{metric.head: metric.text(getattr(row, metric.name)) for metric in metrics},
                    "Queries/s": UNTIMED if row.hz is None else RATES[0].text(row.hz),
                    "Fit s": NOTHING if row.fit_seconds is None else format_two_digits(row.fit_seconds),
                    **({"Left out": shorten(row.left_out)} if self.left_out else {}),
                }
            )
        return pd.DataFrame(lines)


def compare(
    methods: Sequence[AnyMethod],
    dataset: AnyDataset,
    seeds: int | Sequence[int] = 1,
    metrics: Sequence[str] = (),
    sequence: int | Mapping[str, Any] | None = None,
    corruptions: Sequence[str] = (),
    **options: Unpack[Options],
) -> Comparison:
    """Run methods on a dataset, as `run` does, or find their stored runs, and rank them by R@1.

    All methods are built and checked before the first runs. A method without its weights is left out, with a warning.

    Args:
        methods: each as `run` takes one.
        dataset: as `run` takes one.
        seeds: their number, from 0 on, or a list of them; a method that takes no seed runs once.
        metrics: more columns of the table.
        sequence: a length, as 4, or {"length": 4, "window": "centred"}: methods are ranked by the answers of so many
            neighbouring queries. `Comparison.in_sequences` gives other lengths without another run.
        corruptions: of the query frames, as ["shift-1", "blur"]; `Comparison.robustness` holds R@1 under each. A
            method is fitted once for all of them.
        options: those of `run`.

    Raises:
        BadInput: a line for each thing that does not fit.
        MissingData: no method has its weights, or frames are missing.
    """
    metrics = spell_out_metrics(metrics)
    views = parse_views(sequence)
    numbers = list(range(seeds)) if isinstance(seeds, int) else list(seeds)
    unusable = not numbers or min(numbers) < 0 or len({*numbers}) < len(numbers)
    if not len(methods) or isinstance(methods, str) or unusable or "seed" in options:
        raise BadInput(f"methods={methods}, seeds={seeds}: give a list of methods, and different seeds with seeds=")
    data = choose_dataset(dataset)
    ready, left_out = _prepare_all(methods, data, {**options, "seed": numbers[0]})
    found: list[tuple[Result, ...]] = []
    spoilt: dict[Corruption, list[tuple[Result, ...]]] = {one: [] for one in parse_corruptions(corruptions)}
    for method, first in ready:
        more = numbers[1:] if "seed" in first.request.method else []
        experiments = [first, *(prepare(method, data, {**options, "seed": seed}) for seed in more)]
        found.append(tuple(map(finish, experiments)))
        for one, results in spoilt.items():
            results.append(tuple(finish(_corrupt_untimed(each, one)) for each in experiments))
    corrupted = {one: tuple(results) for one, results in spoilt.items()}
    comparison = Comparison(tuple(found), tuple(metrics), left_out, corrupted)
    return comparison._change(lambda result: result.seen(views[0])) if views else comparison


def _corrupt_untimed(experiment: Experiment, one: Corruption) -> Experiment:
    """Return the same experiment on corrupted query frames, its rates not timed and its frames not kept."""
    request = replace(experiment.request, timing=Protocol(rates=False), frames=False)
    return corrupt_experiment(replace(experiment, request=request), one.name)


def _list_runs(methods: Sequence[Sequence[Result]]) -> list[MethodRuns]:
    """Return the runs of methods as rankings and figures take them."""
    runs = [tuple(result.run for result in of_seeds) for of_seeds in methods]
    return [MethodRuns(of[0].name, each[0].spikes is not None, each) for of, each in zip(methods, runs, strict=True)]


def _prepare_all(
    methods: Sequence[AnyMethod], data: tuple[Choice, Dataset], options: Options
) -> tuple[list[tuple[AnyMethod, Experiment]], dict[str, str]]:
    """Return the methods that can run, and of those without weights the reason by their names.

    Raises BadInput, a line for each error, and MissingData if no method can run.
    """
    ready: list[tuple[AnyMethod, Experiment]] = []
    left_out: dict[str, str] = {}
    wrong: dict[str, list[str]] = {}  # the methods of each error
    names: list[str] = []
    for method in methods:
        name = shorten(method if isinstance(method, str) else repr(method))
        try:
            label = choose_method(method).label
            names.append(label)
            ready.append((method, prepare(method, data, options)))
        except MissingData as error:
            left_out[label] = str(error)
        except Exception as error:  # a plug-in may raise anything
            text = str(error) if isinstance(error, BadInput) else f"{type(error).__name__}: {error}"
            wrong.setdefault(text, []).append(name)
    if twice := [name for name in dict.fromkeys(names) if names.count(name) > 1]:
        wrong["given twice"] = twice
    if wrong:
        raise BadInput("\n".join(f"{', '.join(given)}: {error}" for error, given in wrong.items()))
    if not ready:
        raise MissingData("\n".join(f"{name}: {reason}" for name, reason in left_out.items()))
    for name, reason in left_out.items():
        logger.warning("%s is left out: %s", name, reason)
    return ready, left_out


def _format_ends(low: float | None, high: float | None) -> str:
    return NOTHING if low is None or high is None else format_interval(low, high)

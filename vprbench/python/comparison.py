"""Several methods on one dataset, ranked: the report of `vprbench compare`, and its results as objects."""

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
from vprbench.python.choices import AnyDataset, AnyMethod, Choice, choose_dataset
from vprbench.python.result import Result
from vprbench.python.running import Options, finish_run, request_run
from vprbench.report.folder import report_runs
from vprbench.report.ranking import NUMBERS, Ranking
from vprbench.report.robustness import Robustness, measure_robustness
from vprbench.report.selection import MethodRuns, group_runs_by_column, list_method_runs
from vprbench.report.table import formats
from vprbench.report.table.best import average_seeds
from vprbench.report.table.cells import Report
from vprbench.runs.corruption import Corruption, parse_corruptions
from vprbench.runs.experiment import Experiment, build_experiment, corrupt_experiment
from vprbench.runs.frame import format_label
from vprbench.runs.record import Failure
from vprbench.runs.request import spell_out_metrics
from vprbench.runs.sequences import parse_views
from vprbench.runs.timing_protocol import Protocol
from vprbench.text import format_count, shorten

if TYPE_CHECKING:
    from vprbench.report.figures.style import Figure

logger = logging.getLogger(__name__)


@dataclass(frozen=True, repr=False, eq=False)
class Comparison:
    """Results of several methods on the same queries, and their ranking by R@1; printed, it is its table."""

    results: tuple[Result, ...]  # one a method and seed, in the order given
    metrics: tuple[str, ...] = ()  # more columns of the table
    left_out: tuple[Failure, ...] = ()  # methods without their weights
    corrupted: Mapping[Corruption, tuple[Result, ...]] = field(default_factory=dict)  # in the order of `results`

    @cached_property
    def report(self) -> Report:
        """The report of the runs, as `vprbench compare` and `vprbench report` make it."""
        first = self.results[0]
        folder = "" if first.folder is None else str(first.folder.parents[1])
        runs = [result.run for result in self.results]
        return report_runs(runs, self.left_out, first.run.dataset, folder, self.metrics)

    @property
    def ranking(self) -> Ranking:
        """The methods, best first, and the sentences of the tests."""
        return self.report.rankings[0]

    @property
    def sentence(self) -> str:
        """The result of the test of the best method, as a sentence."""
        return self.ranking.sentences[0]

    @property
    def table(self) -> pd.DataFrame:
        """A row for each method, the best first: mean R@1, 0 to 1, its 95 % interval, queries per second, seconds.

        `elsewhere` is R@1 on the places that a method was not tuned on, if it was tuned on others of these. Methods
        that were left out stand last, with the reason.
        """
        found = self.ranking.table.assign(left_out="")
        for name in self.metrics:
            values = [average_seeds(runs, METRICS[name]) for runs in found["runs"]]
            found.insert([*found].index("hz"), name, values)
        lines = found.drop(columns="runs").to_dict("records")
        lines += [{"method": format_label(one), "seeds": 0, "left_out": one.error} for one in self.left_out]
        kinds = {"method": str, **dict.fromkeys([*NUMBERS, *self.metrics], float), "seeds": int, "left_out": str}
        return pd.DataFrame(lines, columns=[name for name in found if name != "runs"]).astype(kinds)

    @cached_property
    def robustness(self) -> Robustness:
        """R@1 under the corruptions, beside that on clean frames: `points` is a DataFrame, a line for each.

        Raises BadInput if no query has a right place.
        """
        return measure_robustness(
            self._list_rows(self.results), {one: self._list_rows(results) for one, results in self.corrupted.items()}
        )

    def in_sequences(self, length: int, **options: Any) -> Comparison:
        """Return the comparison of the same runs by sequences, with the options of `Result.in_sequences`."""
        return self._change(lambda result: result.in_sequences(length, **options))

    def filter(self, **options: Any) -> Comparison:
        """Return the comparison of the same runs by a Bayes filter, with the options of `Result.filter`."""
        return self._change(lambda result: result.filter(**options))

    def figures(self) -> dict[str, Figure]:
        """Return all figures of the comparison by their names, as `vprbench compare` draws them."""
        from vprbench.report.figures.make import draw_all

        return {name: drawing.figure for name, drawing in draw_all(self.report)}

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
        """Return the table in Markdown, with its notes and its legend."""
        return formats.to_markdown(self.report)

    def to_latex(self) -> str:
        """Return the table in LaTeX; it needs the package booktabs."""
        return formats.to_latex(self.report)

    def __str__(self) -> str:
        return formats.to_terminal(self.report, wide=True)

    def __repr__(self) -> str:
        methods = format_count(len(self.ranking.table), "method")
        return shorten(f"<{methods} on {self.results[0].run.dataset}: {self.sentence}>")

    def _repr_html_(self) -> str:
        sentences = pd.DataFrame({"Findings": self.ranking.sentences})
        return formats.to_html(self.report) + sentences.to_html(index=False, border=0)

    def _change(self, change: Callable[[Result], Result]) -> Comparison:
        corrupted = {one: tuple(map(change, results)) for one, results in self.corrupted.items()}
        return replace(self, results=tuple(map(change, self.results)), corrupted=corrupted)

    def _list_rows(self, results: Sequence[Result]) -> list[MethodRuns]:
        """Return the runs of some results by method, the best first."""
        plan, runs = self.report.plan, [result.run for result in results]
        columns = [replace(plan.columns[0], corruption=runs[0].config.get("corruption"))]
        return list_method_runs(group_runs_by_column(runs, (), columns, plan.rows)[0], plan.rows)


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
    where, data = choose_dataset(dataset)
    ready, left_out = _build_all(methods, where, data, {**options, "seed": numbers[0]})
    results: list[Result] = []
    corrupted: dict[Corruption, list[Result]] = {one: [] for one in parse_corruptions(corruptions)}
    for method, first in ready:
        for seed in numbers if "seed" in first.request.method else numbers[:1]:
            request, make = request_run(method, where, {**options, "seed": seed})
            experiment = first if seed == numbers[0] else build_experiment(request, data, make)
            results.append(finish_run(experiment))
            untimed = replace(experiment.request, timing=Protocol(rates=False), frames=False)
            for one, of_one in corrupted.items():
                of_one.append(finish_run(corrupt_experiment(replace(experiment, request=untimed), one.name)))
    spoilt = {one: tuple(of_one) for one, of_one in corrupted.items()}
    comparison = Comparison(tuple(results), tuple(metrics), tuple(left_out), spoilt)
    return comparison._change(lambda result: result.seen(views[0])) if views else comparison


def _build_all(
    methods: Sequence[AnyMethod], where: Choice, data: Dataset, options: Options
) -> tuple[list[tuple[AnyMethod, Experiment]], list[Failure]]:
    """Return the methods that can run, and the failures of those without weights.

    Raises BadInput, a line for each error, and MissingData if no method can run.
    """
    ready: list[tuple[AnyMethod, Experiment]] = []
    left_out: list[Failure] = []
    wrong: list[str] = []
    known: list[Mapping[str, Any]] = []
    for method in methods:
        try:
            request, make = request_run(method, where, options)
            if request.method in known:
                raise BadInput("given twice")
            known.append(request.method)
            ready.append((method, build_experiment(request, data, make)))
        except MissingData as error:
            left_out.append(Failure(request.method_name, data.name, request.record(), str(error), missing=True))
            logger.warning("%s is left out: %s", request.method_name, error)
        except Exception as error:  # a plug-in may raise anything
            text = str(error) if isinstance(error, BadInput) else f"{type(error).__name__}: {error}"
            wrong.append(f"{shorten(method if isinstance(method, str) else repr(method))}: {text}")
    if wrong:
        raise BadInput("\n".join(wrong))
    if not ready:
        raise MissingData("\n".join(f"{one.method}: {one.error}" for one in left_out))
    return ready, left_out

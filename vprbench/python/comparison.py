"""Several methods on one dataset, ranked: the report of `vprbench compare`, and its results as objects."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Unpack

from vprbench.api.dataset import Dataset
from vprbench.errors import BadInput, MissingData
from vprbench.python.choices import AnyDataset, AnyMethod, Choice, choose_dataset
from vprbench.python.result import Result
from vprbench.python.running import Options, finish_run, request_run
from vprbench.report.folder import report_runs
from vprbench.report.plan import Plan
from vprbench.report.report import Report
from vprbench.report.robustness import measure_robustness
from vprbench.report.selection import MethodRuns, group_runs_by_column, list_method_runs
from vprbench.runs.corruption import Corruption, parse_corruptions, require_right_places
from vprbench.runs.experiment import Experiment, build_experiment, corrupt_experiment
from vprbench.runs.record import Failure
from vprbench.runs.request import spell_out_metrics
from vprbench.runs.sequences import Views, parse_views
from vprbench.runs.timing_protocol import Protocol
from vprbench.text import format_count, shorten

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Comparison(Report):
    """The report of several methods on the same queries, as `vprbench compare` makes it, and the result of each run."""

    results: tuple[Result, ...]  # one a method and seed, in the order given
    corrupted: Mapping[Corruption, tuple[Result, ...]]  # in the order of `results`
    left_out: tuple[Failure, ...]  # methods without their weights

    def in_sequences(self, length: int, **options: Any) -> Comparison:
        """Return the comparison of the same runs by sequences, with the options of `Result.in_sequences`."""
        return self.apply_view(parse_views({"length": length, **options})[0])

    def filter(self, **options: Any) -> Comparison:
        """Return the comparison of the same runs by a Bayes filter, with the options of `Result.filter`."""
        return self.apply_view(parse_views(None, options)[0])

    def apply_view(self, view: Views) -> Comparison:
        """Return the comparison of a view of the same runs."""
        corrupted = {one: [result.apply_view(view) for result in of_one] for one, of_one in self.corrupted.items()}
        results = [result.apply_view(view) for result in self.results]
        return report_results(results, self.plan.metrics, self.left_out, corrupted)

    def __repr__(self) -> str:
        methods = format_count(len(self.ranking.table), "method")
        return shorten(f"<{methods} on {self.results[0].run.dataset}: {self.sentence}>")


def report_results(
    results: Sequence[Result],
    metrics: Sequence[str] = (),
    left_out: Sequence[Failure] = (),
    corrupted: Mapping[Corruption, Sequence[Result]] | None = None,
) -> Comparison:
    """Return the report of results on one dataset, with R@1 of the same methods under corruptions.

    Args:
        results: at least one, one a method and seed.
        metrics: more columns of the table.
        left_out: methods without their weights.
        corrupted: for each corruption the results of the same methods and seeds.
    """
    first, spoilt = results[0], {one: tuple(of_one) for one, of_one in (corrupted or {}).items()}
    folder = "" if first.folder is None else str(first.folder.parents[1])
    runs = [result.run for result in results]
    found = report_runs(runs, left_out, first.run.dataset, folder, metrics)
    parts = {part.name: getattr(found, part.name) for part in fields(Report)} | {"dataset": first.dataset}
    if spoilt:
        of_each = {one: _list_rows(found.plan, of_one) for one, of_one in spoilt.items()}
        parts["robustness"] = measure_robustness(_list_rows(found.plan, results), of_each)
    return Comparison(**parts, results=tuple(results), corrupted=spoilt, left_out=tuple(left_out))


def _list_rows(plan: Plan, results: Sequence[Result]) -> list[MethodRuns]:
    """Return the runs of some results by the rows of a plan with one column."""
    runs = [result.run for result in results]
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
    if corruptions:
        require_right_places(data, corruptions)
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
    comparison = report_results(results, metrics, left_out, corrupted)
    return comparison.apply_view(views[0]) if views else comparison


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

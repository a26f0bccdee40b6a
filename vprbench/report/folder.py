"""The report of the runs that a results folder holds, whoever made them: nothing is run."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from vprbench.errors import BadInput
from vprbench.jobs.job import JobResult
from vprbench.report.gather import Plan, Report, assemble_report, load_stored_runs
from vprbench.report.missing_runs import resolve_results_folder
from vprbench.report.plan import NO_PLAN, PlannedColumn, Row
from vprbench.report.ranking import rank_rows
from vprbench.report.run_options import FolderRequest
from vprbench.report.selection import (
    DatasetRuns,
    ResolvedColumn,
    apply_views,
    format_plain_values,
    list_accuracy_runs,
    sort_failures,
    split_by_frames,
)
from vprbench.report.table import formats
from vprbench.report.table.make import write_table
from vprbench.report.table.quantities import drop_accuracies, list_comparison_quantities
from vprbench.runs.frame import format_label
from vprbench.runs.record import Failure, Run
from vprbench.runs.request import RunRequest
from vprbench.runs.rows import format_value
from vprbench.runs.sequences import Views, parse_views
from vprbench.runs.store import Store
from vprbench.text import suggest_names


def read_report(request: FolderRequest) -> Report:
    """Return the report of the runs of a results folder, of the datasets and methods of the request alone.

    Raises BadInput for a name that no run of the folder has, and where nothing is left to show.
    """
    runs, failures = load_stored_runs(request)
    for option in ("dataset", "methods"):
        field = option.removesuffix("s")
        known = {getattr(run, field) for run in runs}
        for name in getattr(request, option):
            if name not in known:
                raise BadInput(
                    f"{option}={name}: no run of it is stored in {request.results}: {suggest_names(name, known)}"
                )
        wanted = {*(getattr(request, option) or known)}
        runs = [run for run in runs if getattr(run, field) in wanted]
        failures = [failure for failure in failures if getattr(failure, field) in wanted]
    title = request.name or Path(request.results).expanduser().absolute().name
    views = parse_views(request.sequence, request.filter)
    return report_runs(runs, failures, title, request.results, request.metrics, request.stores, views)


def print_sweep(keys: Collection[str], request: RunRequest) -> None:
    """Print the runs of a sweep as one table, a row for all seeds of a method, and write it as sweep.md, .csv and .tex.

    `keys` are those of the runs; results folder, metrics and views are those of `request`. Runs of corrupted queries
    are not in the table.
    """
    views = parse_views(request.sequence, request.filter)
    runs = [run for run in Store(resolve_results_folder(request.results)).runs() if run.key in keys]
    if any(run.config.get("corruption") is None for run in runs):
        found = report_runs(runs, (), "sweep", request.results, request.metrics, views=views)
        print(f"\n{formats.to_terminal(found.table, request.wide)}")
        print("written to", *write_table(found, resolve_results_folder(request.results), "sweep"), sep="\n  ")


def report_runs(
    runs: Sequence[Run],
    failures: Sequence[Failure] = (),
    title: str = "runs",
    results: str = "results",
    metrics: Sequence[str] = (),
    stores: Sequence[str] = (),
    views: Sequence[Views] = (),
) -> Report:
    """Return the report of runs: a column for each dataset and protocol, a row for each method with its arguments.

    Runs of corrupted queries are no columns. Raises BadInput if there is no run.
    """
    runs = [run for run in runs if run.config.get("corruption") is None]
    failures = [failure for failure in failures if failure.config.get("corruption") is None]
    devices = sorted({str(run.config["device"]) for run in runs})
    chosen = Plan(
        NO_PLAN,
        describe_rows([*runs, *failures]),
        (),
        tuple(devices),
        metrics=tuple(metrics),
        results=results,
        stores=tuple(stores),
        stored=True,
        title=title,
        quantities=list_comparison_quantities(metrics, devices),
        views=tuple(views),
    )
    return assemble_groups(chosen, group_runs(runs, failures))


def assemble_groups(chosen: Plan, groups: Sequence[DatasetRuns], job_results: Sequence[JobResult] = ()) -> Report:
    """Return the report of groups of runs, in the views that `chosen` names.

    Rows come by their R@1 in the first group that has them, rows without runs last. Without a ground truth there is no
    accuracy. Raises BadInput if there is no run.
    """
    shown = apply_views(groups, chosen.rows, chosen.views)
    ranks: dict[str, int] = {}
    for group in shown:
        for name in rank_rows(list_accuracy_runs(group, chosen.rows)).table["method"]:
            ranks.setdefault(name, len(ranks))
    runs = [run for group in groups for run in group.runs]
    chosen = replace(
        chosen,
        rows=tuple(sorted(chosen.rows, key=lambda row: ranks.get(row.name, len(ranks)))),
        columns=tuple(group.column for group in groups),
    )
    if runs and not any(run.is_judged for run in runs):
        chosen = replace(chosen, quantities=drop_accuracies(chosen.quantities))
    return assemble_report(chosen, shown, runs, tuple(job_results))


def describe_rows(results: Iterable[Run | Failure]) -> tuple[Row, ...]:
    """Return a row for each method and its arguments, named as on the command line, with the seeds of its runs."""
    alike: dict[str, list[Run | Failure]] = {}
    for result in results:
        alike.setdefault(format_plain_values([result.method, result.config["changed"]]), []).append(result)
    rows: dict[str, Row] = {}
    for of_row in alike.values():
        first, label = of_row[0], format_label(of_row[0])
        seeds = tuple(sorted({int(result.config["seed"]) for result in of_row}))
        learns = "seed" in first.config["method"]
        name = label if label not in rows else f"{label} ({sum(each.startswith(label) for each in rows) + 1})"
        rows[name] = Row(
            name,
            first.method,
            training="own" if learns else "map",
            spiking=any(isinstance(result, Run) and result.spikes is not None for result in of_row),
            arguments=first.config["changed"],
            seeds=seeds if learns else seeds[:1],
        )
    return tuple(rows.values())


def group_runs(runs: Sequence[Run], failures: Sequence[Failure]) -> list[DatasetRuns]:
    """Return the runs of each dataset by protocol and frames, the group with the newest run first."""
    found: list[DatasetRuns] = []
    for dataset in sorted({run.dataset for run in runs}):
        sets = split_by_frames(run for run in runs if run.dataset == dataset)
        titles = _name_protocols(dataset, [members[0].protocol for members in sets])
        failed = tuple(sort_failures(failure for failure in failures if failure.dataset == dataset))
        for number, (title, members) in enumerate(zip(titles, sets, strict=True), 1):
            config = members[0].config
            planned = PlannedColumn(dataset, title, ())
            column = ResolvedColumn(planned, config["dataset"], views=config.get("views"))
            found.append(DatasetRuns(column, number, members, failed if number == 1 else ()))
    return found


def _name_protocols(dataset: str, protocols: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return a title for each protocol of a dataset: its name, and the first parts that tell the protocols apart."""
    names = dict.fromkeys(name for protocol in protocols for name in protocol)
    titles = [dataset] * len(protocols)
    for name in names:
        values = [each.get(name) for each in protocols]
        if len({*titles}) < len(titles) and any(value != values[0] for value in values):
            part = name.replace("_", " ")
            titles = [f"{title}, {part} {format_value(value)}" for title, value in zip(titles, values, strict=True)]
    return titles

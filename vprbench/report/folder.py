"""The report of the runs that a results folder holds, whoever made them: nothing is run."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from vprbench.errors import BadInput
from vprbench.report.gather import Plan, Report, assemble_report, load_stored_runs
from vprbench.report.missing_runs import resolve_results_folder
from vprbench.report.plan import PlannedColumn, Row
from vprbench.report.run_options import FolderRequest
from vprbench.report.selection import (
    DatasetRuns,
    ResolvedColumn,
    format_plain_values,
    number_groups,
    split_by_frames,
)
from vprbench.report.table import formats
from vprbench.report.table.make import write_table
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
    if not runs:
        raise BadInput(f"results={request.results} holds no run: give the folder of a run, a table or a comparison")
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
    groups = group_runs(runs, failures)
    chosen = Plan(
        rows=describe_rows([*runs, *failures]),
        columns=tuple(group.column for group in groups),
        devices=tuple(sorted({str(run.config["device"]) for run in runs})),
        metrics=tuple(metrics),
        results=results,
        stores=tuple(stores),
        stored=True,
        title=title,
        views=tuple(views),
    )
    return assemble_report(chosen, groups, [run for group in groups for run in group.runs])


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
        columns = [
            ResolvedColumn(PlannedColumn(dataset, title, ()), first.config["dataset"], views=first.config.get("views"))
            for title, (first, *_) in zip(titles, sets, strict=True)
        ]
        found += number_groups(columns, sets, (failure for failure in failures if failure.dataset == dataset))
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

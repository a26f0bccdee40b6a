"""The report of the runs that a results folder holds, whoever made them: nothing is run."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

from vprbench.errors import BadInput
from vprbench.report.gather import assemble_report, load_stored_runs
from vprbench.report.missing_runs import resolve_results_folder
from vprbench.report.plan import Column, Plan, Row
from vprbench.report.report import Report
from vprbench.report.run_options import FolderRequest
from vprbench.report.selection import format_plain_values, group_runs_by_column
from vprbench.report.table import formats
from vprbench.runs.frame import format_label
from vprbench.runs.record import Failure, Run
from vprbench.runs.request import RunRequest
from vprbench.runs.sequences import Views, parse_views
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
    shown = FolderRequest(results=request.results)
    runs = [run for run in load_stored_runs(shown)[0] if run.key in keys]
    if any(run.config.get("corruption") is None for run in runs):
        found = report_runs(runs, (), "sweep", request.results, request.metrics, views=views)
        print(f"\n{formats.to_terminal(found, request.wide)}")
        print("written to", *found.write_table(resolve_results_folder(request.results), "sweep"), sep="\n  ")


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
    plan = Plan(
        rows=_describe_rows([*runs, *failures]),
        columns=_list_columns(runs),
        devices=tuple(sorted({str(run.config["device"]) for run in runs})),
        metrics=tuple(metrics),
        results=results,
        stores=tuple(stores),
        stored=True,
        title=title,
        views=tuple(views),
    )
    groups = group_runs_by_column(runs, failures, plan.columns, plan.rows)
    return assemble_report(plan, groups, [run for group in groups for run in group.runs])


def _list_columns(runs: Iterable[Run]) -> tuple[Column, ...]:
    """Return a column for each dataset and its viewpoints."""
    columns = {}
    for run in sorted(runs, key=lambda run: run.dataset):
        views, dataset = run.config.get("views"), {"name": run.config["dataset"].get("name", run.dataset)}
        name = run.dataset + "-views" * (views is not None)
        columns[format_plain_values([dataset, views])] = Column(name, run.dataset, (), dataset=dataset, views=views)
    return tuple(columns.values())


def _describe_rows(results: Iterable[Run | Failure]) -> tuple[Row, ...]:
    """Return a row for each method and its arguments, named as on the command line, with the seeds of its runs."""
    alike: dict[str, list[Run | Failure]] = {}
    for result in results:
        alike.setdefault(format_plain_values([result.method, result.config["changed"]]), []).append(result)
    rows: dict[str, Row] = {}
    for of_row in alike.values():
        first, label = of_row[0], format_label(of_row[0])
        seeds = tuple(sorted({int(result.config["seed"]) for result in of_row}))
        name = label if label not in rows else f"{label} ({sum(each.startswith(label) for each in rows) + 1})"
        spiking = any(isinstance(result, Run) and result.spikes is not None for result in of_row)
        arguments, draws = first.config["changed"], "seed" in first.config["method"]
        rows[name] = Row(name, first.method, spiking=spiking, arguments=arguments, seeds=seeds if draws else seeds[:1])
    return tuple(rows.values())

"""A report: the rows and columns of a request, and their stored runs; those that are missing are made first."""

from __future__ import annotations

import itertools
import os
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.jobs.executors import Executor
from vprbench.jobs.job import JobResult
from vprbench.metrics.catalogue import GROUPS
from vprbench.plugins import registry
from vprbench.report.missing_runs import Cell, make_missing_runs, resolve_results_folder
from vprbench.report.plan import (
    NO_PLAN,
    PLAN_FILE,
    PlanFile,
    PlannedColumn,
    Row,
    add_plug_ins,
    flatten_arguments,
    read_plan,
)
from vprbench.report.ranking import Ranking, rank_rows
from vprbench.report.run_options import ShowOptions, TableRequest
from vprbench.report.selection import DatasetRuns, ResolvedColumn, apply_views, group_runs_by_column, list_accuracy_runs
from vprbench.report.table.cells import Table, assemble_table
from vprbench.report.table.quantities import drop_accuracies, list_comparison_quantities, list_quantities
from vprbench.runs.record import Failure, Run
from vprbench.runs.sequences import Views, parse_views
from vprbench.runs.store import Store
from vprbench.text import suggest_names

_GPU_DRIVERS = ("/dev/nvidiactl", "/dev/kfd", "/dev/dxg")  # of NVIDIA, of AMD, and of either on Windows


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The rows and columns of a request, resolved."""

    plan: PlanFile = NO_PLAN
    rows: tuple[Row, ...]
    columns: tuple[ResolvedColumn, ...]
    devices: tuple[str, ...]
    full: bool = True
    metrics: tuple[str, ...] = ()
    results: str = "results"
    stores: tuple[str, ...] = ()  # results folders of other machines
    stored: bool = False  # nothing is run
    title: str | None = None  # None: of the published table, whose rows stay in their order
    views: tuple[Views, ...] = ()  # views of the stored runs that are shown; none: the runs themselves

    def slow(self, column: ResolvedColumn, row: Row) -> bool:
        """Tell whether a row takes too long in a column for the time that a table has."""
        places = column.dataset.get("places")
        too_many = row.most_places is not None and isinstance(places, int) and places > row.most_places
        return too_many and not self.full


@dataclass(frozen=True)
class Report:
    """The data of a table, of figures and of a page."""

    chosen: Plan
    groups: tuple[DatasetRuns, ...]
    table: Table
    runs: tuple[Run, ...]  # all that are stored
    job_results: tuple[JobResult, ...]  # of the runs that were tried now

    @cached_property
    def rankings(self) -> list[Ranking]:
        """The rows of each group that has runs, the best first, and the results of tests on them."""
        return [rank_rows(list_accuracy_runs(group, self.chosen.rows)) for group in self.groups if group.runs]


def resolve_plan(request: TableRequest) -> Plan:
    """Resolve a request against conf/paper/table2.yaml; raises BadInput for rows or columns that are unknown."""
    folders = registry.find_conf_folders()
    plan = add_plug_ins(read_plan(folders["vprbench"] / PLAN_FILE), folders)
    rows = {name: plan.rows[_require_known("rows", name, plan.rows)] for name in request.rows or plan.rows}
    for name in request.methods:
        row = _make_row(plan, name)
        rows.setdefault(row.name, row)
    most = {name: None if request.full else row.seeds_unless_full for name, row in rows.items()}
    columns = {}
    for name in request.columns or _choose_columns(plan, request):
        planned = plan.columns[_require_known("columns", name, plan.columns)]
        planned = replace(planned, options=(*planned.options, *_format_root(planned, request)))
        columns[name] = ResolvedColumn(planned, make_request(planned.options).dataset, views=request.views)
    return Plan(
        plan=plan,
        rows=tuple(replace(row, seeds=row.seeds[: request.seeds or most[name]]) for name, row in rows.items()),
        columns=tuple(columns.values()),
        devices=tuple(request.devices or (["cpu"] if request.stored else _list_devices())),
        full=request.full,
        metrics=tuple(request.metrics),
        results=request.results,
        stores=tuple(request.stores),
        stored=request.stored,
        views=parse_views(request.sequence, request.filter),
    )


def make_report(chosen: Plan, options: Sequence[str], executor: Executor | None = None) -> Report:
    """Make the runs that are not stored, unless `chosen.stored` is set, and put the stored ones together.

    The smallest datasets come first, and rows that are slow at full size last. `options` of the command line hold
    for all runs. Raises BadInput if there is no run at all.
    """
    columns = sorted(chosen.columns, key=lambda column: column.dataset.get("places") or 0)
    cells = [
        cell
        for row in sorted(chosen.rows, key=lambda row: row.most_places is not None)
        for column in columns
        if not chosen.stored and not chosen.slow(column, row)
        for cell in list_cells(chosen, column, [row], options)
    ]
    results = run_missing(chosen, cells, executor)
    runs, failures = load_stored_runs(chosen)
    return assemble_report(chosen, group_runs_by_column(runs, failures, chosen.columns, chosen.rows), runs, results)


def list_cells(chosen: Plan, column: ResolvedColumn, rows: Sequence[Row], options: Sequence[str]) -> Iterator[Cell]:
    """Yield the runs of some rows in one column, on a GPU those of methods that compute there.

    `options` of the command line hold for all runs. Raises BadInput for a row that does not fit its method.
    """
    planned, entries = column.planned, registry.find_entries("method")
    values: dict[str, Any] = {"results": str(resolve_results_folder(chosen.results))}
    if {*chosen.metrics} & {*GROUPS["energy"]}:
        values["energy"] = True
    if column.corruption is not None:
        values["corruption"] = column.corruption
    if column.views is not None:
        values["views"] = column.views
    for row in rows:
        _require_known("method", row.method, entries)
        arguments = flatten_arguments(row.arguments, "method.")
        devices = [each for each in chosen.devices if each == "cpu" or "device" in entries[row.method].options]
        for device, seed in itertools.product(devices, row.seeds):
            given = {**values, "seed": seed, "device": device, **arguments}
            yield Cell(row, planned.title, make_request([*planned.options, *options, f"method={row.method}"], given))


def run_missing(chosen: Plan, cells: Sequence[Cell], executor: Executor | None = None) -> list[JobResult]:
    """Make the runs that are not stored, none if `chosen.stored` is set; returns the outcome of each."""
    return [] if chosen.stored else make_missing_runs(cells, Store(resolve_results_folder(chosen.results)), executor)


def load_stored_runs(request: ShowOptions | Plan) -> tuple[list[Run], list[Failure]]:
    """Return the runs and failures of the store and of the stores of other machines, each once."""
    stores = [Store(resolve_results_folder(folder)) for folder in (request.results, *request.stores)]
    runs = {(run.dataset, run.method, run.key): run for store in reversed(stores) for run in store.runs()}
    return [*runs.values()], [failure for store in stores for failure in store.failures()]


def assemble_report(
    chosen: Plan, groups: Sequence[DatasetRuns], runs: Sequence[Run], results: Sequence[JobResult] = ()
) -> Report:
    """Put groups of runs, in the views that `chosen` names, into the table; raises BadInput if they hold none.

    Under a title of its own the rows of a report come by their R@1 in the first group that has them, rows without runs
    last; without a ground truth it has no accuracy.
    """
    found = apply_views(groups, chosen.rows, chosen.views)
    if not any(group.runs for group in found):
        raise BadInput(
            f"results={chosen.results} holds no run of these rows and columns: "
            + ("leave stored=true out, so that some are made" if chosen.stored else "see above why none could be made")
        )
    quantities = list_quantities(chosen.metrics)
    if chosen.title is not None:
        rankings = [rank_rows(list_accuracy_runs(group, chosen.rows)).table["method"] for group in found]
        ranked = [*dict.fromkeys(itertools.chain(*rankings, (row.name for row in chosen.rows)))]
        chosen = replace(chosen, rows=tuple(sorted(chosen.rows, key=lambda row: ranked.index(row.name))))
        quantities = list_comparison_quantities(chosen.metrics, chosen.devices)
        if not any(run.is_judged for group in groups for run in group.runs):
            quantities = drop_accuracies(quantities)
    slow = {
        (column.planned.name, row.name)
        for column, row in itertools.product(chosen.columns, chosen.rows)
        if chosen.slow(column, row)
    }
    table = assemble_table(found, chosen.rows, chosen.plan, slow, quantities, chosen.title)
    return Report(chosen, tuple(found), table, tuple(runs), tuple(results))


def _make_row(plan: PlanFile, name: str) -> Row:
    """Return a row of the plan, or one for a method; raises BadInput for an unknown name.

    A method that the plan has under its own name, and no arguments, is that row. Another one that takes a seed learns
    from it: it trains, and gets the plan's seeds.
    """
    planned, entries = {**plan.rows, **plan.more_rows}, registry.find_entries("method")
    if name in planned:
        return planned[name]
    for row in planned.values():
        if row.method == name and not row.arguments:
            return row
    _require_known("methods", name, [*plan.more_rows, *entries])
    if "seed" in entries[name].options:
        return Row(name, name, training="own", seeds=plan.seeds)
    return Row(name, name, training="map")


def _choose_columns(plan: PlanFile, request: TableRequest) -> list[str]:
    """Return each published dataset if its frames are given, else the rendered column that stands in for it."""
    chosen = []
    for column in plan.columns.values():
        if column.stand_in_for is not None and not column.on_request:
            real = plan.columns[column.stand_in_for]
            chosen.append(real.name if _format_root(real, request) else column.name)
    return chosen


def _format_root(column: PlannedColumn, request: TableRequest) -> tuple[str, ...]:
    """Return the option with the folder of a column's frames, where the request has one."""
    folder = None if column.frames is None else getattr(request, column.frames, None)
    return () if folder is None else (f"dataset.root={Path(folder).expanduser().absolute()}",)


def _list_devices() -> list[str]:
    """Return the CPU, and the GPU where torch sees one; torch is imported only where a driver is."""
    if not any(map(os.path.exists, _GPU_DRIVERS)):
        return ["cpu"]
    import torch  # takes long

    return ["cpu", "cuda"] if torch.cuda.is_available() else ["cpu"]


def _require_known(option: str, name: str, known: Collection[str]) -> str:
    if name not in known:
        raise BadInput(f"{option}={name} is unknown: {suggest_names(name, known)}")
    return name

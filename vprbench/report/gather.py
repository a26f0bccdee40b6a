"""A report: the rows and columns of a request, and their stored runs; those that are missing are made first."""

from __future__ import annotations

import itertools
import os
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from vprbench.api.dataset import Dataset
from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.jobs.executors import Executor
from vprbench.jobs.job import JobResult
from vprbench.metrics.catalogue import GROUPS
from vprbench.plugins import registry
from vprbench.report.missing_runs import Cell, make_missing_runs, resolve_results_folder
from vprbench.report.plan import PLAN_FILE, Column, Plan, PlanFile, Row, add_plug_ins, flatten_arguments, read_plan
from vprbench.report.ranking import rank_rows
from vprbench.report.report import Report
from vprbench.report.run_options import ShowOptions, TableRequest
from vprbench.report.selection import DatasetRuns, apply_views, group_runs_by_column, list_method_runs, title_groups
from vprbench.report.table.cells import tabulate
from vprbench.report.table.quantities import drop_accuracies, list_comparison_quantities, list_quantities
from vprbench.runs.record import Failure, Run
from vprbench.runs.sequences import parse_views
from vprbench.runs.store import Store
from vprbench.text import suggest_names

_GPU_DRIVERS = ("/dev/nvidiactl", "/dev/kfd", "/dev/dxg")  # of NVIDIA, of AMD, and of either on Windows


def resolve_plan(request: TableRequest) -> Plan:
    """Resolve a request against conf/paper/table2.yaml; raises BadInput for rows or columns that are unknown."""
    folders = registry.find_conf_folders()
    plan = add_plug_ins(read_plan(folders["vprbench"] / PLAN_FILE), folders)
    rows = {name: plan.rows[_require_known("rows", name, plan.rows)] for name in request.rows or plan.rows}
    for row in (_find_row(plan, name) for name in request.methods):
        rows.setdefault(row.name, row)
    most = {name: request.seeds or (None if request.full else row.seeds_unless_full) for name, row in rows.items()}
    columns = []
    for name in dict.fromkeys(request.columns or _choose_columns(plan, request)):
        column = plan.columns[_require_known("columns", name, plan.columns)]
        options = (*column.options, *_format_root(column, request))
        dataset = make_request(options).dataset
        real = plan.columns[column.stand_in_for].title if column.stand_in_for else None
        columns.append(replace(column, options=options, dataset=dataset, views=request.views, stand_in_for=real))
    growth = map(plan.growth.column, plan.growth.sizes if request.figures or request.page else ())
    return Plan(
        rows=tuple(replace(row, seeds=row.seeds[: most[name]]) for name, row in rows.items()),
        columns=tuple(columns),
        devices=tuple(request.devices or (["cpu"] if request.stored else _list_devices())),
        full=request.full,
        metrics=tuple(request.metrics),
        results=request.results,
        stores=tuple(request.stores),
        stored=request.stored,
        views=parse_views(request.sequence, request.filter),
        published=plan.published,
        growth_columns=tuple(replace(column, dataset=make_request(column.options).dataset) for column in growth),
        growth_rows=tuple(replace(plan.rows[name], seeds=plan.rows[name].seeds[:1]) for name in plan.growth.rows),
    )


def make_report(
    plan: Plan, options: Sequence[str], executor: Executor | None = None, with_growth: bool = False
) -> Report:
    """Make the runs that are not stored, unless `plan.stored` is set, and put the stored ones together.

    The smallest datasets come first, and rows that are slow at full size last; at the end, if need be, the runs of
    growth, whose frames are not kept. `options` of the command line hold for all runs. Raises BadInput if there is no
    run at all.
    """
    columns = sorted(plan.columns, key=lambda column: column.dataset.get("places") or 0)
    cells: list[Cell] = []
    for row in () if plan.stored else sorted(plan.rows, key=lambda row: row.most_places is not None):
        for column in columns:
            cells += list_cells(plan, column, [row] * (not plan.is_slow(column, row)), options)
    once = replace(plan, devices=("cpu",))
    for column in plan.growth_columns if with_growth and not plan.stored else ():
        cells += list_cells(once, column, plan.growth_rows, [*options, "frames=false"])
    results = make_missing_runs(cells, Store(resolve_results_folder(plan.results)), executor)
    runs, failures = load_stored_runs(plan)
    return assemble_report(plan, group_runs_by_column(runs, failures, plan.columns, plan.rows), runs, results)


def list_cells(plan: Plan, column: Column, rows: Iterable[Row], options: Sequence[str]) -> Iterator[Cell]:
    """Yield the runs of some rows in one column, on a GPU those of methods that compute there.

    `options` of the command line hold for all runs. Raises BadInput for a row that does not fit its method.
    """
    entries = registry.find_entries("method")
    values: dict[str, Any] = {"results": str(resolve_results_folder(plan.results))}
    if {*plan.metrics} & {*GROUPS["energy"]}:
        values["energy"] = True
    for name in ("corruption", "views"):
        if getattr(column, name) is not None:
            values[name] = getattr(column, name)
    for row in rows:
        _require_known("method", row.method, entries)
        arguments = flatten_arguments(row.arguments, "method.")
        devices = [each for each in plan.devices if each == "cpu" or "device" in entries[row.method].options]
        for device, seed in itertools.product(devices, row.seeds):
            given = {**values, "seed": seed, "device": device, **arguments}
            yield Cell(row, column.title, make_request([*column.options, *options, f"method={row.method}"], given))


def load_stored_runs(request: ShowOptions | Plan) -> tuple[list[Run], list[Failure]]:
    """Return the runs and failures of the store and of the stores of other machines, each once."""
    stores = [Store(resolve_results_folder(folder)) for folder in (request.results, *request.stores)]
    runs = {(run.dataset, run.method, run.key): run for store in reversed(stores) for run in store.runs()}
    return [*runs.values()], [failure for store in stores for failure in store.failures()]


def assemble_report(
    plan: Plan,
    groups: Sequence[DatasetRuns],
    runs: Sequence[Run],
    results: Sequence[JobResult] = (),
    dataset: Dataset | None = None,
) -> Report:
    """Put groups of runs, in the views that the plan names, into the table; raises BadInput if they hold none.

    Under a title of its own the rows of a report come by their R@1 in the first group that has them, rows without runs
    last; without a ground truth it has no accuracy.
    """
    found = [*title_groups(apply_views(groups, plan.rows, plan.views))]
    if not any(group.runs for group in found):
        raise BadInput(
            f"results={plan.results} holds no run of these rows and columns: "
            + ("leave stored=true out, so that some are made" if plan.stored else "see above why none could be made")
        )
    quantities = list_quantities(plan.metrics)
    if plan.title is None:
        plan = replace(plan, rows=tuple(sorted(plan.rows, key=lambda row: row.spiking)))
    else:
        rankings = (rank_rows(list_method_runs(group, plan.rows)).table["method"] for group in found)
        ranked = [*dict.fromkeys(itertools.chain(*rankings, (row.name for row in plan.rows)))]
        plan = replace(plan, rows=tuple(sorted(plan.rows, key=lambda row: ranked.index(row.name))))
        quantities = list_comparison_quantities(plan.metrics, plan.devices)
        if not any(run.is_judged for group in groups for run in group.runs):
            quantities = drop_accuracies(quantities)
    return Report(
        plan=plan,
        groups=tuple(found),
        quantities=quantities,
        runs=tuple(runs),
        job_results=tuple(results),
        dataset=dataset,
        **tabulate(plan, found, quantities)._asdict(),
    )


def _find_row(plan: PlanFile, name: str) -> Row:
    """Return a row of the plan, or one for a method; raises BadInput for an unknown name.

    A method that the plan has under its own name, and no arguments, is that row. Another one that takes a seed gets the
    plan's seeds; its yaml says by the tag `trains` that its `fit` trains.
    """
    planned, entries = {**plan.rows, **plan.more_rows}, registry.find_entries("method")
    if name in planned:
        return planned[name]
    for row in planned.values():
        if row.method == name and not row.arguments:
            return row
    _require_known("methods", name, [*plan.more_rows, *entries])
    entry = entries[name]
    seeds = plan.seeds if "seed" in entry.options else (0,)
    return Row(name, name, training="own" if "trains" in entry.tags else "map", seeds=seeds)


def _choose_columns(plan: PlanFile, request: TableRequest) -> list[str]:
    """Return each published dataset if its frames are given, else the rendered column that stands in for it."""
    rendered = [one for one in plan.columns.values() if one.stand_in_for is not None and not one.on_request]
    real = [plan.columns[str(one.stand_in_for)] for one in rendered]
    return [(one if _format_root(one, request) else other).name for one, other in zip(real, rendered, strict=True)]


def _format_root(column: Column, request: TableRequest) -> tuple[str, ...]:
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

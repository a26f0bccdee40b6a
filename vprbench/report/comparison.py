"""`vprbench compare`: missing runs are made, and all of them end in one ranked table, with figures and a page."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

from vprbench.api.dataset import Dataset
from vprbench.config import make_request, split_sweep
from vprbench.data.doctor import check_dataset, look_at_some
from vprbench.errors import BadInput, MissingData
from vprbench.jobs.child import start_server
from vprbench.jobs.executors import choose_executor
from vprbench.plugins import registry
from vprbench.plugins.options import parse_options
from vprbench.progress import show_progress
from vprbench.report.gather import assemble_report, list_cells, load_stored_runs
from vprbench.report.missing_runs import Cell, make_missing_runs, resolve_results_folder
from vprbench.report.plan import Column, Plan, Row
from vprbench.report.robustness import list_lines, measure_robustness
from vprbench.report.run_options import CompareRequest
from vprbench.report.selection import describe_condition, group_runs_by_column, list_method_runs
from vprbench.report.table import formats
from vprbench.report.table.make import choose_exit_code
from vprbench.runs.corruption import corrupt_queries, parse_corruptions, require_right_places
from vprbench.runs.identity import compute_fingerprint
from vprbench.runs.predictions import require_depth
from vprbench.runs.request import OPTIONS
from vprbench.runs.sequences import parse_views
from vprbench.runs.store import Store
from vprbench.runs.viewpoints import parse_viewpoints, record_viewpoints
from vprbench.terminal.console import format_line, show_table
from vprbench.terminal.streams import complain


def make_comparison(options: Sequence[str]) -> int:
    """Compare methods on one dataset by the options of the command line; returns 1 where a run failed, else 0.

    Data and options are checked before anything runs. Raises BadInput.
    """
    request, of_methods, of_dataset, of_runs = sort_options(options)
    if not request.stored and not request.needs_dask:
        start_server()  # imports while the comparison is checked
    with show_progress("compare"):
        plan, dataset = _plan_comparison(request, of_methods, of_dataset, of_runs)
    if dataset is not None and not request.stored and (found := look_at_some(dataset)):
        doctor = shlex.join(["vprbench", "doctor", *of_dataset])
        print(format_line(f"note: {'; '.join(found)}: {doctor} says more", "yellow"), flush=True)
    with choose_executor(request) as executor:
        cells = [] if plan.stored else _list_missing(plan, of_runs)
        results = make_missing_runs(cells, Store(resolve_results_folder(plan.results)), executor)
    groups = group_runs_by_column(*load_stored_runs(plan), plan.columns, plan.rows)
    clean, *corrupted = (group for group in groups if group.number == 1)
    compared = assemble_report(plan, [clean], clean.runs, results, dataset)
    print(formats.to_terminal(compared, request.wide))
    if corrupted:
        of_clean, *of_each = (list_method_runs(group, compared.plan.rows) for group in (clean, *corrupted))
        robust = measure_robustness(of_clean, dict(zip(parse_corruptions(request.corruptions), of_each, strict=True)))
        compared = replace(compared, robustness=robust)
        table = list_lines(robust)
        show_table([*table[0]], [[*line.values()] for line in table], request.wide)
        print()
    files = compared.write(request.results, request.name or "", request.predictions)
    print("written to", *files, sep="\n  ")
    return choose_exit_code(results)


def sort_options(options: Sequence[str]) -> tuple[CompareRequest, dict[str, list[str]], list[str], list[str]]:
    """Return a comparison, the options of each method by its name, those of the dataset, and those of all runs.

    Options of a method are returned as method.option=value. Raises BadInput for options of no comparison.
    """
    own: list[str] = []
    of_dataset: list[str] = []
    rest: list[tuple[str, str, str]] = []  # option, its part above the dot, and the part below
    for option in options:
        above, _, argument = option.partition("=")[0].partition(".")
        if above in CompareRequest.refused:
            raise BadInput(
                f"{option}: a comparison takes methods=NAME,NAME, seeds=NUMBER, corruptions=NAME,NAME, and "
                "NAME.option=value for an option of one of the methods"
            )
        if above == "device":
            own.append(f"devices{option.removeprefix('device')}")
        elif CompareRequest.has(option):
            own.append(option)
        elif above == "dataset":
            of_dataset.append(option)
        else:
            rest.append((option, above, argument))
    for name, given in (("methods", own), ("dataset", of_dataset)):
        if not any(option.startswith(f"{name}=") for option in given):
            raise BadInput(f"{name}= is missing: give names, as in methods=sad,hog dataset=folders; see vprbench list")
    request = parse_options(CompareRequest, own)
    of_methods: dict[str, list[str]] = {name: [] for name in request.methods}
    of_runs = [] if any(option.startswith("timing=") for option in options) else ["timing=quick"]
    for option, above, argument in rest:
        if argument and above in of_methods:
            if argument in ("seed", "device"):
                raise BadInput(f"{option}: give seeds=NUMBER and device=, for all methods")
            of_methods[above].append(f"method{option.removeprefix(above)}")
        elif argument and above not in OPTIONS:
            wanted = ", ".join(f"{name}.{argument}" for name in of_methods)
            raise BadInput(f"option {above}.{argument} is of no method here: give {wanted}")
        else:
            of_runs.append(option)
    return request, of_methods, of_dataset, [*of_runs, *request.threads(of_runs)]


def _plan_comparison(
    request: CompareRequest, of_methods: Mapping[str, Sequence[str]], of_dataset: Sequence[str], of_runs: Sequence[str]
) -> tuple[Plan, Dataset | None]:
    """Return the rows of a comparison, and its columns: on clean frames first, then under each corruption.

    The dataset is None if it cannot be built and stored runs alone are shown. Raises BadInput; where several things do
    not fit, each has a line on standard error.
    """
    of_all = [*of_dataset, *of_runs, f"device={request.devices[0]}"]
    run = make_request(of_all, {"results": request.results})
    if not request.is_distributed and not request.stored:
        run.require_machine()
    if request.predictions:
        require_depth(request.predictions, run.depth, request.predictions)
    views = parse_views(request.sequence, request.filter)
    dataset, rows, wrong = None, list[Row](), list[str]()
    try:
        dataset = record_viewpoints(registry.make_dataset(run.dataset), parse_viewpoints(request.views))
        check_dataset(dataset, bool(views))
    except BadInput as error:
        wrong += [] if request.stored else [str(error)]
    for name, given in of_methods.items():
        try:
            rows += [_make_row(name, [*of_all, *each], request) for each in split_sweep(given)]
        except BadInput as error:
            text = str(error).removeprefix(f"{name}: ").replace("method.", f"{name}.")
            wrong.append(f"{name}: {text}")
    for line in wrong[:-1]:
        complain(line)
    if wrong:
        raise BadInput(wrong[-1])
    title = request.name or run.dataset_name
    clean = Column(title, title, tuple(of_dataset), dataset=run.dataset, views=request.views)
    plan = Plan(
        rows=tuple(rows),
        columns=tuple(_list_compared_columns(clean, request.corruptions, dataset, run.n_threads)),
        devices=tuple(request.devices),
        metrics=tuple(request.metrics),
        results=request.results,
        stores=tuple(request.stores),
        stored=request.stored,
        title=title,
        views=views,
    )
    return plan, dataset


def _list_compared_columns(
    clean: Column, corruptions: Sequence[str], dataset: Dataset | None, threads: int
) -> Iterator[Column]:
    """Yield the clean column and that of each corruption, by the frames of the dataset if there is one.

    Raises BadInput if there is no accuracy that a corruption could lower.
    """
    if corruptions and dataset is not None:
        require_right_places(dataset, corruptions)
    for name in (None, *(one.name for one in parse_corruptions(corruptions))):
        condition = None
        if dataset is not None:
            seen = corrupt_queries(dataset, name)
            condition = describe_condition(compute_fingerprint(seen), seen.protocol, threads)
        yield replace(clean, corruption=name, condition=condition)


def _make_row(name: str, options: Sequence[str], request: CompareRequest) -> Row:
    """Return the row of a method with its options; raises BadInput for values that its class refuses.

    Missing weights, and errors that are no BadInput, are left to its run.
    """
    run = make_request([*options, f"method={name}"])
    if not request.stored:
        try:
            registry.make_method(run.method)
        except Exception as error:  # whatever a plug-in raises
            if isinstance(error, BadInput) and not isinstance(error, MissingData):
                raise
    entry = registry.find_entries("method")[name]
    own = [option.removeprefix("method.") for option in options if option.startswith("method.")]
    seeds = tuple(range(request.seeds)) if "seed" in entry.options else (run.seed,)
    return Row(" ".join([name, *own]), name, spiking="spiking" in entry.tags, arguments=run.changed, seeds=seeds)


def _list_missing(plan: Plan, of_runs: Sequence[str]) -> list[Cell]:
    """Return the runs on clean frames, then those of corrupted queries: on the first device, and untimed.

    A process fits a row's method once for all corruptions.
    """
    clean, *corrupted = plan.columns
    cells = [*list_cells(plan, clean, plan.rows, [*of_runs, *["scores=true"] * bool(plan.views)])]
    if corrupted:
        untimed = [*(option for option in of_runs if not option.startswith("timing")), "timing=none", "frames=false"]
        together = replace(clean, corruption=[str(column.corruption) for column in corrupted])
        cells += list_cells(replace(plan, devices=plan.devices[:1]), together, plan.rows, untimed)
    return cells

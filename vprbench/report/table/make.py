"""The table of a plan from stored runs; missing runs are made first."""

from __future__ import annotations

from collections.abc import Sequence

from vprbench.jobs.executors import choose_executor
from vprbench.jobs.job import JobResult
from vprbench.report.gather import make_report, resolve_plan
from vprbench.report.missing_runs import resolve_results_folder
from vprbench.report.run_options import TableRequest
from vprbench.report.table import formats
from vprbench.runs.sequences import format_view_suffix, parse_views
from vprbench.terminal.console import make_console


def make_table(request: TableRequest, options: Sequence[str]) -> int:
    """Print the table and write it as Markdown, CSV and LaTeX; returns the exit code, 1 where a cell failed.

    Figures and page follow where the request has them. The runs of growth are made for the figures alone.
    """
    plan = resolve_plan(request)
    with choose_executor(request) as executor:
        found = make_report(plan, options, executor, request.figures)
    is_narrow = make_console().is_terminal
    printed = formats.to_terminal(found, request.wide) if is_narrow else formats.to_markdown(found)
    print(printed, end="", flush=True)  # first: it is there to be read even where nothing is written
    name = file_name(request)
    folder = resolve_results_folder(request.results)
    print("\nwritten to", *found.write_table(folder, name), sep="\n  ", flush=True)
    if request.figures:
        print(*found.write_figures(folder / "figures"), sep="\n  ", flush=True)
    if request.page:
        print(found.write_page(folder / f"{'report' if name == 'table' else f'report-{name}'}.html"), flush=True)
    return choose_exit_code(found.job_results)


def file_name(request: TableRequest) -> str:
    """Return what the files are called: the columns, where some were asked for."""
    default = "-".join(request.columns) if request.columns else "table"
    seen = "-views" * (request.views is not None) + format_view_suffix(parse_views(request.sequence, request.filter))
    return request.name or default + seen


def choose_exit_code(results: Sequence[JobResult]) -> int:
    """Return 1 where a run failed that could have been made."""
    return int(any(result.code and not result.missing for result in results))

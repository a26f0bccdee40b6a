"""The table of a plan from stored runs; missing runs are made first."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vprbench.jobs.executors import choose_executor
from vprbench.jobs.job import JobResult
from vprbench.report.gather import make_report, resolve_plan
from vprbench.report.run_options import TableRequest
from vprbench.report.table import formats
from vprbench.report.table.cells import Report
from vprbench.runs import frame
from vprbench.runs.sequences import format_view_suffix, parse_views
from vprbench.runs.store import Store
from vprbench.storage.atomic import replace_text
from vprbench.terminal.console import make_console


def make_table(request: TableRequest, options: Sequence[str]) -> int:
    """Print the table and write it as Markdown, CSV and LaTeX; returns the exit code, 1 where a cell failed.

    Figures and page follow where the request has them. The runs of growth are made for the figures alone.
    """
    from vprbench.report.figures.make import print_figures  # takes long
    from vprbench.report.page.make import print_page

    plan = resolve_plan(request)
    with choose_executor(request) as executor:
        found = make_report(plan, options, executor, request.figures)
    is_narrow = make_console().is_terminal
    printed = formats.to_terminal(found, request.wide) if is_narrow else formats.to_markdown(found)
    print(printed, end="", flush=True)  # first: it is there to be read even where nothing is written
    name = file_name(request)
    written = write_table(found, Path(request.results).expanduser(), name)
    print(f"\nwritten to {', '.join(str(path) for path in written)}", flush=True)
    if request.figures:
        print_figures(found)
    if request.page:
        print_page(found, "report" if name == "table" else f"report-{name}")
    return choose_exit_code(found.job_results)


def write_table(found: Report, folder: Path, name: str) -> list[Path]:
    """Write the table in its three formats, and all numbers of the runs behind it; returns the files."""
    Store(folder).prepare()
    runs = [run for group in found.groups for run in group.runs]
    texts = {
        f"{name}.md": formats.to_markdown(found),
        f"{name}.csv": formats.to_csv(found),
        f"{name}.tex": formats.to_latex(found),
        f"{name}-runs.csv": frame.format_csv(runs, found.plan.metrics),
    }
    for file, text in texts.items():
        replace_text(folder / file, text)
    return [folder / file for file in texts]


def file_name(request: TableRequest) -> str:
    """Return what the files are called: the columns, where some were asked for."""
    default = "-".join(request.columns) if request.columns else "table"
    seen = "-views" * (request.views is not None) + format_view_suffix(parse_views(request.sequence, request.filter))
    return request.name or default + seen


def choose_exit_code(results: Sequence[JobResult]) -> int:
    """Return 1 where a run failed that could have been made."""
    return int(any(result.code and not result.missing for result in results))

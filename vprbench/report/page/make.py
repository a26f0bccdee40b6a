"""`make report`: one page with the table, the figures and a browser of failures, from stored runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from vprbench.jobs.executors import executor_for
from vprbench.progress import progress_shown
from vprbench.report.figures.make import draw_all, growth_columns, thumbnails_of
from vprbench.report.gather import ReportData, choose, gather
from vprbench.report.run_options import TableRequest
from vprbench.report.selection import Group, accuracy_series, series, title
from vprbench.report.table import formats
from vprbench.report.table.make import exit_code, file_name
from vprbench.runs.sequences import parse_views
from vprbench.runs.store import Store
from vprbench.runs.thumbnails import Thumbnails
from vprbench.runs.views import queries_shown
from vprbench.storage.atomic import replace_text
from vprbench.text import format_bytes

if TYPE_CHECKING:
    from vprbench.report.figures.style import Drawing


def make_report(request: TableRequest, options: Sequence[str]) -> int:
    """Write results/report.html; returns the exit code, 1 where a run failed.

    Runs of the table that are missing are made; those of the growth are drawn where they are stored.
    """
    with executor_for(request) as executor:
        found = gather(choose(request), options, executor)
    absent: list[str] = []
    drawings = draw_all(found, found.runs, growth_columns(found), absent.append)
    default = request.name is None and not request.columns and not parse_views(request.sequence, request.filter)
    default &= request.views is None
    name = "report.html" if default else f"report-{file_name(request)}.html"
    path = write_page(found, drawings, Path(request.results).expanduser() / name, absent)
    print(f"{path}: {format_bytes(path.stat().st_size)}, opens from disk")
    return exit_code(found.job_results)


def _frames_of(group: Group, found: ReportData) -> Thumbnails | None:
    """Return the frames that were kept of the queries that a group's runs show."""
    kept = thumbnails_of(group, found.chosen)
    if kept is None or group.runs[0].view is None:
        return kept
    shown = queries_shown(group.runs[0]).tolist()
    return replace(kept, **{name: tuple(getattr(kept, name)[i] for i in shown) for name in ("query_names", "queries")})


def write_page(
    found: ReportData, drawings: Iterable[tuple[str, Drawing]], path: Path, absent: Sequence[str] = ()
) -> Path:
    """Write the page of a table, titled as the table if that is not the paper's, with these figures; returns `path`.

    `absent` says of each figure that is not drawn why.
    """
    from vprbench.report.figures.style import render_png
    from vprbench.report.page.page import TITLE, Picture, Section, page

    with progress_shown("report"):
        pictures = [Picture(name, drawing.caption, render_png(drawing)) for name, drawing in drawings]
    rows = found.chosen.rows
    groups = [(title(group, found.groups), group) for group in found.groups if group.runs]
    sections = [
        Section(heading, tuple(accuracy_series(group, rows)), _frames_of(group, found)) for heading, group in groups
    ]
    measured = [
        (heading, one) for heading, group in groups for one in (*series(group, rows), *series(group, rows, "cuda"))
    ]
    runs = [run for _, one in measured for run in one.runs]
    newest = max(str(run.environment.get("time_utc", ""))[:10] for run in runs)
    made_from = f"Made from {len(runs)} stored run{'s' * (len(runs) != 1)}, the newest of {newest}."
    heading = found.table.title or TITLE
    with progress_shown("report"):
        text = page(formats.to_html(found.table), pictures, sections, heading, made_from, measured, absent)
    Store(path.parent).prepare()
    replace_text(path, text)
    return path

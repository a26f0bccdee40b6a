"""The page of a report: the table, the figures and a browser of failures, from stored runs."""

from __future__ import annotations

from dataclasses import replace

from vprbench.report.figures.make import find_thumbnails
from vprbench.report.figures.style import render_png
from vprbench.report.page.page import TITLE, Picture, Section, render_page
from vprbench.report.report import Report
from vprbench.report.selection import DEVICES, DatasetRuns, list_method_runs
from vprbench.report.table import formats
from vprbench.runs.thumbnails import Thumbnails
from vprbench.runs.views import list_shown_queries
from vprbench.text import format_count


def make_page(found: Report) -> str:
    """Return the page of a report, which has the title of the table if that is its own."""
    rows, groups = found.plan.rows, [group for group in found.groups if group.runs]
    sections = [
        Section(group.title, tuple(list_method_runs(group, rows)), _load_frames(group, found)) for group in groups
    ]
    measured = [
        (group.title, one) for group in groups for device in DEVICES for one in list_method_runs(group, rows, device)
    ]
    times = [str(run.environment.get("time_utc", "")) for _, one in measured for run in one.runs]
    made_from = f"Made from {format_count(len(times), 'stored run')}, the newest of {max(times)[:10]}."
    pictures = [Picture(name, drawing.caption, render_png(drawing)) for name, drawing in found.drawings.items()]
    title = found.plan.title or TITLE
    return render_page(formats.to_html(found), pictures, sections, title, made_from, measured, found.absent)


def _load_frames(group: DatasetRuns, found: Report) -> Thumbnails | None:
    """Return the frames that were kept of the queries that a group's runs show."""
    kept = find_thumbnails(found, group)
    if kept is None or group.runs[0].view is None:
        return kept
    shown = list_shown_queries(group.runs[0]).tolist()
    return replace(kept, **{name: tuple(getattr(kept, name)[i] for i in shown) for name in ("query_names", "queries")})

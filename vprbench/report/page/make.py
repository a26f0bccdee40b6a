"""The page of a report: the table, the figures and a browser of failures, from stored runs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from vprbench.progress import show_progress
from vprbench.report.figures.make import draw_all, find_thumbnails
from vprbench.report.figures.style import Drawing, render_png
from vprbench.report.page.page import TITLE, Picture, Section, page
from vprbench.report.selection import DEVICES, DatasetRuns, list_method_runs
from vprbench.report.table import formats
from vprbench.report.table.cells import Report
from vprbench.runs.store import Store
from vprbench.runs.thumbnails import Thumbnails
from vprbench.runs.views import list_shown_queries
from vprbench.storage.atomic import replace_text
from vprbench.text import format_bytes, format_count


def print_page(found: Report, name: str) -> None:
    """Write the page of a report, NAME.html, into its results folder, and print the file."""
    absent: list[str] = []
    path = Path(found.plan.results).expanduser() / f"{name}.html"
    write_page(found, draw_all(found, absent.append), path, absent)
    print(f"{path}: {format_bytes(path.stat().st_size)}, opens from disk")


def write_page(found: Report, drawings: Iterable[tuple[str, Drawing]], path: Path, absent: Sequence[str] = ()) -> Path:
    """Write the page of a table with these figures; returns `path`.

    The page has the title of the table, if that is its own. `absent` says of each figure that is not drawn why.
    """
    rows, groups = found.plan.rows, [group for group in found.groups if group.runs]
    sections = [
        Section(group.title, tuple(list_method_runs(group, rows)), _load_frames(group, found)) for group in groups
    ]
    measured = [
        (group.title, one) for group in groups for device in DEVICES for one in list_method_runs(group, rows, device)
    ]
    times = [str(run.environment.get("time_utc", "")) for _, one in measured for run in one.runs]
    made_from = f"Made from {format_count(len(times), 'stored run')}, the newest of {max(times)[:10]}."
    with show_progress("report"):
        pictures = [Picture(name, drawing.caption, render_png(drawing)) for name, drawing in drawings]
        title = found.plan.title or TITLE
        text = page(formats.to_html(found), pictures, sections, title, made_from, measured, absent)
    Store(path.parent).prepare()
    replace_text(path, text)
    return path


def _load_frames(group: DatasetRuns, found: Report) -> Thumbnails | None:
    """Return the frames that were kept of the queries that a group's runs show."""
    kept = find_thumbnails(found, group)
    if kept is None or group.runs[0].view is None:
        return kept
    shown = list_shown_queries(group.runs[0]).tolist()
    return replace(kept, **{name: tuple(getattr(kept, name)[i] for i in shown) for name in ("query_names", "queries")})

"""`make report`: one page with the table, the figures and a browser of failures, from stored runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vprbench.paper.figures.make import draw_all, growth_columns, thumbnails_of
from vprbench.paper.gather import TableRequest, gather
from vprbench.paper.selection import accuracy_series, series, title
from vprbench.paper.shelf import Compose
from vprbench.paper.table import formats
from vprbench.paper.table.make import exit_code, file_name
from vprbench.progress import progress_shown
from vprbench.run.store import Store
from vprbench.storage.atomic import replace_text


def make_report(asked: TableRequest, options: Sequence[str], compose: Compose) -> int:
    """Write results/report.html; returns the exit code, 1 where a run failed.

    Runs of the table that are missing are made; those of the growth are drawn where they are stored.
    """
    from vprbench.paper.figures.style import png
    from vprbench.paper.page.page import Picture, Section, page

    found = gather(asked, options, compose)
    absent: list[str] = []
    drawings = draw_all(found, found.runs, growth_columns(found, compose), asked, absent.append)
    with progress_shown("report"):
        pictures = [Picture(name, drawn.caption, png(drawn)) for name, drawn in drawings]
    rows = found.chosen.rows
    groups = [(title(group, found.groups), group) for group in found.groups if group.runs]
    sections = [
        Section(heading, tuple(accuracy_series(group, rows)), thumbnails_of(group, asked)) for heading, group in groups
    ]
    measured = [
        (heading, one) for heading, group in groups for one in (*series(group, rows), *series(group, rows, "cuda"))
    ]
    runs = [run for _, one in measured for run in one.runs]
    newest = max(str(run.environment.get("time_utc", ""))[:10] for run in runs)
    made_from = f"Made from {len(runs)} stored run{'s' * (len(runs) != 1)}, the newest of {newest}."
    with progress_shown("report"):
        text = page(
            formats.html(found.table), pictures, sections, made_from=made_from, measured=measured, absent=absent
        )
    folder = Path(asked.results).expanduser()
    Store(folder).prepare()
    default = asked.name is None and not asked.columns
    path = folder / ("report.html" if default else f"report-{file_name(asked)}.html")
    replace_text(path, text)
    print(f"{path}: {len(text.encode()) / 1e6:.1f} MB, opens from disk")
    return exit_code(found.endings)

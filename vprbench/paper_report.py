"""`make report`: one page with the table, the figures and a browser of failures, from stored runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vprbench import table_formats
from vprbench.belonging import series, title
from vprbench.paper import Asked, Compose, gather
from vprbench.paper_figures import draw_all, growth_columns, thumbnails_of
from vprbench.paper_table import exit_code, file_name
from vprbench.records import Store
from vprbench.replacing import replace_text


def make_report(asked: Asked, options: Sequence[str], compose: Compose) -> int:
    """Write results/report.html; returns the exit code, 1 where a run failed.

    Runs of the table that are missing are made; those of the growth are drawn where they are stored.
    """
    from vprbench.figures.style import png
    from vprbench.report.page import Picture, Section, page

    found = gather(asked, options, compose)
    columns = growth_columns(found, compose)
    pictures = [Picture(name, drawn.caption, png(drawn)) for name, drawn in draw_all(found, found.runs, columns, asked)]
    sections = [
        Section(title(group, found.groups), tuple(series(group, found.chosen.rows)), thumbnails_of(group, asked))
        for group in found.groups
        if group.runs
    ]
    shown = [run for group in found.groups for run in group.runs]
    newest = max((str(run.environment.get("time_utc", ""))[:10] for run in shown), default="")
    made_from = f"Made from {len(shown)} stored runs, the newest of {newest}."
    text = page(table_formats.html(found.table), pictures, sections, made_from=made_from)
    folder = Path(asked.results).expanduser()
    Store(folder).prepare()
    name = file_name(asked).replace("table", "report") if not asked.columns else f"report-{file_name(asked)}"
    path = folder / f"{name}.html"
    replace_text(path, text)
    print(f"{path}: {len(text.encode()) / 1e6:.1f} MB, opens from disk")
    return exit_code(found)

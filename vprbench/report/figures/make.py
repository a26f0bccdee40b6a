"""Every figure of a report, drawn from its runs and written as PDF and PNG with captions."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from vprbench import progress
from vprbench.errors import BadInput
from vprbench.metrics.catalogue import METRICS
from vprbench.report.figures import accuracy, growth, pictures, speed, spikes, style, tradeoff
from vprbench.report.figures.style import Drawing
from vprbench.report.missing_runs import resolve_results_folder
from vprbench.report.report import Report
from vprbench.report.selection import DatasetRuns, MethodRuns, group_runs_by_column, list_method_runs
from vprbench.report.table.best import average_recall
from vprbench.report.table.formats import escape_markdown
from vprbench.runs.thumbnails import Thumbnails, load_thumbnails
from vprbench.storage.atomic import remove_leftovers, replace_bytes, replace_text

logger = logging.getLogger(__name__)

FigureCall = tuple[Any, ...]  # the name of the files, the function that draws, and its arguments


def write_figures(drawings: Mapping[str, Drawing], folder: Path) -> Iterator[Path]:
    """Write figures as PDF and PNG into a folder, and at last their captions; yields each PDF, then the captions."""
    folder.mkdir(parents=True, exist_ok=True)
    remove_leftovers(folder)
    captions = ["# Captions\n"]
    for name, drawing in drawings.items():
        replace_bytes(folder / f"{name}.png", style.render_png(drawing))
        replace_bytes(folder / f"{name}.pdf", style.render_pdf(drawing))
        captions.append(f"**{escape_markdown(name)}.** {escape_markdown(drawing.caption)}\n")
        yield folder / f"{name}.pdf"
    replace_text(folder / "captions.md", "\n".join(captions))
    yield folder / "captions.md"


def draw_all(found: Report, report: Callable[[str], None] = logger.info) -> Iterator[tuple[str, Drawing]]:
    """Yield each figure with the name of its files; `report` gets a line for each that has nothing to show.

    Names of figures begin with their published numbers, unless the table has a title of its own.
    """
    plan = found.plan
    shown = [(group, rows) for group in found.groups if (rows := list_method_runs(group, plan.rows))]
    calls = [
        *_list_speed(found),
        *_list_growth(found),
        *(call for group, rows in shown for call in _list_by_group(found, group, rows)),
        *_list_sequences(shown),
    ]
    for number, (kind, draw, *given) in enumerate(calls):
        progress.report("drawing figures", number / len(calls))
        name = plan.published.number_figure(kind) if plan.published else kind
        try:
            yield name, draw(*given)
        except BadInput as error:
            report(f"{name} is not drawn: {error}")


def _list_growth(found: Report) -> Iterator[FigureCall]:
    """Yield time against places, of each row of the growth that has runs; nothing without its columns."""
    plan, rows = found.plan, list[MethodRuns]()
    if not plan.growth_columns:
        return
    for row in plan.growth_rows:
        groups = group_runs_by_column(found.runs, (), plan.growth_columns, [row])
        sizes = [run for group in groups for one in list_method_runs(group, [row], "cpu") for run in one.runs]
        rows += [MethodRuns(row.name, tuple(sizes))] if sizes else []
    yield "growth", growth.draw_growth, rows, plan.published.growth_claim if plan.published else ""


def _list_speed(found: Report) -> Iterator[FigureCall]:
    """Yield training time and query rate of the first group that was timed."""
    group = max(found.groups, key=lambda group: (any(run.timing for run in group.runs), len(group.runs) > 0))
    rows, published = found.plan.rows, found.plan.published
    series = [*list_method_runs(group, rows, "cpu"), *list_method_runs(group, rows, "cuda")]
    yield "training-time", speed.draw_training_time, series, rows, group.column, published
    yield "query-rate", speed.draw_query_rate, series, rows, group.column, published


def _list_by_group(found: Report, group: DatasetRuns, shown: Sequence[MethodRuns]) -> Iterator[FigureCall]:
    """Yield the figures of a group; without ground truth of spikes alone."""
    plan, name, runs = found.plan, group.name, [run for row in shown for run in row.runs]
    if runs[0].is_judged:
        if thumbnails := find_thumbnails(found, group):
            yield f"frames-{name}", pictures.draw_frames, thumbnails, group.title
        wanted = plan.published.shown_row if plan.published else None
        best = max(shown, key=lambda row: (row.name == wanted, average_recall(row.runs) or 0.0))
        yield f"similarity-{name}", pictures.draw_similarity, best.runs[0], best.name
        yield f"precision-recall-{name}", accuracy.draw_precision_recall, shown
        yield f"recall-at-n-{name}", accuracy.draw_recall_at_n, shown
        yield f"tolerance-{name}", accuracy.draw_recall_at_tolerance, shown
        for metric in plan.metrics:
            yield f"{metric.replace('_', '-')}-{name}", accuracy.draw_metric, shown, METRICS[metric]
        timed = list_method_runs(group, plan.rows, "cpu")
        yield f"rate-{name}", tradeoff.draw_rate_tradeoff, timed
        yield f"memory-{name}", tradeoff.draw_memory_tradeoff, timed
        if any(run.stream for run in runs):
            yield f"growing-map-{name}", growth.draw_growing_map, shown
    yield f"spikes-{name}", spikes.draw_spikes, shown
    if any(map(spikes.has_spike_times, runs)):
        yield f"raster-{name}", spikes.draw_raster, shown


def _list_sequences(shown: Sequence[tuple[DatasetRuns, list[MethodRuns]]]) -> Iterator[FigureCall]:
    """Yield recall over the length of sequences for each column that is seen in several."""
    columns: dict[str, list[list[MethodRuns]]] = {}
    for group, rows in shown:
        if rows[0].runs[0].is_judged and "sequence" in rows[0].runs[0].protocol:
            columns.setdefault(group.column.name, []).append(rows)
    for name, views in columns.items():
        if len(views) > 1:
            yield f"sequences-{name}", accuracy.draw_recall_at_length, views


def find_thumbnails(found: Report, group: DatasetRuns) -> Thumbnails | None:
    """Return the frames that were kept of the dataset of a group with runs, from the first store that has them."""
    stores = map(resolve_results_folder, (found.plan.results, *found.plan.stores))
    return next(filter(None, (load_thumbnails(store, group.runs[0].fingerprint) for store in stores)), None)

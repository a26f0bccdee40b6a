"""Every figure of a report, drawn from its runs and written as PDF and PNG with captions."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from vprbench import progress
from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.jobs.executors import Executor
from vprbench.jobs.job import JobResult
from vprbench.metrics.catalogue import METRICS
from vprbench.report.figures import accuracy, growth, pictures, speed, spikes, style, tradeoff
from vprbench.report.figures.style import Drawing
from vprbench.report.gather import Plan, Report, list_cells, run_missing
from vprbench.report.growth import collect_growth_samples
from vprbench.report.missing_runs import resolve_results_folder
from vprbench.report.plan import Row
from vprbench.report.selection import (
    DatasetRuns,
    MethodRuns,
    ResolvedColumn,
    format_title,
    group_runs_by_column,
    list_accuracy_runs,
    list_method_runs,
)
from vprbench.report.table.best import average_recall
from vprbench.report.table.formats import escape_markdown
from vprbench.runs.thumbnails import Thumbnails, load_thumbnails
from vprbench.storage.atomic import remove_leftovers, replace_bytes, replace_text

logger = logging.getLogger(__name__)

FigureCall = tuple[Any, ...]  # the name of the files, the function that draws, and its arguments


def print_figures(found: Report, columns: Sequence[ResolvedColumn] = ()) -> None:
    """Draw all figures of a report, those of growth over `columns`, under its results folder, and print the files."""
    folder = Path(found.chosen.results).expanduser() / "figures"
    for path in write_figures(draw_all(found, columns), folder):
        print(f"{path} and .png" if path.suffix == ".pdf" else f"what each shows: {path}")


def write_figures(drawings: Iterable[tuple[str, Drawing]], folder: Path) -> Iterator[Path]:
    """Write figures as PDF and PNG into a folder, and at last their captions; yields each PDF, then the captions."""
    folder.mkdir(parents=True, exist_ok=True)
    remove_leftovers(folder)
    captions = ["# Captions\n"]
    for name, drawing in drawings:
        replace_bytes(folder / f"{name}.png", style.render_png(drawing))
        replace_bytes(folder / f"{name}.pdf", style.render_pdf(drawing))
        captions.append(f"**{escape_markdown(name)}.** {escape_markdown(drawing.caption)}\n")
        yield folder / f"{name}.pdf"
    replace_text(folder / "captions.md", "\n".join(captions))
    yield folder / "captions.md"


def draw_all(
    found: Report, columns: Sequence[ResolvedColumn] = (), report: Callable[[str], None] = logger.info
) -> Iterator[tuple[str, Drawing]]:
    """Yield each figure with the name of its files; `report` gets a line for each that has nothing to show.

    Growth is drawn in `columns`. Names of figures begin with their published numbers, unless the table has
    a title of its own.
    """
    shown = [(group, rows) for group in found.groups if (rows := list_accuracy_runs(group, found.chosen.rows))]
    calls = [
        *_list_speed(found),
        *_list_growth(found, columns),
        *(call for group, rows in shown for call in _list_by_group(found, group, rows)),
        *_list_sequences(shown),
    ]
    published = found.chosen.plan.published if found.table.title is None else None
    for number, (kind, draw, *given) in enumerate(calls):
        progress.report("drawing figures", number / len(calls))
        name = published.number_figure(kind) if published else kind
        try:
            yield name, draw(*given)
        except BadInput as error:
            report(f"{name} is not drawn: {error}")


def list_growth_columns(found: Report) -> list[ResolvedColumn]:
    """Return a column for each size of the growth."""
    planned = map(found.chosen.plan.growth.column, found.chosen.plan.growth.sizes)
    return [ResolvedColumn(column, make_request(column.options).dataset) for column in planned]


def run_growth(
    found: Report, columns: Sequence[ResolvedColumn], options: Sequence[str], executor: Executor
) -> list[JobResult]:
    """Make the runs of growth that are not stored, one after the other; `options` of the command line hold for all.

    Their frames are not kept.
    """
    once, rows = replace(found.chosen, devices=("cpu",)), _choose_growth_rows(found)
    cells = [cell for column in columns for cell in list_cells(once, column, rows, [*options, "frames=false"])]
    return run_missing(found.chosen, cells, executor)


def _choose_growth_rows(found: Report) -> list[Row]:
    """Return the rows whose growth is drawn, with their first seed."""
    plan = found.chosen.plan
    return [replace(plan.rows[name], seeds=plan.rows[name].seeds[:1]) for name in plan.growth.rows]


def _list_growth(found: Report, columns: Sequence[ResolvedColumn]) -> Iterator[FigureCall]:
    """Yield time against places, of each row of the growth that has runs; nothing without columns."""
    grown = []
    for row in _choose_growth_rows(found) if columns else ():
        groups = group_runs_by_column(found.runs, (), columns, [row])
        if of_sizes := [run for group in groups for one in list_method_runs(group, [row]) for run in one.runs]:
            grown.append(collect_growth_samples(row, of_sizes))
    if columns:
        published = found.chosen.plan.published
        yield "growth", growth.draw_growth, grown, published.growth_claim if published else ""


def _list_speed(found: Report) -> Iterator[FigureCall]:
    """Yield training time and query rate of the first group that was timed."""
    group = max(found.groups, key=lambda group: (any(run.timing for run in group.runs), len(group.runs) > 0))
    rows, plan = found.chosen.rows, found.chosen.plan
    series = [*list_method_runs(group, rows), *list_method_runs(group, rows, "cuda")]
    yield "training-time", speed.draw_training_time, series, rows, group.column.planned, plan.published
    yield "query-rate", speed.draw_query_rate, series, rows, group.column.planned, plan.published


def _list_by_group(found: Report, group: DatasetRuns, shown: Sequence[MethodRuns]) -> Iterator[FigureCall]:
    """Yield the figures of a group; without ground truth of spikes alone."""
    name, runs = group.name, [run for row in shown for run in row.runs]
    if runs[0].is_judged:
        if thumbnails := thumbnails_of(group, found.chosen):
            yield f"frames-{name}", pictures.draw_frames, thumbnails, format_title(group, found.groups)
        published = found.chosen.plan.published
        wanted = published.shown_row if published else None
        best = max(shown, key=lambda row: (row.name == wanted, average_recall(row.runs) or 0.0))
        yield f"similarity-{name}", pictures.draw_similarity, best.runs[0], best.name
        yield f"precision-recall-{name}", accuracy.draw_precision_recall, shown
        yield f"recall-at-n-{name}", accuracy.draw_recall_at_n, shown
        yield f"tolerance-{name}", accuracy.draw_recall_at_tolerance, shown
        for metric in found.chosen.metrics:
            yield f"{metric.replace('_', '-')}-{name}", accuracy.draw_metric, shown, METRICS[metric]
        timed = list_method_runs(group, found.chosen.rows)
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
            columns.setdefault(group.column.planned.name, []).append(rows)
    for name, views in columns.items():
        if len(views) > 1:
            yield f"sequences-{name}", accuracy.draw_recall_at_length, views


def thumbnails_of(group: DatasetRuns, chosen: Plan) -> Thumbnails | None:
    """Return the frames that were kept of the dataset of a group with runs, from the first store that has them."""
    stores = map(resolve_results_folder, (chosen.results, *chosen.stores))
    return next(filter(None, (load_thumbnails(store, group.runs[0].fingerprint) for store in stores)), None)

"""Every figure of a report, drawn from its runs and written as PDF and PNG with captions."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from vprbench import progress
from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.jobs.executors import Executor
from vprbench.jobs.job import JobResult
from vprbench.metrics.catalogue import METRICS
from vprbench.report.gather import ReportData, TablePlan, run_missing, runs_of
from vprbench.report.growth import GrowthSamples, samples
from vprbench.report.missing_runs import results_folder
from vprbench.report.plan import Row
from vprbench.report.selection import Group, ResolvedColumn, Series, accuracy_series, groups, of_row, series, title
from vprbench.report.table.best import average_recall
from vprbench.report.table.formats import escape_markdown
from vprbench.runs.frame import iterate_rows
from vprbench.runs.record import Run
from vprbench.runs.thumbnails import Thumbnails, load_thumbnails
from vprbench.storage.atomic import remove_leftovers, replace_text

if TYPE_CHECKING:
    from vprbench.report.figures.style import Drawing

logger = logging.getLogger(__name__)

FigureCall = tuple[Any, ...]  # the name of the files, the function that draws, and its arguments


def print_figures(found: ReportData, growth: Sequence[ResolvedColumn] = ()) -> None:
    """Draw all figures of a report under its results folder, and print the files."""
    folder = Path(found.chosen.results).expanduser() / "figures"
    for path in write_figures(draw_all(found, found.runs, growth), folder):
        print(f"{path} and .png" if path.suffix == ".pdf" else f"what each shows: {path}")


def run_growth(
    found: ReportData, growth: Sequence[ResolvedColumn], options: Sequence[str], executor: Executor
) -> list[JobResult]:
    """Make the runs of Figure 2c that are not stored, one after the other; `options` of the command line hold for all.

    Their frames are not kept.
    """
    once = replace(found.chosen, devices=("cpu",))
    cells = [
        cell for column in growth for cell in runs_of(once, column, _rows_of_growth(found), [*options, "frames=false"])
    ]
    return run_missing(found.chosen, cells, executor)


def write_figures(drawings: Iterable[tuple[str, Drawing]], folder: Path) -> Iterator[Path]:
    """Write figures as PDF and PNG into a folder, and at last their captions; yields each PDF, then the captions."""
    from vprbench.report.figures.style import write_figure

    folder.mkdir(parents=True, exist_ok=True)
    remove_leftovers(folder)
    captions: list[tuple[str, str]] = []
    for name, drawing in drawings:
        captions.append((name, drawing.caption))
        yield write_figure(drawing, folder, name)[0]
    replace_text(folder / "captions.md", list_captions(captions))
    yield folder / "captions.md"


def list_captions(captions: Iterable[tuple[str, str]]) -> str:
    """Return the captions of figures, by their names, as Markdown; what is in them is shown as it is."""
    lines = (f"**{escape_markdown(name)}.** {escape_markdown(caption)}\n" for name, caption in captions)
    return "\n".join(["# Captions\n", *lines])


def draw_all(
    found: ReportData,
    runs: Sequence[Run],
    growth: Sequence[ResolvedColumn] = (),
    report: Callable[[str], None] = logger.info,
) -> Iterator[tuple[str, Drawing]]:
    """Yield each figure with the name of its files; `report` gets a line for each that has nothing to show.

    Without `growth` none is drawn. Names hold the paper's numbers of figures if the table is Table II.
    """
    calls = [*_list_speed(found, runs, growth), *_list_by_dataset(found)]
    for number, (numbered, draw, *given) in enumerate(calls):
        progress.report("drawing figures", number / len(calls))
        name = numbered if found.table.title is None else re.sub(r"^fig\d\w-", "", numbered)
        try:
            yield name, draw(*given)
        except BadInput as error:
            report(f"{name} is not drawn: {error}")


def thumbnails_of(group: Group, chosen: TablePlan) -> Thumbnails | None:
    """Return the frames that were kept of a group's dataset, from the first store that has them."""
    for folder in (chosen.results, *chosen.stores):
        kept = load_thumbnails(results_folder(folder), group.runs[0].fingerprint) if group.runs else None
        if kept is not None:
            return kept
    return None


def growth_columns(found: ReportData) -> list[ResolvedColumn]:
    """Return a column for each size of the growth."""
    planned = map(found.chosen.plan.growth.column, found.chosen.plan.growth.sizes)
    return [ResolvedColumn(column, make_request(column.options).dataset) for column in planned]


def _rows_of_growth(found: ReportData) -> list[Row]:
    """Return the rows whose growth is drawn, with their first seed."""
    plan = found.chosen.plan
    return [replace(plan.rows[name], seeds=plan.rows[name].seeds[:1]) for name in plan.growth.rows]


def _collect_growth(found: ReportData, runs: Sequence[Run], growth: Sequence[ResolvedColumn]) -> list[GrowthSamples]:
    """Return the samples of each row of the growth that has runs."""
    rows = _rows_of_growth(found)
    stored_runs = (
        [run for group in groups(runs, (), growth, [row]) for run in of_row(group, row, "cpu").runs] for row in rows
    )
    return [samples(row, there) for row, there in zip(rows, stored_runs, strict=True) if there]


def _list_speed(found: ReportData, runs: Sequence[Run], growth: Sequence[ResolvedColumn]) -> Iterator[FigureCall]:
    """Yield Figure 2: training time, query rate, and both against the number of places."""
    from vprbench.report.figures.growth import draw_growth
    from vprbench.report.figures.speed import draw_query_rate, draw_training_time

    there = [group for group in found.groups if group.runs]
    group = next((group for group in there if any(run.timing for run in group.runs)), there[0] if there else None)
    if group is not None:
        rows, cells = found.chosen.rows, found.table.cells[found.table.cells["column"] == group.name]
        marks = {(cell.row, cell.quantity): cell.mark for cell in iterate_rows(cells)}
        given = series(group, rows), series(group, rows, "cuda"), rows, group.column.planned, marks
        yield "fig2a-training-time", draw_training_time, *given
        yield "fig2b-query-rate", draw_query_rate, *given
    if growth:
        yield "fig2c-growth", draw_growth, _collect_growth(found, runs, growth)


def _list_by_dataset(found: ReportData) -> Iterator[FigureCall]:
    """Yield the figures that each dataset has: Figure 3, and those beyond the paper; without ground truth few."""
    from vprbench.report.figures import accuracy, spikes

    sequences: dict[str, list[list[Series]]] = {}
    for group in found.groups:
        shown = accuracy_series(group, found.chosen.rows)
        if not shown:
            continue
        if shown[0].runs[0].is_judged:
            yield from _list_accuracy(found, group, shown)
            if "sequence" in shown[0].runs[0].protocol:
                sequences.setdefault(group.column.planned.name, []).append(shown)
        yield f"spikes-{group.name}", spikes.draw_spikes, shown
        if timed := spikes.select_spike_times(shown):
            yield f"raster-{group.name}", spikes.draw_raster, timed
    for name, views in sequences.items():
        if len(views) > 1:
            yield f"sequences-{name}", accuracy.draw_recall_at_length, views


def _list_accuracy(found: ReportData, group: Group, shown: Sequence[Series]) -> Iterator[FigureCall]:
    """Yield the figures of a group that need to know which places are right."""
    from vprbench.report.figures import accuracy, growth, pictures, tradeoff

    name, timed, thumbnails = group.name, series(group, found.chosen.rows), thumbnails_of(group, found.chosen)
    if thumbnails is not None:
        yield f"fig3a-frames-{name}", pictures.draw_frames, thumbnails, title(group, found.groups)
    papers = [row for row in shown if row.name in found.chosen.plan.rows]
    best = max(shown, key=lambda row: average_recall(row.runs) or 0.0)
    row = papers[-1] if papers else best  # VPRTempo, as in the paper, where it has runs
    if row.runs[0].view is None or row.runs[0].scores is not None:  # of several views none keeps its scores
        yield f"fig3b-similarity-{name}", pictures.draw_similarity, row.runs[0], row.name
    yield f"fig3c-precision-recall-{name}", accuracy.draw_precision_recall, shown
    yield f"fig3d-recall-at-n-{name}", accuracy.draw_recall_at_n, shown
    yield f"tolerance-{name}", accuracy.draw_recall_at_tolerance, shown
    for metric in found.chosen.metrics:
        yield f"{metric.replace('_', '-')}-{name}", accuracy.draw_metric, shown, METRICS[metric]
    yield f"rate-{name}", tradeoff.draw_rate_tradeoff, timed
    yield f"memory-{name}", tradeoff.draw_memory_tradeoff, timed
    if any(run.stream for row in shown for run in row.runs):
        yield f"growing-map-{name}", growth.draw_growing_map, shown

"""`make figures`: every figure of the paper and some beyond it, from stored runs, those that are missing made first."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from vprbench import progress
from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.jobs.executors import executor_for
from vprbench.metrics.registry import METRICS
from vprbench.paper.gather import ReportData, TablePlan, choose, gather, run_missing, runs_of, stored
from vprbench.paper.growth import GrowthSamples, samples
from vprbench.paper.missing_runs import results_folder
from vprbench.paper.plan import Row
from vprbench.paper.run_options import TableRequest
from vprbench.paper.selection import Group, ResolvedColumn, Series, accuracy_series, groups, of_row, series, title
from vprbench.paper.table.best import average_recall
from vprbench.paper.table.formats import escape_markdown
from vprbench.paper.table.make import exit_code
from vprbench.runs.frame import iterate_rows
from vprbench.runs.record import Run
from vprbench.runs.thumbnails import Thumbnails, load_thumbnails
from vprbench.storage.atomic import remove_leftovers, replace_text

if TYPE_CHECKING:
    from vprbench.paper.figures.style import Drawn

logger = logging.getLogger(__name__)


def make_figures(request: TableRequest, options: Sequence[str]) -> int:
    """Draw all figures as PDF and PNG under results/figures; returns the exit code, 1 where a run failed."""
    with executor_for(request) as executor:
        found = gather(choose(request), options, executor)
        growth = growth_columns(found)
        once = replace(found.chosen, devices=("cpu",))
        options = [*options, "frames=false"]  # nobody looks at theirs
        sizes = [cell for column in growth for cell in runs_of(once, column, _growing(found), options)]
        results = run_missing(found.chosen, sizes, executor)
    runs = stored(found.chosen)[0] if sizes else found.runs
    folder = Path(request.results).expanduser() / "figures"
    for path in write_figures(draw_all(found, runs, growth), folder):
        print(f"{path} and .png" if path.suffix == ".pdf" else f"what each shows: {path}")
    return exit_code([*found.job_results, *results])


def write_figures(drawings: Iterable[tuple[str, Drawn]], folder: Path) -> Iterator[Path]:
    """Write figures as PDF and PNG into a folder, and at last their captions; yields each PDF, then the captions."""
    from vprbench.paper.figures.style import write

    folder.mkdir(parents=True, exist_ok=True)
    remove_leftovers(folder)
    captions: list[tuple[str, str]] = []
    for name, drawn in drawings:
        captions.append((name, drawn.caption))
        yield write(drawn, folder, name)[0]
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
) -> Iterator[tuple[str, Drawn]]:
    """Yield each figure with the name of its files; `report` is told which have nothing to show, and why.

    Without `growth` none is drawn. Names hold the paper's numbers of figures if the table is Table II.
    """
    every = [*_speed(found, runs, growth), *_of_columns(found)]
    for number, (numbered, draw) in enumerate(every):
        progress.report("drawing figures", number / len(every))
        name = numbered if found.table.title is None else re.sub(r"^fig\d\w-", "", numbered)
        try:
            yield name, draw()
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


Draw = Callable[[], "Drawn"]


def _speed(found: ReportData, runs: Sequence[Run], growth: Sequence[ResolvedColumn]) -> Iterator[tuple[str, Draw]]:
    """Yield Figure 2: training time, query rate, and both against the number of places."""
    from vprbench.paper.figures import growth as growing
    from vprbench.paper.figures import speed

    group = next((group for group in found.groups if group.runs), None)
    if group is not None:
        rows = found.chosen.rows
        parts = series(group, rows), series(group, rows, "cuda"), rows, group.column.planned, _marks(found, group)
        yield "fig2a-training-time", partial(speed.training_time, *parts)
        yield "fig2b-query-rate", partial(speed.query_rate, *parts)
    if growth:
        yield "fig2c-growth", lambda: growing.growth(_growth(found, runs, growth))


def _growth(found: ReportData, runs: Sequence[Run], growth: Sequence[ResolvedColumn]) -> list[GrowthSamples]:
    """Return the samples of each row of the growth that has runs; raises BadInput if none has."""
    chosen = []
    for row in _growing(found):
        there = [run for group in groups(runs, (), growth, [row]) for run in of_row(group, row, "cpu").runs]
        if there:
            chosen.append(samples(row, there))
    if not chosen:
        raise BadInput("no run at other numbers of places is stored: make figures makes them")
    return chosen


def _marks(found: ReportData, group: Group) -> dict[tuple[str, str], str]:
    """Return the table's word for each cell of a group, by row and quantity."""
    cells = found.table.cells[found.table.cells["column"] == group.name]
    return {(cell.row, cell.quantity): cell.mark for cell in iterate_rows(cells)}


def _growing(found: ReportData) -> list[Row]:
    """Return the rows whose growth is drawn, with their first seed."""
    plan = found.chosen.plan
    return [replace(plan.rows[name], seeds=plan.rows[name].seeds[:1]) for name in plan.growth.rows]


def _of_columns(found: ReportData) -> Iterator[tuple[str, Draw]]:
    """Yield the figures that each dataset has: Figure 3, and those beyond the paper; without ground truth few."""
    from vprbench.paper.figures import accuracy, spikes

    for group in found.groups:
        shown = accuracy_series(group, found.chosen.rows)
        if not shown:
            continue
        name = group.name
        if shown[0].runs[0].is_judged:
            yield from _of_accuracy(found, group, shown)
        yield f"spikes-{name}", partial(spikes.spike_statistics, shown)
        if in_time := spikes.in_time(shown):
            yield f"raster-{name}", partial(spikes.raster, in_time)
    for column in found.chosen.columns:
        groups_of = [g for g in found.groups if g.column is column and g.runs and g.runs[0].is_judged]
        lengths = [accuracy_series(g, found.chosen.rows) for g in groups_of if "sequence" in g.runs[0].protocol]
        if len(lengths) > 1:
            yield f"sequences-{column.planned.name}", partial(accuracy.recall_at_length, lengths)


def _of_accuracy(found: ReportData, group: Group, shown: Sequence[Series]) -> Iterator[tuple[str, Draw]]:
    """Yield the figures of a group that need to know which places are right."""
    from vprbench.paper.figures import accuracy, growth, pictures, tradeoff

    timed = series(group, found.chosen.rows)
    name = group.name
    thumbnails = thumbnails_of(group, found.chosen)
    if thumbnails is not None:
        yield f"fig3a-frames-{name}", partial(pictures.frames, thumbnails, title(group, found.groups))
    papers = [one for one in shown if one.name in found.chosen.plan.rows]
    best = max(shown, key=lambda one: average_recall(one.runs) or 0.0)
    one = papers[-1] if papers else best  # VPRTempo, as in the paper, where it has runs
    if one.runs[0].view is None or one.runs[0].scores is not None:  # of several views none keeps its scores
        yield f"fig3b-similarity-{name}", partial(pictures.similarity, one.runs[0], one.name)
    yield f"fig3c-precision-recall-{name}", partial(accuracy.precision_recall, shown)
    yield f"fig3d-recall-at-n-{name}", partial(accuracy.recall_at_n, shown)
    yield f"tolerance-{name}", partial(accuracy.recall_at_tolerance, shown)
    for metric in found.chosen.metrics:
        yield f"{metric.replace('_', '-')}-{name}", partial(accuracy.of_rows, shown, METRICS[metric])
    yield f"rate-{name}", partial(tradeoff.against_rate, timed)
    yield f"memory-{name}", partial(tradeoff.against_memory, timed)
    if any(run.stream for one in shown for run in one.runs):
        yield f"growing-map-{name}", partial(growth.growing_map, shown)

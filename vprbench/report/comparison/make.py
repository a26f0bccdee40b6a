"""`vprbench compare`: what is missing is made, and all of it ends in one ranked table, with figures and a page."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from vprbench.api.dataset import Dataset
from vprbench.errors import BadInput
from vprbench.jobs.child import start_server
from vprbench.jobs.executors import choose_executor
from vprbench.jobs.job import JobResult, describe_failure
from vprbench.progress import progress_shown
from vprbench.report.comparison.checks import Checked, SortedOptions, check_comparison, frames_of
from vprbench.report.figures.make import draw_all, write_figures
from vprbench.report.folder import assemble_groups
from vprbench.report.gather import Plan, Report, list_cells, load_stored_runs, run_missing
from vprbench.report.page.make import write_page
from vprbench.report.plan import NO_PLAN
from vprbench.report.robustness import Robustness, format_csv, format_markdown, list_lines, measure_robustness
from vprbench.report.selection import ResolvedColumn, group_runs_by_column, list_accuracy_runs
from vprbench.report.table import words
from vprbench.report.table.make import choose_exit_code, write_table
from vprbench.report.table.quantities import RECALL, list_comparison_quantities
from vprbench.runs import rows
from vprbench.runs.corruption import Corruption, corrupt_queries, parse_corruptions
from vprbench.runs.frame import format_label, iterate_rows
from vprbench.runs.predictions import tabulate_predictions, write_csv
from vprbench.runs.record import Failure, Run
from vprbench.runs.sequences import name_views, parse_views
from vprbench.storage.atomic import replace_text
from vprbench.terminal.console import line_text, show_table
from vprbench.text import printable, some

logger = logging.getLogger(__name__)

_UNTIMED = ("timing=none", "frames=false")
_LEAST = ("peak MB", "AUC-PR (A)", "R@5 %")  # columns that a narrow terminal lacks first


def make_comparison(command: SortedOptions) -> int:
    """Compare methods on one dataset; returns the exit code: 1 where a run failed, 2 for input to be mended."""
    if not command.request.stored and not command.request.needs_dask:
        start_server()  # imports while the comparison is checked
    found, wrong = check_comparison(command)
    if found is None:
        for line in wrong:
            print(printable(f"vprbench: {line}"), file=sys.stderr)
        return 2
    if found.looked is not None:
        print(line_text(f"note: {found.looked}", "yellow"), flush=True)
    for name, reason in found.left_out.items():
        print(printable(f"vprbench: {name} is left out: {reason}"), file=sys.stderr)
    chosen = plan_table(found, command)
    spoilt = corrupt_column(found, command.request.corruptions)
    results = [] if chosen.stored else make_missing(chosen, found, spoilt, command)
    known, failures = load_stored_runs(chosen)
    compared = report_comparison(chosen, found, known, failures, results)
    show(compared, command.request.wide)
    robust = None
    if spoilt:
        clean, *of_each = (
            list_accuracy_runs(group_runs_by_column(known, (), [column], chosen.rows)[0], compared.chosen.rows)
            for column in (found.column, *spoilt.values())
        )
        robust = measure_robustness(clean, dict(zip(spoilt, of_each, strict=True)))
        table = list_lines(robust)
        print()
        show_table([*table[0]], [[*line.values()] for line in table], command.request.wide)
    best = predict_places(compared, found.dataset, command.request.predictions)
    folder = Path(compared.chosen.results).expanduser()
    files = write_comparison(compared, folder, command.request.name or "", robust, best)
    print("\nwritten to", *files, sep="\n  ")
    return choose_exit_code(results)


def corrupt_column(found: Checked, names: Sequence[str]) -> dict[Corruption, ResolvedColumn]:
    """Return the column of a comparison under each corruption; raises BadInput if it has no accuracy to lower."""
    if names and found.dataset is not None and not any(map(len, found.dataset.positives)):
        raise BadInput(f"corruptions={','.join(names)}: no query of {found.dataset.name} has a right place to lose")
    every = {}
    for one in parse_corruptions(names):
        column = replace(found.column, corruption=one.name)
        if found.dataset is not None:
            with progress_shown(one.name):
                frames = frames_of(corrupt_queries(found.dataset, one.name), found.request)
            column = replace(column, frames=frames)
        every[one] = column
    return every


def make_missing(
    chosen: Plan, found: Checked, spoilt: Mapping[Corruption, ResolvedColumn], command: SortedOptions
) -> list[JobResult]:
    """Make the runs that are not stored, those of corrupted queries on the first device and untimed.

    A process fits a row's method once for all corruptions. If it fails, each of them has a process.
    """
    rows = [row for row in found.rows if row.name not in found.left_out]
    options = [*command.of_runs, *["scores=true"] * bool(chosen.views)]
    once = replace(chosen, devices=chosen.devices[:1])
    names = [each.name for each in spoilt]
    planned = replace(found.column.planned, title=f"{found.column.planned.title}, {len(names)} corruptions")
    column = replace(found.column, planned=planned, corruption=names)
    untimed = [*(option for option in command.of_runs if not option.startswith("timing")), *_UNTIMED]
    with choose_executor(command.request) as executor:
        results = run_missing(chosen, [*list_cells(chosen, found.column, rows, options)], executor)
        together = [*list_cells(once, column, rows, untimed)] if names else []
        ended = run_missing(once, together, executor)
        failed = [cell for cell, result in zip(together, ended, strict=True) if result.code == 1]
        alone = run_missing(once, [one for cell in failed for one in cell.each()], executor)
    return [*results, *(result for result in ended if result.code != 1), *alone]


def plan_table(found: Checked, command: SortedOptions) -> Plan:
    """Return the rows and the one column of a comparison, as a table has them."""
    request = command.request
    return Plan(
        NO_PLAN,
        found.rows,
        (found.column,),
        tuple(request.devices),
        metrics=tuple(request.metrics),
        results=request.results,
        stores=tuple(request.stores),
        stored=request.stored,
        title=found.column.planned.title,
        quantities=list_comparison_quantities(request.metrics, request.devices),
        views=parse_views(request.sequence, request.filter),
    )


def report_comparison(
    chosen: Plan,
    found: Checked,
    known: Sequence[Run],
    failures: Sequence[Failure],
    results: Sequence[JobResult] = (),
) -> Report:
    """Return the report of the stored runs of a comparison, best first; raises BadInput if there is no run."""
    left_out = [
        describe_failure(cell.request, found.left_out[row.name], missing=True)
        for row in found.rows
        if row.name in found.left_out
        for cell in list_cells(chosen, found.column, [row], ())
    ]
    newest = group_runs_by_column(known, [*failures, *left_out], [found.column], chosen.rows)[0]
    return assemble_groups(chosen, [newest], results)


def show(found: Report, wide: bool = False) -> None:
    """Print notes, the ranked table and the results of tests; of several views R@1 alone, side by side."""
    table, groups_shown = found.table, [group for group in found.groups if group.runs]
    heads = ["method", *(quantity.heading for quantity in table.quantities)]
    cells = words.describe_cells(table)
    print(line_text(f"{table.title}: {words.describe_data(table.columns[0])}", fits=True))
    if len(table.columns) > 1:
        for run in (group.runs[0] for group in groups_shown):
            print(line_text(f"{rows.describe_sequence(run)}: {len(run.outcome):,} queries"))
        heads = ["R@1 %", *(rows.describe_sequence(group.runs[0]) for group in groups_shown)]
        cells = cells[(table.cells["quantity"] == RECALL.name).to_numpy()]
    for row, of_row in table.cells.groupby("row", sort=False):
        for number in sorted({number for notes in of_row["notes"] for number in notes}):
            print(line_text(f"note: {row}: {table.notes[number - 1]}", "yellow"))
    print()
    texts = [[str(name), *_list_texts(of_row)] for name, of_row in cells.groupby("row", sort=False)]
    usual = [one.heading for one in table.quantities if one.metric is None or one.name not in found.chosen.metrics]
    show_table(heads, texts, wide, [*dict.fromkeys([*_LEAST, *usual[:0:-1]])])
    if any(table.cells["disturbed"]):
        print(line_text("~ a busy machine or too few laps", "dim"))
    print()
    for group, ranking in zip(groups_shown, found.rankings, strict=True):
        above = f"{rows.describe_sequence(group.runs[0])}: " if len(groups_shown) > 1 else ""
        print(*(line_text(f"{above}{sentence}", "bold") for sentence in ranking.sentences), sep="\n")


def _list_texts(cells: pd.DataFrame) -> Iterator[str]:
    """Yield the text of a row's cells, the word for an absent number once in a column."""
    for _, of_column in cells.groupby("column", sort=False):
        first = of_column["absence"].iloc[0]
        for number, cell in enumerate(iterate_rows(of_column)):
            absence = cell.absence if number == 0 or cell.text or cell.absence != first else ""
            yield " ".join(filter(None, [absence, cell.text, cell.extent]))


def predict_places(compared: Report, dataset: Dataset | None, n: int | None) -> pd.DataFrame | None:
    """Return the best `n` places of each query by every run that is shown, 10 if None; None if `n` is 0.

    The `dataset` names the images, None leaves them out. `method`, `seed` and `answers` (the view that is shown, or
    empty) stand before the columns of `predictions`.
    """
    if n == 0:
        return None
    tables = []
    for group in compared.groups:
        for one in list_accuracy_runs(group, compared.chosen.rows):
            for run in one.runs:
                table = tabulate_predictions(run, min(n or 10, run.top_places.shape[1]), dataset)
                about = {"method": one.name, "seed": run.config["seed"], "answers": rows.describe_sequence(run)}
                tables.append(pd.concat([pd.DataFrame(about, index=table.index), table], axis=1))
    return pd.concat(tables, ignore_index=True)


def write_comparison(
    found: Report,
    folder: Path,
    name: str = "",
    robust: Robustness | None = None,
    best: pd.DataFrame | None = None,
) -> list[Path]:
    """Write the table, its runs, figures and page of a comparison into a folder; returns the files.

    Args:
        found: the report of the comparison.
        folder: made if need be.
        name: of the files; empty: that of the dataset, with the hash of frames and ground truth if files of others
            have it.
        robust: R@1 under corruptions.
        best: the best places of each query.
    """
    from vprbench.report.figures.accuracy import draw_robustness

    beside_others, name = not name, name or found.chosen.columns[0].planned.name
    name += "-views" * (found.chosen.columns[0].views is not None) + name_views(found.chosen.views)
    images = found.runs[0].fingerprint
    if beside_others and not _read_earlier(folder / f"{name}-runs.csv")["fingerprint"].map(images.startswith).all():
        name = f"{name}-{images[:6]}"
    replaced = {*_read_earlier(folder / f"{name}-runs.csv")["method"]} - {format_label(run) for run in found.runs}
    if replaced:
        logger.warning("%s: the earlier comparison with %s makes room: name=NAME keeps both", name, some(replaced))
    files = write_table(found, folder, name)
    if best is not None:
        files.append(write_csv(best, folder / f"{name}-predictions.csv"))
    if robust is not None:
        title = str(found.table.title)
        for ending, text in (("md", format_markdown(robust, title)), ("csv", format_csv(robust))):
            files.append(folder / f"{name}-robustness.{ending}")
            replace_text(files[-1], text)
    absent: list[str] = []
    with progress_shown("compare, figures"):
        drawings = list(draw_all(found, found.runs, report=absent.append))
        if robust is not None:
            drawings.append((f"robustness-{found.chosen.columns[0].planned.name}", draw_robustness(robust)))
        *_, captions = write_figures(drawings, folder / "figures" / name)
        for path in captions.parent.glob("*.p[dn][fg]"):  # of an earlier comparison of this name
            if path.stem not in dict(drawings):
                path.unlink()
    return [*files, captions, write_page(found, drawings, folder / f"{name}.html", absent)]


def _read_earlier(path: Path) -> pd.DataFrame:
    """Return the runs of an earlier comparison whose files have this name; without any no line."""
    return pd.read_csv(path, dtype=str) if path.is_file() else pd.DataFrame(columns=["method", "fingerprint"])

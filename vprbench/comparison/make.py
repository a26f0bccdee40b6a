"""`vprbench compare`: what is missing is made, and all of it ends in one ranked table, with figures and a page."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from vprbench.comparison.checks import Checked, SortedOptions, check_comparison
from vprbench.errors import BadInput
from vprbench.jobs.executors import Executor, executor_for
from vprbench.jobs.job import JobResult, failure_of
from vprbench.paper.figures.make import draw_all, write_figures
from vprbench.paper.gather import ReportData, TablePlan, assembled, run_missing, runs_of, stored
from vprbench.paper.page.make import write_page
from vprbench.paper.plan import Growth, Plan, Row
from vprbench.paper.ranking import Ranking, rank_rows
from vprbench.paper.robustness import Robustness, csv, lines, markdown, robustness
from vprbench.paper.selection import Group, accuracy_series, as_text, describe_protocol, groups, seen
from vprbench.paper.table import words
from vprbench.paper.table.make import exit_code, write
from vprbench.paper.table.quantities import RECALL, comparison_quantities, without_accuracies
from vprbench.progress import progress_shown
from vprbench.runs import rows
from vprbench.runs.corruption import Corruption, corrupt_queries, parse_corruptions
from vprbench.runs.frame import iterate_rows
from vprbench.runs.identity import fingerprint
from vprbench.runs.predictions import tabulate_predictions, write_csv
from vprbench.runs.record import Failure, Run
from vprbench.runs.sequences import name_views, parse_views
from vprbench.storage.atomic import replace_text
from vprbench.terminal.console import line_text, show_table
from vprbench.text import printable

_UNTIMED = ("timing=none", "frames=false")


def under(found: Checked, names: Sequence[str]) -> dict[Corruption, Checked]:
    """Return a comparison under each of the named corruptions; raises BadInput if it has no accuracy to lower."""
    if names and found.dataset is not None and not any(map(len, found.dataset.positives)):
        raise BadInput(f"corruptions={','.join(names)}: no query of {found.dataset.name} has a right place to lose")
    every = {}
    for one in parse_corruptions(names):
        planned = replace(found.column.planned, title=f"{found.column.planned.title}, {one.name}")
        column = replace(found.column, planned=planned, corruption=one.name)
        dataset = None if found.dataset is None else corrupt_queries(found.dataset, one.name)
        with progress_shown(one.name):
            images = "" if dataset is None else fingerprint(dataset)
        every[one] = replace(found, column=column, dataset=dataset, images=images)
    return every


def make_missing(
    chosen: TablePlan,
    rows: Sequence[Row],
    spoilt: dict[Corruption, Checked],
    command: SortedOptions,
    executor: Executor | None = None,
) -> list[JobResult]:
    """Make the runs that are not stored, on the first device alone; returns how each ended.

    A process fits a row's method once for all corruptions. If it dies, or a run may take `limit_minutes` alone, each
    of the runs has a process.
    """
    once = replace(chosen, devices=chosen.devices[:1])
    options = [option for option in command.of_runs if option.partition("=")[0].partition(".")[0] != "timing"]
    if not spoilt or chosen.stored:
        return []
    options += _UNTIMED
    names = [each.name for each in spoilt]
    first = next(iter(spoilt.values())).column
    title = f"{first.dataset['name']}, {len(names)} corruptions"
    column = replace(first, planned=replace(first.planned, title=title), corruption=names)
    together = list(runs_of(once, column, rows, options))
    if any(option.startswith("limit_minutes=") for option in options):
        return run_missing(once, [one for cell in together for one in cell.each()], executor)
    results = run_missing(once, together, executor)
    died = [cell for cell, result in zip(together, results, strict=True) if result.code == 1]
    alone = run_missing(once, [one for cell in died for one in cell.each()], executor)
    return [*(result for result in results if result.code != 1), *alone]


_NO_PLAN = Plan({}, {}, {}, Growth((), (), (), 0))
_LEAST = ("peak MB", "AUC-PR (A)", "R@5 %")  # columns that a narrow terminal lacks first


def make_comparison(command: SortedOptions) -> int:
    """Compare methods on one dataset; returns the exit code: 1 where a run failed, 2 for input to be mended."""
    found, wrong = check_comparison(command)
    if found is None:
        for line in wrong:
            print(printable(f"vprbench: {line}"), file=sys.stderr)
        return 2
    if found.looked is not None:
        print(line_text(f"note: {found.looked}", "yellow"), flush=True)
    chosen = chosen_of(found, command)
    there = [cell.row for cell in found.cells if cell.missing is None]
    for cell in found.cells:
        if cell.missing is not None:
            print(printable(f"vprbench: {cell.row.name} is left out: {cell.missing}"), file=sys.stderr)
    options = [*command.of_runs, *["scores=true"] * bool(chosen.views)]
    with executor_for(command.request) as executor:
        cells = [] if chosen.stored else list(runs_of(chosen, found.column, there, options))
        results = run_missing(chosen, cells, executor)
        spoilt = under(found, command.request.corruptions)
        results += make_missing(chosen, there, spoilt, command, executor)
    known, failures = stored(chosen)
    compared, rankings = ranked_material(chosen, found, known, failures, results)
    show(compared, rankings, command.request.wide)
    robust = None
    if spoilt:
        of_each = {one: accuracy_series(newest(chosen, of, known), chosen.rows) for one, of in spoilt.items()}
        robust = robustness(accuracy_series(newest(chosen, found, known), compared.chosen.rows), of_each)
        table = lines(robust)
        print()
        show_table([*table[0]], [[*line.values()] for line in table], command.request.wide)
    best = predicted(compared, found, command.request.predictions)
    print("\nwritten to", *written(compared, command.request.name is None, robust, best), sep="\n  ")
    return exit_code(results)


def chosen_of(found: Checked, command: SortedOptions) -> TablePlan:
    """Return the rows and the one column of a comparison, as a table has them."""
    request = command.request
    return TablePlan(
        _NO_PLAN,
        tuple(cell.row for cell in found.cells),
        (found.column,),
        tuple(request.devices),
        metrics=tuple(request.metrics),
        results=request.results,
        stores=tuple(request.stores),
        stored=request.stored,
        title=found.column.planned.title,
        quantities=comparison_quantities(request.metrics, request.devices),
        views=parse_views(request.sequence, request.filter),
    )


def ranked_material(
    chosen: TablePlan,
    found: Checked,
    known: Sequence[Run],
    failures: Sequence[Failure],
    results: Sequence[JobResult] = (),
) -> tuple[ReportData, list[Ranking]]:
    """Put the runs of a comparison into one table, best first, rows without runs last; other stored runs stay out.

    There is a ranking for each view that was asked for; the first orders the rows. Raises BadInput if there is no run.
    """
    there = newest(chosen, found, known)
    if there.runs and not there.runs[0].is_judged:
        chosen = replace(chosen, quantities=without_accuracies(chosen.quantities))
    left_out = [
        failure_of(cell.request, JobResult(2, left.missing, missing=True))
        for left in found.cells
        if left.missing is not None
        for cell in runs_of(chosen, found.column, [left.row], ())
    ]
    shown = groups(there.runs, [*failures, *left_out], [found.column], chosen.rows)
    shown = seen(shown, chosen.rows, chosen.views)
    rankings = [rank_rows(accuracy_series(group, chosen.rows)) for group in shown]
    order = [*rankings[0].table["method"]]
    ordered = sorted(chosen.rows, key=lambda row: order.index(row.name) if row.name in order else len(order))
    return assembled(replace(chosen, rows=tuple(ordered)), shown, there.runs, tuple(results)), rankings


def newest(chosen: TablePlan, found: Checked, known: Sequence[Run]) -> Group:
    """Return the stored runs of a comparison, of several protocols those with the newest run."""
    runs = [run for run in known if _is_of(run, found)]
    return groups([_with_options_of(run, found) for run in runs], (), [found.column], chosen.rows)[0]


def _is_of(run: Run, found: Checked) -> bool:
    """Tell whether a stored run was made of these very frames, places and threads; any is if the frames are unknown."""
    if found.dataset is None:
        return True
    alike = run.fingerprint == found.images and as_text(run.protocol) == as_text(found.dataset.protocol)
    return alike and run.environment.get("threads") == found.request.n_threads


def _with_options_of(run: Run, found: Checked) -> Run:
    """Return a run as if it had been asked for in the words of this comparison, paths among them."""
    if found.dataset is None:
        return run
    config = {**run.config, "dataset": found.column.dataset}
    gaps = found.dataset.query_breaks, found.dataset.place_breaks  # a run may have been stored before they were told
    return replace(run, config=config, query_breaks=gaps[0], place_breaks=gaps[1])


def show(found: ReportData, rankings: Sequence[Ranking], wide: bool = False) -> None:
    """Print notes, the ranked table and what tests say of it; of several views R@1 alone, side by side."""
    table = found.table
    if len(table.columns) == 1:
        print(line_text(f"{table.title}: {words.describe_data(table.columns[0])}", fits=True))
    else:
        print(
            line_text(
                f"{table.title}: {table.columns[0].n_places or 0:,} places; {describe_protocol(found.runs[0])}",
                fits=True,
            )
        )
        for run in (group.runs[0] for group in found.groups if group.runs):
            print(line_text(f"{rows.describe_view(run, whole=True)}: {len(run.outcome):,} queries"))
    for row, cells in table.cells.groupby("row", sort=False):
        for number in sorted({number for notes in cells["notes"] for number in notes}):
            print(line_text(f"note: {row}: {table.notes[number - 1]}", "yellow"))
    print()
    cells = words.describe_cells(table)
    heads = ["method", *(quantity.heading for quantity in table.quantities)]
    if len(table.columns) > 1:
        heads = ["R@1 %", *map(_short, found.groups)]
        cells = cells[(table.cells["quantity"] == RECALL.name).to_numpy()]
    of_rows = cells.groupby("row", sort=False)
    show_table(heads, [[str(name), *_shown(of_row)] for name, of_row in of_rows], wide, _LEAST)
    print()
    for group, ranking in zip(found.groups, rankings, strict=True):
        above = f"{_short(group)}: " if len(rankings) > 1 else ""
        print(*(line_text(f"{above}{sentence}", "bold") for sentence in ranking.sentences), sep="\n")


def _short(group: Group) -> str:
    """Return what tells a group of a comparison from the others."""
    return rows.describe_view(group.runs[0]) if group.runs else "no run"


def _shown(cells: pd.DataFrame) -> Iterator[str]:
    """Yield the text of a row's cells, the word for what is absent once in a column."""
    for _, of_column in cells.groupby("column", sort=False):
        first = of_column["absence"].iloc[0]
        for number, cell in enumerate(iterate_rows(of_column)):
            absence = cell.absence if number == 0 or cell.value or cell.absence != first else ""
            yield " ".join(filter(None, [absence, cell.value, cell.extent]))


def predicted(compared: ReportData, found: Checked, n: int | None) -> pd.DataFrame | None:
    """Return the best `n` places of each query by every run that is shown, 10 if None; None if `n` is 0.

    `method`, `seed` and `answers` (the view that is shown, or empty) stand before the columns of `predictions`.
    """
    if n == 0:
        return None
    tables = []
    for group in compared.groups:
        for one in accuracy_series(group, compared.chosen.rows):
            for run in one.runs:
                table = tabulate_predictions(run, min(n or 10, run.top_places.shape[1]), found.dataset)
                told = {"method": one.name, "seed": run.config["seed"], "answers": rows.describe_view(run)}
                tables.append(pd.concat([pd.DataFrame(told, index=table.index), table], axis=1))
    return pd.concat(tables, ignore_index=True)


def written(
    found: ReportData, beside_others: bool, robust: Robustness | None = None, best: pd.DataFrame | None = None
) -> list[Path]:
    """Write the table, its runs, figures and page of a comparison into the results folder; returns the files.

    `best` holds the best places of each query.
    If `beside_others`, files of this name that are of other frames stay: the new ones get the frames' hash.
    """
    from vprbench.paper.figures.accuracy import draw_robustness

    folder, name = Path(found.chosen.results).expanduser(), found.chosen.columns[0].planned.name
    name += "-views" * (found.chosen.columns[0].views is not None) + name_views(found.chosen.views)
    if beside_others and _of_other_frames(folder / f"{name}-runs.csv", found.runs):
        name = f"{name}-{found.runs[0].fingerprint[:6]}"
    files = write(found, folder, name)
    if best is not None:
        files.append(write_csv(best, folder / f"{name}-predictions.csv"))
    if robust is not None:
        title = str(found.table.title)
        for ending, text in (("md", markdown(robust, title)), ("csv", csv(robust))):
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


def _of_other_frames(path: Path, runs: Sequence[Run]) -> bool:
    """Tell whether the runs of an earlier comparison are of other frames."""
    if not path.is_file():
        return False
    frames = ["names_sha256", "content_sha256"]
    earlier = pd.read_csv(path, dtype=str).reindex(columns=frames).fillna("").drop_duplicates().to_numpy().tolist()
    return earlier != [[str(runs[0].data.get(part) or "") for part in frames]]

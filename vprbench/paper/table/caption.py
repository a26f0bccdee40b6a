"""The sentences beside the table: what its numbers are, what they can be trusted for, and what is not shown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from vprbench.paper.selection import DEVICES, Device, Group, options_apart
from vprbench.paper.table import best
from vprbench.paper.table.cells import Column, Entry, TableRow
from vprbench.paper.table.quantities import RATES, RECALL, Quantity
from vprbench.paper.table.reasons import one_sentence
from vprbench.paper.templates import ENVIRONMENT, sentences
from vprbench.runs.record import Failure

ENVIRONMENT.globals["best"] = best
ENVIRONMENT.filters["one_sentence"] = one_sentence

_NAMES: dict[Device, str] = {"cpu": "CPU", "cuda": "GPU"}


def caption(
    groups: Sequence[Group],
    columns: Sequence[Column],
    entries: Mapping[str, Sequence[Entry]],
    rows: Sequence[TableRow],
    quantities: Sequence[Quantity],
) -> list[str]:
    """Return the caption of a table; `columns` are those of the groups, `entries` those of each row by its name."""
    cells = [cell for row in rows for cell in row.cells.values()]
    measured = [cell.measured for cell in cells if cell.measured is not None]
    versions = Counter(group.asked.planned.name for group in groups)
    apart = [options_apart(group) if versions[group.asked.planned.name] > 1 else () for group in groups]
    seeds = [(row.name, _seeds(row, columns)) for row in rows]
    blocks = [(column.title, _blocks(column, rows)) for column in columns]
    return sentences(
        "table/sentences.j2",
        "caption",
        list(zip(columns, apart, strict=True)),
        [(name, places) for name, places in seeds if any(len(seeds) > 1 for seeds in places)],
        [(title, of_rows) for title, of_rows in blocks if of_rows],
        [(name, _failed(there), *_aside(there)) for name, there in entries.items()],
        any(each.best for each in measured),
        any(each.disturbed for each in measured),
        any(cell.published_mark != "none" for cell in cells),
        [f"{quantity.head} in {quantity.unit}" for quantity in quantities if quantity.unit],
    )


def _seeds(row: TableRow, columns: Sequence[Column]) -> dict[tuple[int, ...], list[str]]:
    """Return which columns, and devices if these differ, show which seeds of a row."""
    places: dict[tuple[int, ...], list[str]] = {}
    for column in columns:
        cells = {rate.device: cell.measured for rate in RATES if (cell := row.cells.get((column.name, rate.name)))}
        shown = {device: measured.seeds for device, measured in cells.items() if measured is not None}
        recall = row.cells[column.name, RECALL.name].measured
        if recall is not None and not shown:  # nothing was timed
            shown = {"cpu": recall.seeds}
        for device, seeds in shown.items():
            where = column.title if len({*shown.values()}) == 1 else f"{column.title}, {_NAMES[device]}"
            places[seeds] = [*dict.fromkeys([*places.get(seeds, []), where])]
    return places


def _blocks(column: Column, rows: Sequence[TableRow]) -> list[tuple[str, object]]:
    """Return the rows whose interval of R@1 is of blocks of queries, each with what was measured."""
    cells = [(row.name, row.cells[column.name, RECALL.name].measured) for row in rows]
    return [(name, measured) for name, measured in cells if measured is not None and measured.block is not None]


def _failed(entries: Sequence[Entry]) -> list[tuple[str, str, Failure]]:
    """Return the failures of seeds that are stored, of which no cell says anything, with title and device."""
    found = [(entry.column.title, device, entry.found[device]) for entry in entries for device in DEVICES]
    return [
        (title, _NAMES[device], failure)
        for title, device, runs in found
        for failure in runs.failures
        if failure.config["seed"] not in runs.missing_seeds
    ]


def _aside(entries: Sequence[Entry]) -> tuple[Mapping[str, int], Mapping[str, None]]:
    """Return how many runs of a row are not shown, by the reason, and in what they differ from those that are."""
    asides = [aside for entry in entries for found in entry.found.values() for aside in found.aside]
    counts: Counter[str] = Counter()
    for aside in asides:
        counts[aside.why] += aside.n_runs
    return counts, dict.fromkeys(name for aside in asides for name in aside.other)

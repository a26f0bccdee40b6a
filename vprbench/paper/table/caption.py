"""The sentences beside the table: what its numbers are, what they can be trusted for, and what is not shown."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence

from vprbench.paper.selection import DEVICES, Device, Group, aside_sentence, options_apart
from vprbench.paper.table import best
from vprbench.paper.table.cells import Column, Entry, TableRow
from vprbench.paper.table.quantities import RATES, RECALL
from vprbench.paper.table.reasons import PAPER, PAPER_CPU, PAPER_GPU, one_sentence

_NAMES: dict[Device, str] = {"cpu": "CPU", "cuda": "GPU"}


def sentences(
    groups: Sequence[Group],
    columns: Sequence[Column],
    entries: Mapping[str, Sequence[Entry]],
    rows: Sequence[TableRow],
) -> Iterator[str]:
    """Yield the caption of a table; `columns` are those of the groups, `entries` those of each row by its name."""
    measured = [cell.measured for row in rows for cell in row.cells.values() if cell.measured is not None]
    yield (
        "R@1 in %, training in minutes, query rates in Hz, beside those that the paper printed: "
        f"{PAPER}, measured on an {PAPER_CPU} and an {PAPER_GPU}."
    )
    for group, column in zip(groups, columns, strict=True):
        if column.stand_in_for is not None:
            yield f"{column.title} stands in for {column.stand_in_for} and replaces none."
        apart = options_apart(group)
        if apart and sum(other.asked.planned.name == group.asked.planned.name for other in groups) > 1:
            yield f"{column.title}: its runs are of a time when the dataset had other options ({', '.join(apart)})."
    yield from dict.fromkeys(column.remark for column in columns if column.remark is not None)
    for row in rows:
        yield from _seeds(row, columns)
    for column in columns:
        yield from _blocks(column, rows)
    for name, there in entries.items():
        for entry, device in itertools.product(there, DEVICES):
            found = entry.found[device]
            for failure in found.failures:
                if (seed := failure.config["seed"]) not in found.missing_seeds:  # its cell says nothing of it
                    where = f"{name}, {entry.column.title}, {_NAMES[device]}"
                    yield f"{where}: seed {seed} failed since: {one_sentence(failure.error)}."
        aside = aside_sentence(name, [found for entry in there for found in entry.found.values()])
        if aside:
            yield aside
    yield from best.RULES if any(each.best for each in measured) else best.NO_WINNER
    if any(each.disturbed for each in measured):
        yield "A tilde, for a busy machine or too few laps, keeps all times beside it from being bold."


def _seeds(row: TableRow, columns: Sequence[Column]) -> Iterator[str]:
    """Yield what stands for several seeds of a row, and which ones they are where that is not the same everywhere."""
    places: dict[tuple[int, ...], list[str]] = {}
    for column in columns:
        cells = {rate.device: row.cells[column.name, rate.name].measured for rate in RATES}
        shown = {device: measured.seeds for device, measured in cells.items() if measured is not None}
        for device, seeds in shown.items():
            where = column.title if len({*shown.values()}) == 1 else f"{column.title}, {_NAMES[device]}"
            places[seeds] = [*dict.fromkeys([*places.get(seeds, []), where])]
    if any(len(seeds) > 1 for seeds in places):
        words = (
            _seed_words(seeds) + (f" ({'; '.join(where)})" if len(places) > 1 else "")
            for seeds, where in places.items()
        )
        yield f"{row.name}: {', '.join(words)}; of R@1 and rates the mean, of minutes the median."


def _seed_words(seeds: Sequence[int]) -> str:
    *first, last = map(str, seeds)
    return f"seeds {', '.join(first)} and {last}" if first else f"seed {last}"


def _blocks(column: Column, rows: Sequence[TableRow]) -> Iterator[str]:
    """Yield how long the blocks are that the intervals of R@1 come from, and where neighbours are as good as apart."""
    parts = []
    for row in rows:
        measured = row.cells[column.name, RECALL.name].measured
        if measured is not None and measured.block is not None:
            parts.append(f"{row.name} {measured.block}{' (Wilson)' if measured.interval == 'independent' else ''}")
    if parts:
        yield f"{column.title}, length in queries of the blocks that the intervals of R@1 are of: {', '.join(parts)}."

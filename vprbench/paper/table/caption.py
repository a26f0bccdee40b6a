"""The sentences beside the table: what its numbers are, what they can be trusted for, and what is not shown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import pandas as pd

from vprbench.paper.selection import DEVICES, Device, Group, options_apart
from vprbench.paper.table import best
from vprbench.paper.table.quantities import RATES, RECALL, Quantity
from vprbench.paper.table.reasons import one_sentence
from vprbench.paper.templates import ENVIRONMENT, sentences
from vprbench.runs.frame import iterate_rows
from vprbench.runs.record import Failure

if TYPE_CHECKING:
    from vprbench.paper.table.cells import Column, Entry

ENVIRONMENT.globals["best"] = best
ENVIRONMENT.filters["one_sentence"] = one_sentence

_NAMES: dict[Device, str] = {"cpu": "CPU", "cuda": "GPU"}


def caption(
    groups: Sequence[Group],
    columns: Sequence[Column],
    entries: Mapping[str, Sequence[Entry]],
    cells: pd.DataFrame,
    quantities: Sequence[Quantity],
) -> list[str]:
    """Return the caption of a table; `columns` are those of the groups, `entries` those of each row by its name."""
    versions = Counter(group.column.planned.name for group in groups)
    apart = [options_apart(group) if versions[group.column.planned.name] > 1 else () for group in groups]
    measured = cells[cells["seeds"].notna()]
    seeds = [(name, _seeds(measured[measured["row"] == name], columns)) for name in entries]
    recalls = measured[(measured["quantity"] == RECALL.name) & measured["block"].notna()]
    blocks = [(column.title, [*iterate_rows(recalls[recalls["column"] == column.name])]) for column in columns]
    return sentences(
        "table/sentences.j2",
        "caption",
        list(zip(columns, apart, strict=True)),
        [(name, places) for name, places in seeds if any(len(seeds) > 1 for seeds in places)],
        [(title, of_rows) for title, of_rows in blocks if of_rows],
        [(name, _failed(there), *_aside(there)) for name, there in entries.items()],
        any(cells["best"]),
        any(cells["disturbed"]),
        any(cells["published_mark"] != "none"),
        [f"{quantity.head} in {quantity.unit}" for quantity in quantities if quantity.unit],
    )


def _seeds(measured: pd.DataFrame, columns: Sequence[Column]) -> dict[tuple[int, ...], list[str]]:
    """Return which columns, and devices if these differ, show which seeds of the row whose measured cells these are."""
    places: dict[tuple[int, ...], list[str]] = {}
    for column in columns:
        cells: Mapping[str, Any] = {
            cell.quantity: cell.seeds for cell in iterate_rows(measured[measured["column"] == column.name])
        }
        shown = {rate.device: cells[rate.name] for rate in RATES if rate.name in cells}
        if RECALL.name in cells and not shown:  # nothing was timed
            shown = {"cpu": cells[RECALL.name]}
        for device, seeds in shown.items():
            where = column.title if len({*shown.values()}) == 1 else f"{column.title}, {_NAMES[device or 'cpu']}"
            places[seeds] = [*dict.fromkeys([*places.get(seeds, []), where])]
    return places


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

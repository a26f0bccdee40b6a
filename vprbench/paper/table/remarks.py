"""Remarks on cells: short codes for absent numbers, for facts about a number, and for differences from the paper."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from statistics import mean
from typing import Literal

from vprbench.metrics.accuracy import recall_at
from vprbench.paper.plan import PlannedColumn, Row
from vprbench.paper.published import PAPER_CPU, PAPER_GPU, PROTOCOLS
from vprbench.paper.selection import RowRuns, as_text
from vprbench.paper.table.quantities import Quantity
from vprbench.runs.notes import DISTURBED, NoteKind
from vprbench.runs.record import Failure, Run

Mark = Literal[
    "measured",  # by this harness, on the machine that the cell names
    "quoted",  # copied from a publication: in italics, in no contest
    "not applicable",  # there is no such step: printed as -
    "not there",  # the method, its weights or the frames are missing; the row fills by itself once they are there
    "failed",
    "left out",  # too many places for this row within the time of the table
    "unfinished",  # some of the seeds are not stored yet, or none
    "not timed",  # answers are stored, and no rates with them
    "not run",  # no run of this kind is stored, as on a machine without a GPU
]
_HIDDEN: frozenset[NoteKind] = DISTURBED | {"offline", "described", "fitted"}  # a tilde, or another cell, shows them
_TOLERANCES = {"tolerance_places": "places", "tolerance_metres": "m", "radius_metres": "m"}


def explain_absence(found: RowRuns, quantity: Quantity, has_other_device: bool, is_slow: bool) -> tuple[Mark, str]:
    """Return the word in a cell that no run measured, and its remark, which may be empty.

    Args:
        found: The runs and failures of the row on the device of the cell.
        quantity: What the cell would show.
        has_other_device: Whether the row has runs on another kind of device.
        is_slow: Whether the row is left out for its number of places.
    """
    if found.failures:
        first = next((failure for failure in found.failures if not failure.missing), found.failures[0])
        return "not there" if first.missing else "failed", describe_failure(first)
    if found.runs and quantity.kind == "rate":
        return "not timed", ""
    if found.runs:
        loaded = any(run.network is not None for run in found.runs)
        return "not run", "network loaded" if loaded else "descriptors of an earlier run"
    if quantity.device == "cuda" or has_other_device:
        return "not run", ""
    return ("left out" if is_slow else "unfinished"), ""


def describe_failure(failure: Failure, with_seed: bool = False) -> str:
    """Return the code of a failure and the first line of its error."""
    seed = f" seed {failure.config['seed']}" if with_seed else ""
    line = next(iter(failure.error.strip().splitlines()), "")
    return f"{'missing' if failure.missing else 'failed'}{seed}: {line}"


def explain_undefined(quantity: Quantity, runs: Sequence[Run]) -> str:
    """Return the remark on a quantity that is undefined in all runs of a row."""
    reasons = (run.energy["how"].get(quantity.name) for run in runs if run.energy is not None)
    reason = next(filter(None, reasons), None) if quantity.metric is not None and quantity.metric.cost else None
    return f"undefined: {reason or 'no query has a right place'}"


def list_remarks(quantity: Quantity, row: Row, runs: Sequence[Run]) -> Iterator[str]:
    """Yield what a reader of a number has to know, the notes of its runs among it."""
    notes = [note for run in runs for note in run.notes]
    if quantity.kind == "training" and row.training == "map":
        yield "time to build the map"
    if quantity.kind in ("training", "fit"):
        yield from (note.text for note in notes if note.kind == "fitted")
    elif quantity.kind != "memory":  # whose notes stand with the accuracy
        recalls = [recall_at(run.outcome, 1) for run in runs] if quantity.fact == "recall_at_1" else []
        known = [recall for recall in recalls if recall is not None]
        if any(recall.hangs_on_ties for recall in known):
            low, high = mean(each.pessimistic for each in known), mean(each.optimistic for each in known)
            yield f"ties: R@1 {100 * low:.1f} to {100 * high:.1f} % by how they are broken"
        of_rate = quantity.kind == "rate"
        yield from (n.text for n in notes if n.kind not in _HIDDEN and (n.kind == "answers") == of_rate)


def list_differences(
    quantity: Quantity, row: Row, planned: PlannedColumn, real_title: str | None, run: Run
) -> Iterator[str]:
    """Yield in what a number differs from the paper's; nothing for a column that the paper lacks.

    Args:
        quantity: What the cell shows.
        row: The row of the cell.
        planned: The column of the cell.
        real_title: The title of the dataset that a rendered one stands in for.
        run: One of the cell's runs, which agree in everything that is compared here.
    """
    paper = PROTOCOLS.get(planned.published or "")
    if paper is None:
        return
    references, query = run.protocol.get("references"), run.protocol.get("query")
    places, queries = run.outcome.n_places, len(run.outcome)
    if real_title is not None:
        yield f"other data: rendered, for {real_title}"
    elif references is not None and (frozenset(references), query) != (paper.references, paper.query):
        yield f"other traverses: {'+'.join(references)} against {query}"
    if quantity.device is None:
        if (places, queries) != (paper.places, paper.queries):
            yield f"other protocol: {queries:,} queries of {places:,} places"
        for name, unit in _TOLERANCES.items():
            if within := run.protocol.get(name):
                yield f"other tolerance: {within:g} {unit}"
        return
    if places != paper.places:
        yield f"other size: {places:,} places"
    name, theirs = ("processor", PAPER_CPU) if quantity.device == "cpu" else ("accelerator", PAPER_GPU)
    ours = str(run.environment.get(name, "unknown"))
    if theirs.split()[-1] not in ours:
        yield f"other hardware: {ours}"
    if quantity.kind == "rate" and row.rate_remark is not None:
        yield row.rate_remark


def find_other_timing(runs: Mapping[str, Sequence[Run]]) -> dict[str, str]:
    """Return a remark for each row with a run that was timed otherwise than most rows of its column.

    Of protocols that equally many rows have, the first row's counts.
    """
    timings = {
        name: {as_text(run.config.get("timing")): run.config.get("timing") or {} for run in of_row}
        for name, of_row in runs.items()
    }
    n_rows = Counter(protocol for of_row in timings.values() for protocol in of_row)
    usual = max(n_rows, key=n_rows.__getitem__, default="")
    values = next((of_row[usual] for of_row in timings.values() if usual in of_row), {})
    found = {}
    for name, of_row in timings.items():
        for protocol, timing in of_row.items():
            if protocol != usual:
                changed = [f"{option} {value}" for option, value in timing.items() if value != values.get(option)]
                found[name] = f"other timing: {', '.join(changed) or 'not recorded'}"
    return found

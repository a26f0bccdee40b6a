"""Why a cell of the table has no number: one of the table's words, and the reason in a sentence."""

from __future__ import annotations

import re
from dataclasses import dataclass

from vprbench.paper.plan import Row
from vprbench.paper.selection import Device, RowRuns
from vprbench.paper.table.cells import Mark

LONGEST = 120  # letters of a reason

_KINDS = {"cpu": "a CPU", "cuda": "a GPU"}


@dataclass(frozen=True)
class Absence:
    """The word in the cell and the reason under the table."""

    mark: Mark
    reason: str


def absent(row: Row, device: Device, found: RowRuns, elsewhere: bool, left_out: str | None) -> Absence:
    """Return why a row without runs on a kind of device has none.

    `elsewhere` tells whether the other kind of device has runs. `left_out` says where rows stand that take too long: on
    the CPU, for of a GPU no more is known than that nothing is stored.
    """
    if found.failures:
        first = next((failure for failure in found.failures if not failure.missing), found.failures[0])
        return Absence("not there" if first.missing else "failed", one_sentence(first.error))
    if left_out is not None and device == "cpu" and not elsewhere:
        return Absence("left out", left_out)
    if device == "cuda" or elsewhere:
        return Absence("not run", f"no run of this row on {_KINDS[device]} is stored")
    return Absence("unfinished", stored_seeds(row, found))


def stored_seeds(row: Row, found: RowRuns) -> str:
    """Return how many of a row's seeds are stored, and which failed."""
    text = f"{len(found.runs)} of {len(row.seeds)} seed{'s are' if len(row.seeds) > 1 else ' is'} stored"
    missing = [failure for failure in found.failures if failure.config["seed"] in found.missing_seeds]
    failed = (f"seed {failure.config['seed']} failed: {failure.error}" for failure in missing)
    return one_sentence("; ".join([text, *failed]), sentences=False)


def one_sentence(text: str, sentences: bool = True) -> str:
    """Return the first sentence of a message, cut between words where it is long, without its full stop."""
    line = " ".join(text.split())
    if sentences:
        line = re.split(r"(?<=[.!?;]) ", line, maxsplit=1)[0]
    line = line.rstrip(" .;")
    if len(line) <= LONGEST:
        return line
    cut = line[: LONGEST - 1]
    return (cut[: cut.rfind(" ")] if cut.rfind(" ") > LONGEST // 2 else cut).rstrip(" ,;:") + "…"

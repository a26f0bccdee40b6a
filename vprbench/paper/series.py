"""The runs of one row on one dataset, as figures and the report draw them."""

from __future__ import annotations

from dataclasses import dataclass

from vprbench.run.record import Run


@dataclass(frozen=True)
class Series:
    """Runs of one method that differ in their seed alone, on one dataset, protocol and kind of device."""

    name: str  # the row's, as in the table
    spiking: bool
    runs: tuple[Run, ...]  # one a seed, ascending; at least one

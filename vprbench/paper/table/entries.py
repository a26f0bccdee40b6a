"""What is stored of one row in one column, and which of its runs each cell of the table shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from vprbench.paper.plan import Quantity, Row
from vprbench.paper.selection import Device, Group, RowRuns, accuracy_device
from vprbench.paper.table.cells import Column
from vprbench.run.record import Run

TRAINING: dict[Quantity, Device] = {"train_cpu": "cpu", "train_gpu": "cuda"}
RATES: dict[Quantity, Device] = {"query_cpu": "cpu", "query_gpu": "cuda"}
_DEVICE_OF: dict[Quantity, Device] = {**TRAINING, **RATES}


@dataclass(frozen=True)
class Entry:
    """What is stored of one row in one column."""

    row: Row
    group: Group
    column: Column
    found: Mapping[Device, RowRuns]

    def device(self, quantity: Quantity) -> Device:
        """Return the device whose runs a cell shows."""
        return _DEVICE_OF.get(quantity) or accuracy_device(self.found)

    def runs(self, quantity: Quantity) -> tuple[Run, ...]:
        """Return the runs that a cell shows; of training times, those that trained."""
        there = self.found[self.device(quantity)].runs
        if quantity not in TRAINING:
            return there
        return tuple(run for run in there if run.fit_compute_seconds is not None and self.row.learns_here)

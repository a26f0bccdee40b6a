"""A Table II made by hand: two datasets, five rows, every mark, two machines."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from vprbench.paper.table.cells import Cell, Column, Measured, Table, TableRow
from vprbench.paper.table.quantities import QUANTITIES
from vprbench.paper.table.reasons import Reason

RECALL = 46.62962962962963  # 1259 of 2700 queries
OTHER = "Abacus 9, 2 of 2 cores, torch 2.6.0, 2025-01-31"
NAMES = tuple(quantity.name for quantity in QUANTITIES)
GPU = "Loom 80GB, torch 2.6.0, 2025-02-01"


def measured(value: float, **changes: Any) -> Measured:
    return replace(Measured(value, None, None, None, (0,), None, False, False, 0), **changes)


def cell(mark: Any = "not run", **changes: Any) -> Cell:
    return replace(Cell(mark, None, None, None, "none", None, ()), **changes)


def found(value: float, published: float | None = None, notes: tuple[int, ...] = (), **changes: Any) -> Cell:
    """Return a measured cell, beside what the paper measured where it has this cell."""
    return cell(
        "measured",
        measured=measured(value, **changes),
        published=published,
        published_mark="none" if published is None else "measured",
        difference=None if published is None else changes.get("at_boundary", value) - published,
        notes=notes,
    )


def row(name: str, spiking: bool = False, columns: tuple[str, ...] = ("rail",), **cells: Cell) -> TableRow:
    """Return a row with these cells in its first column, those named column__quantity elsewhere; others did not run."""
    given = {(c, name): cell() for c in columns for name in NAMES}
    for key, value in cells.items():
        column, _, quantity = key.rpartition("__")
        given[column or columns[0], quantity] = value
    return TableRow(name, spiking, given, "encode" if name in ("NetVLAD", "GCL") else "match")


def small(*rows: TableRow, **changes: Any) -> Table:
    """Return a table of one dataset."""
    rail = Column("rail", "Railway", 3300, 2700, "summer against spring and fall", None)
    return replace(Table((rail,), rows, ("Made by hand.",), (), (OTHER,)), **changes)


def told(*texts: str) -> tuple[Reason, ...]:
    return tuple(Reason("note", text) for text in texts)


def paper(value: float | None, mark: Any = "measured") -> Mapping[str, Any]:
    return {"published": value, "published_mark": "not applicable" if value is None else mark}


def table() -> Table:
    """Return the whole table."""
    both = ("rail", "street")
    nothing = paper(None)
    rows = (
        row(
            "SAD",
            columns=both,
            recall_at_1=found(RECALL, 48.0, (1,), low=44.7531, high=48.5153),
            train_cpu=cell("not applicable", **nothing),
            query_cpu=found(11.25, 10.0, (2,), at_boundary=12.5),
            train_gpu=cell("not applicable", **nothing),
            query_gpu=cell("not run", **paper(17.0), notes=(3,)),
            street__recall_at_1=found(41.0, 37.0, (1,), low=36.07, high=46.12, best=True),
            street__train_cpu=cell("not applicable", **nothing),
            street__query_cpu=found(8.04, 185.0, (2,), at_boundary=9.96, disturbed=True),
            street__train_gpu=cell("not applicable", **nothing),
            street__query_gpu=cell("not run", **paper(126.0), notes=(3,)),
        ),
        row(
            "NetVLAD",
            columns=both,
            recall_at_1=cell("left out", **paper(31.0), notes=(4,)),
            train_cpu=cell("quoted", quoted=15120.0, **paper(15120.0, "quoted"), notes=(5,)),
            query_cpu=cell("left out", **paper(0.5), notes=(4,)),
            train_gpu=cell("quoted", quoted=15120.0, **paper(15120.0, "quoted"), notes=(5,)),
            query_gpu=cell("not run", **paper(31.0), notes=(3,)),
            street__recall_at_1=found(30.0, 31.0, (1,), low=25.5, high=34.9),
            street__train_cpu=cell("quoted", quoted=15120.0, **paper(15120.0, "quoted"), notes=(5,)),
            street__query_cpu=found(0.4444, 0.5, (2,), at_boundary=0.4567),
            street__train_gpu=cell("quoted", quoted=15120.0, **paper(15120.0, "quoted"), notes=(5,)),
            street__query_gpu=cell("not run", **paper(14.0), notes=(3,)),
        ),
        row(
            "GCL",
            columns=both,
            **{
                prefix + quantity: cell("not there", **paper(value), notes=(6,))
                for prefix, values in (
                    ("", (32.0, 360.0, 2.0, 360.0, 77.0)),
                    ("street__", (33.0, 360.0, 0.4, 360.0, 75.0)),
                )
                for quantity, value in zip(NAMES, values, strict=True)
            },
        ),
        row(
            "VPRSNN",
            spiking=True,
            columns=both,
            recall_at_1=cell("failed", **paper(53.0), notes=(7,)),
            train_cpu=cell("failed", **paper(360.0), notes=(7,)),
            query_cpu=cell("failed", **paper(2.0), notes=(7,)),
            train_gpu=cell("not applicable", **nothing),
            query_gpu=cell("not applicable", **nothing),
            street__recall_at_1=cell(
                "unfinished",
                measured=measured(38.5, low=33.6, high=43.6),
                **paper(40.0),
                difference=-1.5,
                notes=(1, 8),
            ),
            street__train_cpu=cell("unfinished", **paper(49.0), notes=(8,)),
            street__query_cpu=cell("unfinished", **paper(2.0), notes=(8,)),
            street__train_gpu=cell("not applicable", **nothing),
            street__query_gpu=cell("not applicable", **nothing),
        ),
        row(
            "VPRTempo",
            spiking=True,
            columns=both,
            recall_at_1=found(54.321, 56.0, (1,), low=52.44, high=56.19, spread=1.26, seeds=(0, 1, 2), best=True),
            train_cpu=found(0.3149, 60.0, (2,), total=1.068, seeds=(0, 1, 2), spread=0.0123),
            query_cpu=found(1368.4, 353.0, (2,), at_boundary=1614.96, seeds=(0, 1, 2), spread=20.3, best=True),
            train_gpu=found(0.005234, 1.0, (2,), total=0.7712, machine=1, seeds=(0, 1, 2), spread=0.0001),
            query_gpu=found(20999.5, 1634.0, (2,), at_boundary=22345.6, machine=1, seeds=(0, 1, 2), spread=100.0),
            street__recall_at_1=found(37.0, 37.0, (1,), low=32.17, high=42.1, spread=0.5, seeds=(0, 1, 2)),
            street__train_cpu=found(3.0, 3.0, (2,), total=3.46, seeds=(0, 1, 2), spread=0.05),
            street__query_cpu=found(1500.0, 1670.0, (2,), at_boundary=1670.0, seeds=(0, 1, 2), spread=9.0),
            street__train_gpu=cell("not run", **paper(0.3), notes=(3,)),
            street__query_gpu=cell("not run", **paper(1955.0), notes=(3,)),
        ),
    )
    return Table(
        columns=(
            Column("rail", "Railway (rendered)", 3300, 2700, "summer against spring and fall", "Nordland"),
            Column("street", "City street (rendered)", 450, 360, "dusk against sun and rain", "Oxford RobotCar"),
        ),
        rows=rows,
        caption=("Place recognition on rendered frames, beside what the paper printed.", "These are stand-ins."),
        notes=told(
            "other data: rendered frames stand in for the paper's",
            "other hardware and other data",
            "no run on a GPU is stored",
            "3300 places take too long for this row within the time of the table; set FULL=1",
            "a pre-trained network: its training is quoted from the paper",
            "the weights gcl_resnet152.pth are missing",
            "MemoryError: 99 GB asked for",
            "1 of 3 seeds is stored",
        ),
        machines=(OTHER, GPU),
    )

"""Made-up runs, failures, a plan and tables of them, and how tests look into these; every number is known."""

from dataclasses import replace
from functools import partial
from types import MappingProxyType

import little
import numpy as np
from checkout import ROOT

from vprbench.metrics.ranking import Outcome
from vprbench.report.plan import PLAN_FILE, Column, Plan, Row, read_plan
from vprbench.report.report import Report
from vprbench.report.selection import group_runs_by_column, title_groups
from vprbench.report.table.cells import tabulate
from vprbench.report.table.quantities import QUANTITIES
from vprbench.runs.record import Failure

RAILWAY = {"name": "railway", "places": 10, "seed": 0}
STREET = {"name": "oxford_robotcar", "root": "/here/street", "source": "a shelf", "on_disk": ["root", "source"]}

LOOP = "the paper's rate looks like a loop over the references; ours compares all at once"
SAD = Row("SAD", "sad", boundary="match", training="none", rate_remark=LOOP)
NETVLAD = Row("NetVLAD", "netvlad", boundary="encode", training="pretrained", most_places=5)
VPRSNN = Row("VPRSNN", "vprsnn", boundary="match", spiking=True)
VPRTEMPO = Row("VPRTempo", "vprtempo", boundary="match", spiking=True, seeds=(0, 1, 2))
PUBLIC = Row("VPRTempo (public code)", "vprtempo", boundary="match", spiking=True, arguments={"rules": "reference"})

NORDLAND = Column("nordland", "Nordland", ("dataset=nordland",), "Nordland")
PLANNED = Column("railway", "Railway (rendered)", ("dataset=railway",), "Nordland", stand_in_for="Nordland")
CITY = Column("street", "City street", ("dataset=street",))

PAPER = read_plan(ROOT / "conf" / PLAN_FILE)
PUBLISHED = PAPER.published
ROWS = (SAD, NETVLAD, VPRSNN, VPRTEMPO)

RAIL = replace(PLANNED, dataset=RAILWAY)
TOWN = replace(CITY, dataset=STREET)

ABACUS = {"processor": "Abacus 9", "threads": 1, "cores": 2, "libraries": {"torch": "2.6.0"}}
LOOM = {**ABACUS, "processor": "Loom 3", "cores": 8, "accelerator": "Spindle 80GB"}
NAMES = ("recall_at_1", "train_cpu", "query_cpu", "train_gpu", "query_gpu")


def answers(hits, n_places=10):
    """Return answers whose best place is right where `hits` is 1; where it is 0 the right place stands second."""
    right = np.array(hits, np.int64)
    ones = np.ones(len(right), np.int64)
    return Outcome(np.full(len(right), 0.5, np.float32), ones, right, 1 - right, ones, ones, ones, n_places)


def run(
    method="sad",
    seed=0,
    hits=(1, 1, 0, 0),
    *,
    device="cpu",
    day="2025-03-01",
    changed=MappingProxyType({}),
    dataset=RAILWAY,
    machine=None,
    encode_seconds=(0.010,) * 5,
    match_seconds=(0.0025,) * 5,
    n_places=10,
    config=None,
    **changes,
):
    """Return an undisturbed run; encoding takes 10 ms and matching 2.5 ms, fitting 11.5 s and 12.34 s with images."""
    timing = replace(little.a_run().timing, streaming=little.laps(encode_seconds, match_seconds))
    protocol = {"references": ["spring", "fall"], "query": "summer", "tolerance_places": 0, "places": n_places}
    made = little.a_run(
        method=method,
        dataset=str(dataset["name"]),
        key=f"{method}-{seed}-{device}-{day}",
        config={
            "method": {"_target_": f"made.{method}", "rules": "paper", "max_module": 1100, **changed, "seed": seed},
            **{"dataset": dict(dataset), "seed": seed, "device": device, "code": "c0de"},
            "overrides": [f"method={method}", *(f"method.{name}={changed[name]}" for name in changed)],
            "changed": dict(changed),
            "timing": {"minimum_seconds": 2.0, "minimum_queries": 64, "sample": 256},
            **(config or {}),
        },
        protocol=protocol,
        environment={**(machine or (LOOM if device == "cuda" else ABACUS)), "time_utc": f"{day}T12:00:00Z"},
        **{"notes": (), "search": None, "timing": timing},
        outcome=answers(hits, n_places),
        positives=tuple(np.array([i * n_places // len(hits)]) for i in range(len(hits))),
    )
    return replace(made, **changes)


def failure(method="sad", seed=0, error="out of thread", **changes):
    """Return the failure of such a run, of the next day."""
    day, missing = changes.pop("day", "2025-03-02"), changes.pop("missing", False)
    given = run(method, seed, day=day, **changes)
    return Failure(method, given.dataset, given.config, error, given.environment, missing)


tempo = partial(run, "vprtempo")


def table(runs=(), failures=(), rows=ROWS, asked=(RAIL,), slow=False, quantities=QUANTITIES, title=None):
    published = None if title else PUBLISHED
    plan = Plan(rows=tuple(rows), columns=tuple(asked), published=published, full=not slow, title=title)
    groups = (*title_groups(group_runs_by_column(runs, failures, asked, rows)),)
    cells = tabulate(plan, groups, quantities)._asdict()
    return Report(plan=plan, groups=groups, quantities=quantities, **cells)


def cell(made, row, quantity, column="railway"):
    named = {(each.row, each.column, each.quantity): each for each in made.cells.itertuples()}
    return named[row, column, quantity]


def measured(made, row, quantity, column="railway"):
    found = cell(made, row, quantity, column)
    assert found.seeds is not None
    return found


def notes(made, row, quantity):
    return [made.notes[number - 1] for number in cell(made, row, quantity).notes]


def absences(made, row):
    return [cell(made, row, quantity.name).mark for quantity in QUANTITIES]

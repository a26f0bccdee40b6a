"""Tables of made-up runs, and how tests look into them."""

from stored_runs import PUBLISHED, RAIL, ROWS, run

from vprbench.report.plan import Plan
from vprbench.report.report import Report
from vprbench.report.selection import group_runs_by_column, title_groups
from vprbench.report.table.cells import tabulate
from vprbench.report.table.quantities import QUANTITIES

NAMES = ("recall_at_1", "train_cpu", "query_cpu", "train_gpu", "query_gpu")


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


def tempo(seed=0, **changes):
    return run("vprtempo", seed, **changes)


def absences(made, row):
    return [cell(made, row, quantity.name).mark for quantity in QUANTITIES]

"""The runs of a comparison under corruptions of its query frames: made where they are missing, none of them timed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from vprbench.comparison.checks import Checked
from vprbench.comparison.request import SortedOptions
from vprbench.errors import BadInput
from vprbench.jobs.executors import Executor
from vprbench.jobs.job import JobResult
from vprbench.paper.gather import TablePlan, run_missing, runs_of
from vprbench.paper.plan import Row
from vprbench.paper.stored_runs import Compose
from vprbench.progress import progress_shown
from vprbench.runs.corrupted_frames import corrupted
from vprbench.runs.corruption import Corruption, corruptions
from vprbench.runs.identity import fingerprint

_UNTIMED = ("timing=none", "frames=false")


def under(found: Checked, names: Sequence[str]) -> dict[Corruption, Checked]:
    """Return a comparison under each of the named corruptions; raises BadInput if it has no accuracy to lower."""
    if names and found.dataset is not None and not any(map(len, found.dataset.positives)):
        raise BadInput(f"corruptions={','.join(names)}: no query of {found.dataset.name} has a right place to lose")
    every = {}
    for one in corruptions(names):
        planned = replace(found.column.planned, title=f"{found.column.planned.title}, {one.name}")
        column = replace(found.column, planned=planned, corruption=one.name)
        dataset = None if found.dataset is None else corrupted(found.dataset, one.name)
        with progress_shown(one.name):
            images = "" if dataset is None else fingerprint(dataset)
        every[one] = replace(found, column=column, dataset=dataset, images=images)
    return every


def make_missing(
    chosen: TablePlan,
    rows: Sequence[Row],
    spoilt: dict[Corruption, Checked],
    asked: SortedOptions,
    compose: Compose,
    executor: Executor | None = None,
) -> list[JobResult]:
    """Make the runs that are not stored, on the first device alone; returns how each ended.

    A process fits a row's method once for all corruptions. If it dies, or a run may take `limit_minutes` alone, each
    of the runs has a process.
    """
    once = replace(chosen, devices=chosen.devices[:1])
    options = [option for option in asked.of_runs if option.partition("=")[0].partition(".")[0] != "timing"]
    if not spoilt:
        return []
    options += _UNTIMED
    names = tuple(each.name for each in spoilt)
    first = next(iter(spoilt.values())).column
    title = f"{first.dataset['name']}, {len(names)} corruptions"
    column = replace(first, planned=replace(first.planned, title=title))
    together = [replace(run, corruption=names) for row in rows for run in runs_of(once, column, [row])]
    if any(option.startswith("limit_minutes=") for option in options):
        return run_missing(once, [one for run in together for one in run.each()], options, compose, executor)
    endings = run_missing(once, together, options, compose, executor)
    died = [run for run, ending in zip(together, endings, strict=True) if ending.code == 1]
    alone = run_missing(once, [one for run in died for one in run.each()], options, compose, executor)
    return [*(ending for ending in endings if ending.code != 1), *alone]

"""Which stored runs belong to which column and row, and the titles of the columns."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

from vprbench.report.plan import Column, Row
from vprbench.runs.machine import Machine
from vprbench.runs.record import Failure, Run
from vprbench.runs.rows import format_value
from vprbench.runs.sequences import NoScoresError, Views, format_view_suffix
from vprbench.runs.viewpoints import parse_viewpoints

Device = Literal["cpu", "cuda"]
DEVICES: tuple[Device, ...] = ("cpu", "cuda")

Result = TypeVar("Result", Run, Failure)

_PER_RUN = ("_target_", "seed", "device")  # arguments of a method in which the runs of a row differ
_COUNTS = {"places", "query_places", "reference_places"}  # of a protocol, which follow from the rest of it


@dataclass(frozen=True)
class DatasetRuns:
    """The runs of one column that answer the same question: one protocol, the same images and ground truth."""

    column: Column
    number: int  # 1 holds the newest run of the column; older protocols and images are numbered on
    runs: tuple[Run, ...]  # of all rows, devices and seeds
    failures: tuple[Failure, ...]  # all in number 1, for a failure has no images
    view: str = ""  # in the names of files, where runs are shown in a view
    title: str = ""  # for people, different from that of other groups

    @property
    def name(self) -> str:
        """The name of the group in columns and files."""
        return "-".join(filter(None, [self.column.name, self.view, str(self.number) * (self.number > 1)]))

    @property
    def data(self) -> str:
        """Places, queries and protocol in one line."""
        facts = ["no run is stored"]
        if self.runs:
            run = self.runs[0]
            facts = [f"{run.outcome.n_places:,} places", f"{len(run.outcome):,} queries", describe_protocol(run)]
        facts += [f"stands in for {self.column.stand_in_for}"] if self.column.stand_in_for else []
        return "; ".join(filter(None, facts))


@dataclass(frozen=True)
class MethodRuns:
    """Runs of one row that differ in their seed alone, on one dataset, protocol and kind of device."""

    name: str  # the row's, as in the table
    runs: tuple[Run, ...]  # one a seed, ascending
    missing_seeds: tuple[int, ...] = ()
    failures: tuple[Failure, ...] = ()  # the newest of each missing seed, ascending
    n_aside: int = 0  # stored runs that are not shown: of other code or settings, older, or of other seeds

    @property
    def coverage(self) -> tuple[int, int]:
        """How many seeds have a run, and how many a failure; accuracies are of the device with the most."""
        return len(self.runs), len(self.failures)


def group_runs_by_column(
    runs: Iterable[Run], failures: Iterable[Failure], columns: Sequence[Column], rows: Sequence[Row]
) -> list[DatasetRuns]:
    """Put runs and failures of the rows into the columns, in the columns' order.

    A column gives one group for each protocol and version of its images, the one with the newest run first, and an
    empty group where it has no run. The order of `runs` changes nothing.
    """

    def select(results: Iterable[Result], column: Column) -> list[Result]:
        inside = [one for one in results if _belongs_to_column(one, column)]
        return [one for one in inside if any(_belongs_to_row(one, row) for row in rows)]

    runs, failures, found = [*runs], [*failures], list[DatasetRuns]()
    for column in columns:
        failed = sorted(select(failures, column), key=lambda one: (one.method, get_time(one), one.error))
        for number, members in enumerate(_split_by_frames(select(runs, column)) or [()], 1):
            found.append(DatasetRuns(column, number, members, tuple(failed) if number == 1 else ()))
    return found


def _split_by_frames(runs: Iterable[Run]) -> list[tuple[Run, ...]]:
    """Return the runs of each protocol and version of the images, the set with the newest run first."""
    alike: dict[str, list[Run]] = defaultdict(list)
    for run in sorted(runs, key=lambda run: (run.dataset, run.method, *get_sort_key(run))):
        alike[f"{format_plain_values(run.protocol)} {run.fingerprint}"].append(run)
    newest_first = sorted(alike.items(), key=lambda item: (max(map(get_time, item[1])), item[0]), reverse=True)
    return [tuple(members) for _, members in newest_first]


def select_row_runs(group: DatasetRuns, row: Row, device: Device | None) -> MethodRuns:
    """Return one run per seed, all made by the same code, settings and machine.

    Runs that differ in code, defaults, weights, libraries, threads or machine are never put together. Of such sets the
    complete ones come first, then sets that trained instead of loading, then the one with the newest run; all other
    runs are counted. A seed without a run has its newest failure. Without a `device` it is that of the most seeds, of
    equals the CPU; without any run that of a failure.
    """
    if device is None:
        return max((select_row_runs(group, row, each) for each in DEVICES), key=lambda found: found.coverage)

    def select(results: Sequence[Result]) -> list[Result]:
        return [each for each in results if _belongs_to_row(each, row) and _get_device(each) == device]

    def rank(members: Sequence[Run]) -> tuple[bool, bool, tuple[str, str]]:
        is_complete = {run.config["seed"] for run in members} >= {*row.seeds}
        return is_complete, members[0].network is None, get_sort_key(members[-1])

    there = select(group.runs)
    sets: dict[str, list[Run]] = defaultdict(list)
    for run in sorted(there, key=get_sort_key):
        if run.config["seed"] in row.seeds:
            sets[format_plain_values([list_conditions(run), run.network is None])].append(run)
    chosen = {run.config["seed"]: run for run in max(sets.values(), key=rank, default=[])}
    failed = {failure.config["seed"]: failure for failure in select(group.failures)}
    missing = tuple(seed for seed in row.seeds if seed not in chosen)
    return MethodRuns(
        row.name,
        tuple(run for _, run in sorted(chosen.items())),
        missing,
        tuple(failed[seed] for seed in missing if seed in failed),
        len(there) - len(chosen),
    )


def list_method_runs(group: DatasetRuns, rows: Sequence[Row], device: Device | None = None) -> list[MethodRuns]:
    """Return the rows of a group that have runs on a kind of device, None: on that of their accuracy."""
    found = (select_row_runs(group, row, device) for row in rows)
    return [one for one in found if one.runs]


def _belongs_to_column(result: Run | Failure, column: Column) -> bool:
    """Tell whether a run has the dataset, corruption and viewpoints of a column.

    A run is compared by the condition of the column. Without one, and for a failure, all options count that both have,
    except places on disk (`on_disk` in the dataset's yaml): a dataset gains and loses options over time.
    """
    given = result.config
    if given.get("corruption") != column.corruption:
        return False
    if parse_viewpoints(given.get("views")) != parse_viewpoints(column.views):
        return False
    if isinstance(result, Run) and column.condition is not None:
        threads = result.environment.get("threads")
        return column.condition == describe_condition(result.fingerprint, result.protocol, threads)
    ours, theirs = column.dataset, {"name": result.dataset, **given.get("dataset", {})}
    ignored = {"_target_", "on_disk", *ours.get("on_disk", ()), *theirs.get("on_disk", ())}
    both = ours.keys() & theirs.keys() - ignored
    return "name" in both and all(format_plain_values(ours[name]) == format_plain_values(theirs[name]) for name in both)


def _belongs_to_row(result: Run | Failure, row: Row) -> bool:
    """Tell whether a run's method has a row's arguments and otherwise its defaults."""
    wanted, changed = row.arguments, result.config["changed"]
    if result.method != row.method or not changed.keys() <= wanted.keys():
        return False
    given = {**result.config["method"], **changed}
    return all(
        name in given and format_plain_values(given[name]) == format_plain_values(wanted[name]) for name in wanted
    )


def describe_condition(fingerprint: str, protocol: Mapping[str, Any], threads: int | None) -> str:
    """Return the frames, places and threads of a run as text that is the same for equal ones."""
    return format_plain_values([fingerprint, protocol, threads])


def _get_device(result: Run | Failure) -> str:
    return str(result.config.get("device", "cpu")).partition(":")[0]


def get_time(result: Run | Failure) -> str:
    """Return when a run or a failure was made, in UTC; empty if that is not known."""
    return str(result.environment.get("time_utc") or "")


def get_sort_key(run: Run) -> tuple[str, str]:
    """Return the key that sorts runs from the oldest to the newest."""
    return get_time(run), run.key


def list_conditions(run: Run) -> dict[str, Any]:
    """Return the conditions that must be equal for the runs of a row to be put together."""
    return {
        **{name: run.config.get(name) for name in ("code", "files")},
        **{name: run.environment.get(name) for name in ("libraries", "threads")},
        "method": {name: value for name, value in run.config["method"].items() if name not in _PER_RUN},
        "machine": Machine.of(run.environment).hardware,
    }


def format_plain_values(value: Any) -> str:
    """Return plain values as text that is the same for equal ones: order and tuples for lists make no difference."""
    return json.dumps(value, sort_keys=True, default=dict)


def apply_views(groups: Sequence[DatasetRuns], rows: Sequence[Row], views: Sequence[Views]) -> list[DatasetRuns]:
    """Return a group for each view of each group, of the runs that its rows show; without views the groups themselves.

    A run that kept no scores is a failure there, which names the remedy. Of several views none keeps its scores, which
    may fill the memory. Raises NoScoresError where no run of any group kept scores.
    """
    found: list[DatasetRuns] = []
    lacking: list[NoScoresError] = []
    for group in groups if views else ():
        shown_runs = (select_row_runs(group, row, device).runs for row in rows for device in DEVICES)
        chosen = {run.key: run for runs in shown_runs for run in runs}
        of_views: list[DatasetRuns] = []
        for view in views:
            shown: list[Run] = []
            failures = [*group.failures]
            for run in chosen.values():
                try:
                    one = view(run)
                    shown.append(one if len(views) == 1 else replace(one, scores=None))
                except NoScoresError as error:
                    failures.append(Failure(run.method, run.dataset, run.config, str(error), run.environment, True))
                    lacking.append(error)
            of_views.append(
                replace(group, runs=tuple(shown), failures=tuple(failures), view=format_view_suffix([view])[1:])
            )
        found += [one for one in of_views if one.runs] or [replace(of_views[0], view="")]
    if lacking and not any(group.runs for group in found):
        raise lacking[0]
    return found if views else [*groups]


def title_groups(groups: Sequence[DatasetRuns]) -> Iterator[DatasetRuns]:
    """Yield groups with their titles: that of the column, and parts of their protocols where several have it."""
    titles = [group.column.title for group in groups]
    protocols = [group.runs[0].protocol if group.runs else {} for group in groups]
    for title in {*titles}:
        alike = [number for number, each in enumerate(titles) if each == title]
        for name in dict.fromkeys(part for number in alike for part in protocols[number]):
            values = [protocols[number].get(name) for number in alike]
            if len({titles[number] for number in alike}) < len(alike) and any(value != values[0] for value in values):
                for number, value in zip(alike, values, strict=True):
                    titles[number] += f", {name.replace('_', ' ')} {format_value(value)}"
    for number, group in enumerate(groups):
        version = titles[: number + 1].count(titles[number])
        yield replace(group, title=f"{titles[number]}, version {version}" if version > 1 else titles[number])


def describe_protocol(run: Run) -> str:
    """Return the protocol of a run in words, without counts that follow from the rest of it."""
    follows = {*_COUNTS, *(["held_out_places"] if "first_query_place" in run.protocol else [])}
    shown = {name: value for name, value in run.protocol.items() if name not in follows}
    return ", ".join(f"{name.replace('_', ' ')} {format_value(value)}" for name, value in shown.items())

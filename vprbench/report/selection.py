"""Which stored runs belong to which column and row, and the titles of the columns."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

from vprbench.report.plan import PlannedColumn, Row
from vprbench.runs.machine import Machine
from vprbench.runs.record import Failure, Run
from vprbench.runs.rows import describe_sequence, format_value
from vprbench.runs.sequences import NoScoresError, Views, name_views
from vprbench.runs.viewpoints import parse_viewpoints

Device = Literal["cpu", "cuda"]
DEVICES: tuple[Device, ...] = ("cpu", "cuda")

Result = TypeVar("Result", Run, Failure)

_PER_RUN = ("_target_", "seed", "device")  # arguments of a method in which the runs of a row differ


@dataclass(frozen=True)
class ResolvedColumn:
    """A column of the table and the arguments of its dataset."""

    planned: PlannedColumn
    dataset: Mapping[str, Any]  # the resolved arguments of the dataset, as a run's configuration holds them
    corruption: str | list[str] | None = None  # of the query frames; None: they are clean
    views: Any = None  # the option that says from which viewpoints queries are asked
    frames: str | None = None  # runs of these frames alone belong to it (`describe_frames`); None: of these arguments


@dataclass(frozen=True)
class DatasetRuns:
    """The runs of one column that answer the same question: one protocol, the same images and ground truth."""

    column: ResolvedColumn
    number: int  # 1 holds the newest run of the column; older protocols and images are numbered on
    runs: tuple[Run, ...]  # of all rows, devices and seeds
    failures: tuple[Failure, ...]  # all in number 1, for a failure has no images
    view: str = ""  # in the names of files, where runs are shown in a view

    @property
    def name(self) -> str:
        """The name of the group in columns and files."""
        return "-".join(filter(None, [self.column.planned.name, self.view, str(self.number) * (self.number > 1)]))


@dataclass(frozen=True)
class RowRuns:
    """The runs of one row in one column on one kind of device, alike in all but their seed."""

    runs: tuple[Run, ...]  # one a seed, ascending
    n_aside: int  # stored runs that are not shown: of other code or settings, older, or of other seeds
    missing_seeds: tuple[int, ...]
    failures: tuple[Failure, ...]  # the newest of each missing seed, ascending


@dataclass(frozen=True)
class MethodRuns:
    """Runs of one method that differ in their seed alone, on one dataset, protocol and kind of device."""

    name: str  # the row's, as in the table
    spiking: bool
    runs: tuple[Run, ...]  # one a seed, ascending; at least one


def group_runs_by_column(
    runs: Iterable[Run], failures: Iterable[Failure], columns: Sequence[ResolvedColumn], rows: Sequence[Row]
) -> list[DatasetRuns]:
    """Put runs and failures of the rows into the columns, in the columns' order.

    A column gives one group for each protocol and version of its images, the one with the newest run first, and an
    empty group where it has no run. The order of `runs` changes nothing.
    """

    def select(results: Iterable[Result]) -> list[Result]:
        return [one for one in results if any(_belongs_to_row(one, row) for row in rows)]

    runs, failures, found = select(runs), select(failures), list[DatasetRuns]()
    for column in columns:
        sets = split_by_frames(run for run in runs if _belongs_to_column(run, column))
        failed = [failure for failure in failures if _belongs_to_column(failure, column)]
        found += number_groups([column] * max(1, len(sets)), sets or [()], failed)
    return found


def number_groups(
    columns: Sequence[ResolvedColumn], sets: Sequence[tuple[Run, ...]], failures: Iterable[Failure]
) -> Iterator[DatasetRuns]:
    """Yield a group for each set of runs in its column; failures, which have no frames, stand in the first."""
    failed = tuple(sorted(failures, key=lambda failure: (failure.method, get_time(failure), failure.error)))
    for number, (column, members) in enumerate(zip(columns, sets, strict=True), 1):
        yield DatasetRuns(column, number, members, failed if number == 1 else ())


def split_by_frames(runs: Iterable[Run]) -> list[tuple[Run, ...]]:
    """Return the runs of each protocol and version of the images, the set with the newest run first.

    The order of `runs` changes nothing.
    """
    alike: dict[str, list[Run]] = defaultdict(list)
    for run in sorted(runs, key=lambda run: (run.dataset, run.method, *get_sort_key(run))):
        alike[f"{format_plain_values(run.protocol)} {run.fingerprint}"].append(run)
    newest_first = sorted(alike.items(), key=lambda item: (max(map(get_time, item[1])), item[0]), reverse=True)
    return [tuple(members) for _, members in newest_first]


def describe_frames(fingerprint: str, protocol: Mapping[str, Any], threads: int | None) -> str:
    """Return the frames, places and threads of a run as text that is the same for equal ones."""
    return format_plain_values([fingerprint, protocol, threads])


def select_row_runs(group: DatasetRuns, row: Row, device: Device) -> RowRuns:
    """Return one run per seed, all made by the same code, settings and machine.

    Runs that differ in code, defaults, weights, libraries, threads or machine are never put together. Of such sets the
    complete ones come first, then sets that trained instead of loading, then the one with the newest run; all other
    runs are counted. A seed without a run has its newest failure.
    """

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
    return RowRuns(
        runs=tuple(run for _, run in sorted(chosen.items())),
        n_aside=len(there) - len(chosen),
        missing_seeds=missing,
        failures=tuple(failed[seed] for seed in missing if seed in failed),
    )


def list_method_runs(group: DatasetRuns, rows: Sequence[Row], device: Device | None = "cpu") -> list[MethodRuns]:
    """Return the rows of a group that have runs on a kind of device, None: on that of their accuracy."""
    found = []
    for row in rows:
        devices = {each: select_row_runs(group, row, each) for each in DEVICES}
        runs = devices[device or choose_accuracy_device(devices)].runs
        found += [MethodRuns(row.name, row.spiking, runs)] if runs else []
    return found


def list_accuracy_runs(group: DatasetRuns, rows: Sequence[Row]) -> list[MethodRuns]:
    """Return the rows of a group that have runs, each from the device that the table takes its R@1 from."""
    return list_method_runs(group, rows, None)


def choose_accuracy_device(found: Mapping[Device, RowRuns]) -> Device:
    """Return the device of a row's accuracy: that with the most seeds, of equals the CPU; without any, of a failure."""
    return max(DEVICES, key=lambda device: (len(found[device].runs), len(found[device].failures)))


def _belongs_to_column(result: Run | Failure, column: ResolvedColumn) -> bool:
    """Tell whether a run has the dataset, corruption and viewpoints of a column.

    A run is compared by the frames of the column. Without these, and for a failure, all options count that both have,
    except places on disk (`on_disk` in the dataset's yaml): a dataset gains and loses options over time.
    """
    given = result.config
    if given.get("corruption") != column.corruption:
        return False
    if parse_viewpoints(given.get("views")) != parse_viewpoints(column.views):
        return False
    if isinstance(result, Run) and column.frames is not None:
        return column.frames == describe_frames(result.fingerprint, result.protocol, result.environment.get("threads"))
    ours, theirs = column.dataset, given.get("dataset", {})
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
        chosen = {
            run.key: run for row in rows for device in DEVICES for run in select_row_runs(group, row, device).runs
        }
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
            of_views.append(replace(group, runs=tuple(shown), failures=tuple(failures), view=name_views([view])[1:]))
        found += [one for one in of_views if one.runs] or [replace(of_views[0], view="")]
    if lacking and not any(group.runs for group in found):
        raise lacking[0]
    return found if views else [*groups]


def format_title(group: DatasetRuns, among: Sequence[DatasetRuns]) -> str:
    """Return the title of a group's column; of several of one title, with its view and its number from the newest."""
    planned = group.column.planned
    if sum(other.column.planned.title == planned.title for other in among if other.runs) < 2:
        return planned.title
    version = f"version {group.number}" if group.number > 1 else ""
    return ", ".join(filter(None, [planned.title, describe_sequence(group.runs[0]), version]))


def describe_protocol(run: Run) -> str:
    """Return the protocol of a run in words, without counts that follow from the rest of it."""
    follows = {"places", "query_places", "reference_places"}
    follows |= {"held_out_places"} if "first_query_place" in run.protocol else set()
    shown = {name: value for name, value in run.protocol.items() if name not in follows}
    return ", ".join(f"{name.replace('_', ' ')} {format_value(value)}" for name, value in shown.items())

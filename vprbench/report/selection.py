"""Which stored runs belong to which column and row, and the titles of the columns."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from vprbench.report.plan import PlannedColumn, Row
from vprbench.runs.machine import Machine
from vprbench.runs.record import Failure, Run
from vprbench.runs.sequences import NoScoresError, Views, name_views
from vprbench.runs.viewpoints import parse_viewpoints

Device = Literal["cpu", "cuda"]
DEVICES: tuple[Device, ...] = ("cpu", "cuda")

_PER_RUN = frozenset({"_target_", "seed", "device"})  # arguments of a method in which the runs of a row differ


@dataclass(frozen=True)
class Frames:
    """The frames, places and threads of the runs of a column whose dataset was built."""

    fingerprint: str
    protocol: Mapping[str, Any]
    threads: int


@dataclass(frozen=True)
class ResolvedColumn:
    """A column of the table and the arguments of its dataset."""

    planned: PlannedColumn
    dataset: Mapping[str, Any]  # the resolved arguments of the dataset, as a run's configuration holds them
    corruption: str | list[str] | None = None  # of the query frames; None: they are clean
    views: Any = None  # the option that says from which viewpoints queries are asked
    frames: Frames | None = None  # runs of these frames alone belong to it; None: runs with these arguments


@dataclass(frozen=True)
class Group:
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
    failures: tuple[Failure, ...]  # one a seed, ascending: of missing seeds, and errors since the seed's run


@dataclass(frozen=True)
class Series:
    """Runs of one method that differ in their seed alone, on one dataset, protocol and kind of device."""

    name: str  # the row's, as in the table
    spiking: bool
    runs: tuple[Run, ...]  # one a seed, ascending; at least one


def groups(
    runs: Iterable[Run], failures: Iterable[Failure], columns: Sequence[ResolvedColumn], rows: Sequence[Row]
) -> list[Group]:
    """Put runs and failures of the rows into the columns, in the columns' order.

    A column gives one group for each protocol and version of its images, the one with the newest run first, and an
    empty group where it has no run. A dataset gains and loses options over time: runs are taken by the options that
    both have, and other differences show in their protocol. The order of `runs` changes nothing.
    """
    ordered = sorted(runs, key=lambda run: (run.dataset, run.method, get_time(run), run.key))
    failed = sorted(failures, key=lambda failure: (failure.method, get_time(failure), failure.error))
    found: list[Group] = []
    for column in columns:
        alike: dict[str, list[Run]] = defaultdict(list)
        for run in ordered:
            if _belongs_to_column(run, column) and any(_belongs_to_row(run, row) for row in rows):
                alike[f"{as_text(run.protocol)} {run.fingerprint}"].append(run)
        newest_first = sorted(alike.items(), key=lambda item: (max(map(get_time, item[1])), item[0]), reverse=True)
        there = tuple(f for f in failed if _belongs_to_column(f, column) and any(_belongs_to_row(f, r) for r in rows))
        found += [
            Group(column, number, tuple(members), there if number == 1 else ())
            for number, (_, members) in enumerate(newest_first or [("", [])], 1)
        ]
    return found


def of_row(group: Group, row: Row, device: Device) -> RowRuns:
    """Return one run per seed, all made by the same code, settings and machine.

    Runs that differ in code, defaults, weights, libraries, threads or machine are never put together.
    Of such sets the complete ones come first, then sets that trained instead of loading, then the one with the newest
    run; all other runs are counted. Of a row with runs, failures from other machines are ignored, and "missing"
    failures of seeds that have a run.
    """
    there = [run for run in group.runs if _belongs_to_row(run, row) and _get_device(run) == device]
    sets: dict[str, list[Run]] = defaultdict(list)
    for run in there:
        if run.config["seed"] in row.seeds:
            sets[as_text([conditions(run), run.network is None])].append(run)
    members = max(sets.values(), key=lambda members: _rank(members, row), default=[])
    chosen = {run.config["seed"]: run for run in sorted(members, key=age)}
    newest: dict[int, Failure] = {}
    for failure in group.failures:
        seed = failure.config["seed"]
        if seed not in row.seeds or not _belongs_to_row(failure, row) or _get_device(failure) != device:
            continue
        is_mended = seed in chosen and (failure.missing or get_time(failure) <= get_time(chosen[seed]))
        if not is_mended and (not members or _machine(failure) == _machine(members[0])):
            newest[seed] = failure
    return RowRuns(
        runs=tuple(run for _, run in sorted(chosen.items())),
        n_aside=len(there) - len(chosen),
        missing_seeds=tuple(seed for seed in row.seeds if seed not in chosen),
        failures=tuple(failure for _, failure in sorted(newest.items())),
    )


def series(group: Group, rows: Sequence[Row], device: Device = "cpu") -> list[Series]:
    """Return the rows of a group that have runs on a kind of device, as figures draw them."""
    found = ((row, of_row(group, row, device).runs) for row in rows)
    return [Series(row.name, row.spiking, runs) for row, runs in found if runs]


def accuracy_device(found: Mapping[Device, RowRuns]) -> Device:
    """Return the device that a row's accuracy is taken from: that with the most seeds, of equals the CPU.

    Where none has a run, it is the one whose failure says why.
    """

    def known(device: Device) -> tuple[int, bool]:
        there = found[device]
        return len(there.runs), not there.runs and bool(there.failures)

    return max(DEVICES, key=known)


def accuracy_series(group: Group, rows: Sequence[Row]) -> list[Series]:
    """Return the rows of a group that have runs, each from the device that the table takes its R@1 from."""
    found = [(row, {device: of_row(group, row, device) for device in DEVICES}) for row in rows]
    taken = ((row, devices[accuracy_device(devices)].runs) for row, devices in found)
    return [Series(row.name, row.spiking, runs) for row, runs in taken if runs]


def _belongs_to_column(result: Run | Failure, column: ResolvedColumn) -> bool:
    """Tell whether a run has the dataset, corruption and viewpoints of a column.

    A run is compared by the frames of the column. Without these, and for a failure, all options count that both have,
    except places on disk (`on_disk` in the dataset's yaml).
    """
    given = result.config
    if given.get("corruption") != column.corruption or parse_viewpoints(given.get("views")) != parse_viewpoints(
        column.views
    ):
        return False
    if isinstance(result, Run) and (frames := column.frames) is not None:
        alike = result.fingerprint == frames.fingerprint and as_text(result.protocol) == as_text(frames.protocol)
        return alike and result.environment.get("threads") == frames.threads
    wanted, theirs = column.dataset, given.get("dataset", {})
    ignored = {"_target_", "on_disk", *wanted.get("on_disk", ()), *theirs.get("on_disk", ())}
    both = wanted.keys() & theirs.keys() - ignored
    return "name" in both and all(as_text(wanted[name]) == as_text(theirs[name]) for name in both)


def _belongs_to_row(result: Run | Failure, row: Row) -> bool:
    """Tell whether a run's method has a row's arguments and otherwise its defaults."""
    if result.method != row.method:
        return False
    wanted, changed = row.arguments, result.config["changed"]
    given = {**result.config["method"], **changed}
    return changed.keys() <= wanted.keys() and all(
        name in given and as_text(given[name]) == as_text(value) for name, value in wanted.items()
    )


def _get_device(result: Run | Failure) -> str:
    return str(result.config.get("device", "cpu")).partition(":")[0]


def get_time(result: Run | Failure) -> str:
    """Return when a run or a failure was made, in UTC; empty if that is not known."""
    return str(result.environment.get("time_utc") or "")


def age(run: Run) -> tuple[str, str]:
    """Return the key that sorts runs from the oldest to the newest."""
    return get_time(run), run.key


def conditions(run: Run) -> dict[str, Any]:
    """Return the conditions that must be equal for the runs of a row to be put together."""
    given, surroundings = run.config, run.environment
    return {
        **{name: given.get(name) for name in ("code", "files")},
        **{name: surroundings.get(name) for name in ("libraries", "threads")},
        "method": {name: value for name, value in given["method"].items() if name not in _PER_RUN},
        "machine": _machine(run),
    }


def _rank(members: Sequence[Run], row: Row) -> tuple[bool, bool, tuple[str, str]]:
    complete = {run.config["seed"] for run in members} >= set(row.seeds)
    return complete, members[0].network is None, max(map(age, members))


def _machine(result: Run | Failure) -> tuple[Any, ...]:
    return Machine.of(result.environment).hardware


def as_text(value: Any) -> str:
    """Return plain values as text that is the same for equal ones: order, tuples and 2.0 for 2 make no difference."""
    return json.dumps(_simplify(value), sort_keys=True)


def _simplify(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(name): _simplify(inner) for name, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_simplify(inner) for inner in value]
    return int(value) if isinstance(value, float) and value.is_integer() else value


def apply_views(groups: Sequence[Group], rows: Sequence[Row], views: Sequence[Views]) -> list[Group]:
    """Return a group for each view of each group, of the runs that its rows show; without views the groups themselves.

    A run that kept no scores is a failure there, which names the remedy. Of several views none keeps its scores, which
    may fill the memory. Raises NoScoresError where no run of any group kept scores.
    """
    if not views:
        return list(groups)
    found: list[Group] = []
    lacking: list[NoScoresError] = []
    for group in groups:
        chosen = {run.key: run for row in rows for device in DEVICES for run in of_row(group, row, device).runs}
        of_views: list[Group] = []
        for view in views:
            shown: list[Run] = []
            failures = list(group.failures)
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
    return found


def title(group: Group, among: Sequence[Group]) -> str:
    """Return the title of a group's column; of several, with its protocol if that differs, or else its images."""
    planned = group.column.planned
    versions = [other for other in among if other.column.planned.name == planned.name and other.runs]
    if len(versions) < 2:
        return planned.title
    protocols = [_stated_protocol(other.runs[0]) for other in versions]
    names = dict.fromkeys(n for p in protocols for n in p if not n.startswith(("sequence_", "filter_")))  # as of views
    differing = [name for name in names if any(p.get(name) != protocols[0].get(name) for p in protocols)]
    parts = [_describe_parts({name: p[name] for name in differing if name in p}) for p in protocols]
    mine = parts[next(i for i, other in enumerate(versions) if other is group)]
    images = "" if mine and parts.count(mine) == 1 else f"images {group.runs[0].fingerprint[:8]}"
    return ", ".join(filter(None, [planned.title, mine, images]))


def describe_protocol(run: Run) -> str:
    """Return the protocol of a run in words, without the numbers of its places and queries."""
    return _describe_parts(
        {name: value for name, value in _stated_protocol(run).items() if name not in ("places", "query_places")}
    )


def _stated_protocol(run: Run) -> dict[str, Any]:
    """Return the protocol of a run without counts that follow from the rest of it."""
    follows = {"reference_places"} | ({"held_out_places"} if "first_query_place" in run.protocol else set())
    return {name: value for name, value in run.protocol.items() if name not in follows}


def _describe_parts(protocol: Mapping[str, Any]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {_format_part(value)}" for name, value in protocol.items())


def _format_part(value: Any) -> str:
    if isinstance(value, Mapping):
        return "+".join(f"{inner} in {name}" for name, inner in value.items())
    return "+".join(map(str, value)) if isinstance(value, list | tuple) else str(value)

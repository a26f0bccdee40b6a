"""Runs belong to the column and row they were asked for, and only equals stand together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import pytest
from stored_runs import ABACUS, LOOM, PUBLIC, RAIL, RAILWAY, SAD, STREET, TOWN, VPRTEMPO, failure, run

from vprbench.paper.plan import Row
from vprbench.paper.selection import (
    Aside,
    Group,
    ResolvedColumn,
    RowRuns,
    accuracy_series,
    groups,
    of_row,
    options_apart,
    series,
)
from vprbench.paper.titles import protocol_words
from vprbench.run.record import Failure, Run

ROWS = (SAD, VPRTEMPO, PUBLIC)


def only(group: list[Group]) -> Group:
    (one,) = group
    return one


def tempo(seed: int = 0, **changes: Any) -> Run:
    return run("vprtempo", seed, **changes)


def stored_of(row: Row, *runs: Run, failures: Sequence[Failure] = (), column: ResolvedColumn = RAIL) -> RowRuns:
    return of_row(Group(column, 1, runs, tuple(failures)), row, "cpu")


def test_runs_belong_to_the_column_with_their_dataset_wherever_its_frames_lay() -> None:
    elsewhere = run(
        dataset={**STREET, "root": "/there", "source": "a shop", "_target_": "moved.street"}, fingerprint="s"
    )
    larger = run(dataset={**RAILWAY, "places": 20})
    mine = run()
    rail, town = groups([larger, elsewhere, mine], [], [RAIL, TOWN], ROWS)
    assert rail.runs == (mine,)
    assert town.runs == (elsewhere,)


def test_lists_and_tuples_and_whole_numbers_of_either_kind_are_the_same_dataset() -> None:
    asked = ResolvedColumn(RAIL.planned, {"name": "r", "references": ("a", "b"), "places": 10})
    stored = run(dataset={"places": 10.0, "references": ["a", "b"], "name": "r"})
    assert only(groups([stored], [], [asked], ROWS)).runs == (stored,)


def test_options_that_a_dataset_gained_or_lost_keep_no_run_from_its_column() -> None:
    gained = ResolvedColumn(RAIL.planned, {**RAILWAY, "fog": 0.5})
    older_run, todays = run(), run("vprtempo", dataset={**RAILWAY, "fog": 0.5})
    other_fog = run(dataset={**RAILWAY, "fog": 0.9})
    both = only(groups([older_run, todays, other_fog], [], [gained], ROWS))
    assert both.runs == (older_run, todays)
    assert only(groups([older_run, todays], [failure()], [RAIL], ROWS)).runs == (older_run, todays)
    assert options_apart(both) == ()


def test_corrupted_queries_stand_in_no_column_of_clean_ones_nor_of_other_corruptions() -> None:
    shift, noise = (replace(RAIL, corruption=name) for name in ("shift-1", "noise-2"))
    clean, moved = run(config={"corruption": None}), run(config={"corruption": "shift-1"}, day="2025-09-09")
    failed = failure("vprtempo", config={"corruption": "noise-2"})
    found = groups([clean, moved], [failed], [RAIL, shift, noise], ROWS)
    assert [(group.runs, group.failures) for group in found] == [((clean,), ()), ((moved,), ()), ((), (failed,))]


def test_another_dataset_is_none_of_a_column_whatever_options_they_share() -> None:
    asked = [run(dataset={"name": "riverside"}), run(dataset={**RAILWAY, "name": "riverside"})]
    failed = replace(failure(), config={**failure().config, "dataset": {}})
    assert only(groups(asked, [failed], [RAIL], ROWS)) == Group(RAIL, 1, (), ())


def test_runs_of_other_options_in_a_group_of_their_own_are_told_by_these() -> None:
    gained = ResolvedColumn(RAIL.planned, {**RAILWAY, "fog": 0.5, "root": None})
    before = run(dataset={**RAILWAY, "snow": True}, protocol={"renderer": 1}, day="2025-01-01")
    todays = run(dataset={**RAILWAY, "fog": 0.5}, protocol={"renderer": 2})
    assert [options_apart(group) for group in groups([before, todays], [], [gained], ROWS)] == [(), ("fog", "snow")]
    assert options_apart(Group(RAIL, 1, (), ())) == ()


def test_two_protocols_are_two_groups_the_newest_first() -> None:
    old = run(protocol={"query": "summer", "renderer": 1}, day="2025-02-01")
    new = run("vprtempo", protocol={"query": "summer", "renderer": 2}, day="2025-02-02")
    no_row = run("hog", protocol={"query": "night"}, day="2025-06-01")
    failed = failure()
    found = groups([old, no_row, new], [failed], [RAIL], ROWS)
    assert found == [Group(RAIL, 1, (new,), (failed,)), Group(RAIL, 2, (old,), ())]
    images = run(), run(fingerprint="0" * 64)
    assert [group.runs for group in groups(images, [], [RAIL], ROWS)] == [(images[0],), (images[1],)]


@pytest.mark.parametrize(
    ("changed", "row"),
    [({}, VPRTEMPO), ({"rules": "reference"}, PUBLIC), ({"rules": "v1"}, None), ({"epochs": 9}, None)],
)
def test_a_run_belongs_to_the_row_with_its_arguments(changed: dict[str, Any], row: Row | None) -> None:
    group = Group(RAIL, 1, (tempo(changed=changed),), ())
    assert [each for each in ROWS if of_row(group, each, "cpu").runs] == ([row] if row else [])


def test_the_arguments_that_a_size_needs_are_part_of_the_row() -> None:
    fitting = tempo(changed={"max_module": 450}, dataset=STREET)
    both = tempo(changed={"max_module": 450, "rules": "reference"}, dataset=STREET)
    stored = tempo(dataset=STREET), fitting, both
    assert stored_of(VPRTEMPO, *stored, column=TOWN).runs == (fitting,)
    assert stored_of(PUBLIC, *stored, column=TOWN).runs == (both,)
    default_by_now = tempo(dataset=STREET, config={"method": {"_target_": "made.x", "max_module": 450, "seed": 0}})
    assert stored_of(VPRTEMPO, default_by_now, column=TOWN).runs == (default_by_now,)


def test_a_failure_before_its_arguments_were_known_belongs_where_its_options_say() -> None:
    def early(**changes: Any) -> Failure:
        failed = failure("vprtempo", **changes)
        return replace(failed, config={name: value for name, value in failed.config.items() if name != "changed"})

    seeded = early(seed=1, config={"overrides": ["method=vprtempo", "+method.seed=1", "method.device=cpu"]})
    failed = early(), seeded, early(changed={"rules": "reference"})
    found = [stored_of(row, failures=failed).failures for row in (VPRTEMPO, PUBLIC)]
    assert found == [failed[:2], failed[2:]]
    fits = {"max_module": 450}
    asked = {"method": fits, "changed": fits, "dataset": STREET, "seed": 0, "device": "cpu"}
    least = replace(failure("vprtempo"), config=asked)
    assert of_row(only(groups([], [least], [TOWN], ROWS)), VPRTEMPO, "cpu").failures == (least,)


OTHERS: dict[str, dict[str, Any]] = {
    "code": {"config": {"code": "beef"}},
    "weights": {"config": {"files": [["net.pth", "a1"]]}},
    "arguments of the method": {
        "config": {"method": {"rules": "paper", "max_module": 1100, "epochs": 3, "_target_": "made.vprtempo"}}
    },
    "libraries": {"machine": {**ABACUS, "libraries": {"torch": "2.7.0"}}},
    "threads": {"machine": {**ABACUS, "threads": 2}},
    "machine": {"machine": {**ABACUS, "processor": "Loom 3"}},
    "network": {"network": "5a" * 32, "fit_seconds": None},
}


OLD = [tempo(seed, day="2025-03-03") for seed in (0, 1, 2)]


TIMED_OTHERWISE = tempo(2, config={"timing": {"minimum_seconds": 10.0}})
NEWER = tempo(0, day="2025-03-04", config={"code": "beef"})
TRAINED = run(day="2025-01-01")
LOADED = run(day="2025-03-01", network="5a" * 32, fit_seconds=None)


@pytest.mark.parametrize(
    ("row", "stored", "runs", "missing", "aside"),
    [
        (VPRTEMPO, [OLD[2], OLD[0]], [OLD[0], OLD[2]], (1,), ()),
        (VPRTEMPO, [*OLD[:2], TIMED_OTHERWISE], [*OLD[:2], TIMED_OTHERWISE], (), ()),
        (SAD, [TRAINED, run(seed=7)], [TRAINED], (), (Aside(1, "of seeds that were not asked for"),)),
        (SAD, [TRAINED, run(device="cuda:1")], [TRAINED], (), ()),
        *(
            (VPRTEMPO, [*OLD[:2], tempo(2, **changes)], OLD[:2], (2,), (Aside(1, "of other", (difference,)),))
            for difference, changes in OTHERS.items()
        ),
        # of incomplete sets the one with the newest run, but first a complete one, and a network that was trained
        (VPRTEMPO, [*OLD[:2], NEWER], [NEWER], (1, 2), (Aside(2, "of other", ("code",)),)),
        (VPRTEMPO, [*OLD, NEWER], OLD, (), (Aside(1, "of other", ("code",)),)),
        (SAD, [LOADED, TRAINED], [TRAINED], (), (Aside(1, "of other", ("network",)),)),
        (SAD, [run(day="2025-01-02"), TRAINED], [run(day="2025-01-02")], (), (Aside(1, "measured again since"),)),
    ],
)
def test_runs_that_differ_in_more_than_their_seed_are_never_put_together(
    row: Row, stored: list[Run], runs: list[Run], missing: tuple[int, ...], aside: tuple[Aside, ...]
) -> None:
    found = stored_of(row, *stored)
    assert [each.key for each in found.runs] == [each.key for each in runs]
    assert (found.missing_seeds, found.aside) == (missing, aside)


def test_failures_of_missing_seeds_and_later_ones_are_named_and_earlier_ones_are_not() -> None:
    stored = tempo(0, day="2025-03-01"), tempo(1, day="2025-03-01")
    failed = (
        failure("vprtempo", 0, day="2025-02-01"),  # mended since
        failure("vprtempo", 1, day="2025-04-01"),
        failure("vprtempo", 2, "first", day="2025-01-01"),
        failure("vprtempo", 2, "last", day="2025-01-02"),
        failure("vprtempo", 2, device="cuda"),
        failure("vprtempo", 2, changed={"rules": "v1"}),
        failure("sad", 2),
    )
    group = only(groups(stored, failed, [RAIL], ROWS))
    found = of_row(group, VPRTEMPO, "cpu").failures
    assert [(each.config["seed"], each.error) for each in found] == [(1, "out of thread"), (2, "last")]


def test_what_was_missing_later_says_nothing_of_a_seed_that_is_stored() -> None:
    lost = [failure("vprtempo", seed, "lost", day="2025-04-01", missing=True) for seed in (0, 2)]
    broke = failure("vprtempo", 0, "broke", day="2025-03-20")
    stored = tempo(0), tempo(1)
    assert stored_of(VPRTEMPO, *stored, failures=lost).failures == (lost[1],)
    assert stored_of(VPRTEMPO, *stored, failures=[broke, *lost]).failures == (broke, lost[1])


def test_failures_of_another_machine_count_only_where_no_run_is_stored() -> None:
    there = tuple(failure("vprtempo", seed, day="2025-04-01", machine=LOOM) for seed in (0, 2))
    unknown = replace(there[1], environment={})
    stored = tempo(0), tempo(1)
    assert stored_of(VPRTEMPO, *stored, failures=there).failures == ()
    assert stored_of(VPRTEMPO, *stored, failures=[unknown]).failures == (unknown,)
    assert stored_of(VPRTEMPO, failures=there).failures == there


def test_series_are_the_rows_with_runs_under_the_names_of_the_table() -> None:
    group = Group(RAIL, 1, (tempo(1), tempo(0), run(device="cuda:1")), ())
    (cpu,) = series(group, ROWS)
    assert (cpu.name, cpu.spiking) == ("VPRTempo", True)
    assert [stored.config["seed"] for stored in cpu.runs] == [0, 1]
    assert [one.name for one in series(group, ROWS, "cuda")] == ["SAD"]


def test_accuracy_is_taken_from_the_device_with_more_seeds_and_of_equals_the_cpu() -> None:
    cpu, gpu = [tempo(seed) for seed in (0, 1, 2)], [tempo(seed, device="cuda") for seed in (0, 1, 2)]

    def taken(*runs: Run) -> list[Run]:
        failed = tuple(failure("vprtempo", 0, day="2025-04-01", device=device) for device in ("cpu", "cuda"))
        for failures in ((), failed[:1], failed[1:]):
            (one,) = accuracy_series(Group(RAIL, 1, runs, failures), ROWS)
            assert one.name == "VPRTempo"
        return [*one.runs]

    assert taken(*cpu, *gpu) == cpu
    assert taken(*cpu[:2], *gpu) == gpu
    assert taken(*cpu[:2], *gpu[:1]) == cpu[:2]
    assert taken(gpu[1]) == [gpu[1]]
    assert accuracy_series(Group(RAIL, 1, (), (failure("vprtempo"),)), ROWS) == []


def test_a_protocol_in_words_leaves_out_the_numbers_that_stand_beside_it() -> None:
    protocol = {"references": ("sun", "rain"), "places": 450, "query_places": 360}
    made = run(protocol=protocol | {"repeated_images": {"sun": 5, "rain": 2}})
    assert protocol_words(made) == "references sun+rain, repeated images 5 in sun+2 in rain"

"""Runs belong to the column and row they were asked for, and only equals stand together."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import pytest
from stored_runs import ABACUS, LOOM, PUBLIC, RAIL, RAILWAY, SAD, STREET, TOWN, VPRTEMPO, failure, run

from vprbench.paper.plan import Row
from vprbench.paper.selection import (
    Aside,
    Group,
    ResolvedColumn,
    accuracy_series,
    groups,
    of_row,
    options_apart,
    protocol_words,
    series,
)
from vprbench.run.record import Failure, Run

ROWS = (SAD, VPRTEMPO, PUBLIC)


def only(group: list[Group]) -> Group:
    (one,) = group
    return one


def tempo(seed: int = 0, **changes: Any) -> Run:
    return run("vprtempo", seed, **changes)


def test_an_empty_store_gives_each_column_one_empty_group() -> None:
    found = groups([], [], [RAIL, TOWN], ROWS)
    assert [(group.asked, group.number, group.runs, group.failures) for group in found] == [
        (RAIL, 1, (), ()),
        (TOWN, 1, (), ()),
    ]


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


def test_runs_of_methods_that_are_no_rows_open_no_group() -> None:
    other = run("hog", protocol={"query": "night"}, day="2025-06-01")
    mine = run()
    assert only(groups([other, mine], [], [RAIL], ROWS)).runs == (mine,)


def test_two_protocols_are_two_groups_the_newest_first() -> None:
    old = run(protocol={"query": "summer", "renderer": 1}, day="2025-02-01")
    new = run("vprtempo", protocol={"query": "summer", "renderer": 2}, day="2025-02-02")
    first, second = groups([old, new], [failure()], [RAIL], ROWS)
    assert (first.number, first.runs) == (1, (new,))
    assert (second.number, second.runs) == (2, (old,))
    assert len(first.failures) == 1
    assert not second.failures


def test_other_images_under_one_protocol_are_another_group() -> None:
    assert [group.runs[0].fingerprint for group in groups([run(), run(fingerprint="0" * 64)], [], [RAIL], ROWS)] == [
        "f" * 64,
        "0" * 64,
    ]


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
    group = Group(TOWN, 1, (tempo(dataset=STREET), fitting, both), ())
    assert of_row(group, VPRTEMPO, "cpu").runs == (fitting,)
    assert of_row(group, PUBLIC, "cpu").runs == (both,)


def test_an_argument_that_is_the_default_by_now_need_not_be_named() -> None:
    stored = tempo(dataset=STREET, config={"method": {"_target_": "made.x", "max_module": 450, "seed": 0}})
    assert of_row(Group(TOWN, 1, (stored,), ()), VPRTEMPO, "cpu").runs == (stored,)


def test_a_failure_before_its_arguments_were_known_belongs_where_its_options_say() -> None:
    def early(**changes: Any) -> Failure:
        failed = failure("vprtempo", **changes)
        return replace(failed, config={name: value for name, value in failed.config.items() if name != "changed"})

    seeded = early(seed=1, config={"overrides": ["method=vprtempo", "+method.seed=1", "method.device=cpu"]})
    failed = early(), seeded, early(changed={"rules": "reference"})
    found = [of_row(Group(RAIL, 1, (), failed), row, "cpu").failures for row in (VPRTEMPO, PUBLIC)]
    assert found == [failed[:2], failed[2:]]


def test_devices_are_kept_apart_and_their_numbers_do_not_matter() -> None:
    cpu, gpu = run(), run(device="cuda:1")
    group = Group(RAIL, 1, (cpu, gpu), ())
    assert of_row(group, SAD, "cpu").runs == (cpu,)
    assert of_row(group, SAD, "cuda").runs == (gpu,)


def test_seeds_are_ascending_and_missing_ones_named() -> None:
    found = of_row(Group(RAIL, 1, (tempo(2), tempo(0)), ()), VPRTEMPO, "cpu")
    assert [stored.config["seed"] for stored in found.runs] == [0, 2]
    assert found.missing_seeds == (1,)


def test_a_seed_that_the_row_does_not_ask_for_is_set_aside_by_name() -> None:
    found = of_row(Group(RAIL, 1, (run(), run(seed=7)), ()), SAD, "cpu")
    assert len(found.runs) == 1
    assert found.aside == (Aside(1, "of seeds that were not asked for"),)


OTHERS: dict[str, dict[str, Any]] = {
    "code": {"config": {"code": "beef"}},
    "timing": {"config": {"timing": {"minimum_seconds": 10.0}}},
    "weights": {"config": {"files": [["net.pth", "a1"]]}},
    "arguments of the method": {
        "config": {"method": {"rules": "paper", "max_module": 1100, "epochs": 3, "_target_": "made.vprtempo"}}
    },
    "libraries": {"machine": {**ABACUS, "libraries": {"torch": "2.7.0"}}},
    "threads": {"machine": {**ABACUS, "threads": 2}},
    "machine": {"machine": {**ABACUS, "processor": "Loom 3"}},
    "network": {"network": "5a" * 32, "fit_seconds": None},
}


@pytest.mark.parametrize("difference", OTHERS)
def test_runs_that_differ_in_more_than_their_seed_are_never_put_together(difference: str) -> None:
    mine = tempo(0, day="2025-03-05"), tempo(1, day="2025-03-05")
    other = tempo(2, **OTHERS[difference])
    found = of_row(Group(RAIL, 1, (*mine, other), ()), VPRTEMPO, "cpu")
    assert found.runs == mine
    assert found.missing_seeds == (2,)
    assert found.aside == (Aside(1, "of other", (difference,)),)


def test_of_incomplete_sets_the_one_with_the_newest_run_is_shown() -> None:
    old = tempo(0, day="2025-03-01"), tempo(1, day="2025-03-03")
    new = tempo(2, day="2025-03-04", config={"code": "beef"})
    found = of_row(Group(RAIL, 1, (*old, new), ()), VPRTEMPO, "cpu")
    assert found.runs == (new,)
    assert found.aside == (Aside(2, "of other", ("code",)),)


def test_a_complete_set_comes_before_a_newer_incomplete_one() -> None:
    complete = tuple(tempo(seed, day="2025-01-01") for seed in (0, 1, 2))
    newer = tempo(0, day="2025-03-01", config={"code": "beef"})
    assert of_row(Group(RAIL, 1, (*complete, newer), ()), VPRTEMPO, "cpu").runs == complete


def test_a_network_that_was_trained_comes_before_a_newer_one_that_was_loaded() -> None:
    trained, loaded = run(day="2025-01-01"), run(day="2025-03-01", network="5a" * 32, fit_seconds=None)
    assert of_row(Group(RAIL, 1, (loaded, trained), ()), SAD, "cpu").runs == (trained,)


def test_of_one_seed_measured_twice_the_newest_is_shown_and_the_other_named() -> None:
    old, new = run(day="2025-01-01"), run(day="2025-01-02")
    found = of_row(Group(RAIL, 1, (new, old), ()), SAD, "cpu")
    assert found.runs == (new,)
    assert found.aside == (Aside(1, "measured again since"),)


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
    assert of_row(Group(RAIL, 1, stored, tuple(lost)), VPRTEMPO, "cpu").failures == (lost[1],)
    assert of_row(Group(RAIL, 1, stored, (broke, *lost)), VPRTEMPO, "cpu").failures == (broke, lost[1])


def test_failures_of_another_machine_count_only_where_no_run_is_stored() -> None:
    there = tuple(failure("vprtempo", seed, day="2025-04-01", machine=LOOM) for seed in (0, 2))
    unknown = replace(there[1], environment={})
    assert of_row(Group(RAIL, 1, (tempo(0), tempo(1)), there), VPRTEMPO, "cpu").failures == ()
    assert of_row(Group(RAIL, 1, (tempo(0), tempo(1)), (unknown,)), VPRTEMPO, "cpu").failures == (unknown,)
    assert of_row(Group(RAIL, 1, (), there), VPRTEMPO, "cpu").failures == there


def test_a_failure_that_holds_nothing_but_what_was_asked_for_belongs_too() -> None:
    asked = {
        "method": {"max_module": 450},
        "changed": {"max_module": 450},
        "dataset": STREET,
        "seed": 0,
        "device": "cpu",
    }
    failed = replace(failure("vprtempo"), config=asked)
    assert of_row(only(groups([], [failed], [TOWN], ROWS)), VPRTEMPO, "cpu").failures == (failed,)


def test_the_order_in_which_a_store_is_read_changes_nothing() -> None:
    stored = [
        tempo(0, day="2025-03-01"),
        tempo(0, day="2025-03-02"),
        tempo(1, config={"code": "beef"}),
        run(protocol={"query": "night"}, day="2025-03-01"),
        run(),
    ]
    failed = [failure("vprtempo", 2), failure("vprtempo", 2, "again")]

    def found(runs: tuple[Run, ...]) -> list[Any]:
        made = groups(runs, failed, [RAIL], ROWS)
        return [made, *(of_row(group, row, "cpu") for group in made for row in ROWS)]

    first = found(tuple(stored))
    for order in itertools.permutations(stored):
        for one, other in zip(found(order), first, strict=True):
            assert repr(one) == repr(other)


def test_series_are_the_rows_with_runs_under_the_names_of_the_table() -> None:
    group = Group(RAIL, 1, (tempo(1), tempo(0), run(device="cuda")), ())
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
    protocol = {
        "references": ("sun", "rain"),
        "places": 450,
        "query_places": 360,
        "repeated_images": {"sun": 5, "rain": 2},
    }
    assert protocol_words(run(protocol=protocol)) == "references sun+rain, repeated images 5 in sun+2 in rain"

"""Runs belong to the column and row they were asked for, and only equals stand together."""

from dataclasses import replace
from functools import partial

import pytest
from stored_runs import ABACUS, PUBLIC, RAIL, RAILWAY, SAD, STREET, TOWN, VPRTEMPO, failure, run, tempo

from vprbench.report import selection
from vprbench.report.selection import DatasetRuns, list_method_runs, select_row_runs

ROWS = (SAD, VPRTEMPO, PUBLIC)
FOGGY = replace(RAIL, dataset={**RAILWAY, "fog": 0.5})


lost = partial(failure, "vprtempo")


def grouped(runs, failures=(), *asked):
    return selection.group_runs_by_column(runs, failures, asked or [RAIL], ROWS)


MINE = run()
ELSEWHERE = run(dataset={**STREET, "root": "/there", "source": "a shop", "_target_": "moved.street"}, fingerprint="s")
LISTED = replace(RAIL, dataset={"name": "r", "references": ("a", "b"), "places": 10})
SAME = run(dataset={"places": 10, "references": ["a", "b"], "name": "r"})
FOG = tempo(dataset={**RAILWAY, "fog": 0.5})
OTHER_NAME = replace(failure(), dataset="river", config={**failure().config, "dataset": {}})


@pytest.mark.parametrize(
    ("runs", "failures", "asked", "found"),
    [
        # by the dataset and its options, wherever its frames lay
        ([run(dataset={**RAILWAY, "places": 20}), ELSEWHERE, MINE], [], [RAIL, TOWN], [[MINE], [ELSEWHERE]]),
        ([SAME], [], [LISTED], [[SAME]]),
        # options that the dataset gained or lost keep no run away, but their other values do
        ([MINE, FOG, run(dataset={**RAILWAY, "fog": 0.9})], [], [FOGGY], [[MINE, FOG]]),
        ([MINE, FOG], [failure()], [RAIL], [[MINE, FOG]]),
        # another name is another dataset
        ([run(dataset={"name": "river"}), run(dataset={**RAILWAY, "name": "river"})], [OTHER_NAME], [RAIL], [[]]),
    ],
)
def test_runs_belong_to_the_column_with_their_dataset(runs, failures, asked, found):
    told = grouped(runs, failures, *asked)
    assert [list(group.runs) for group in told] == found
    assert [len(group.failures) for group in told] == [failures.count(failure())] + [0] * (len(asked) - 1)


def test_two_protocols_are_two_groups_the_newest_first_and_corrupted_queries_stand_in_columns_of_their_own():
    shift, noise = (replace(RAIL, corruption=name) for name in ("shift-1", "noise-2"))
    clean, moved = run(config={"corruption": None}), run(config={"corruption": "shift-1"}, day="2025-09-09")
    failed = lost(config={"corruption": "noise-2"})
    found = grouped([clean, moved], [failed], RAIL, shift, noise)
    assert [(group.runs, group.failures) for group in found] == [((clean,), ()), ((moved,), ()), ((), (failed,))]
    old = run(protocol={"query": "summer", "renderer": 1}, day="2025-02-01")
    new = tempo(protocol={"query": "summer", "renderer": 2}, day="2025-02-02")
    no_row = run("hog", protocol={"query": "night"}, day="2025-06-01")
    found = grouped([old, no_row, new], [failure()])
    assert found == [DatasetRuns(RAIL, 1, (new,), (failure(),)), DatasetRuns(RAIL, 2, (old,), ())]
    images = run(), run(fingerprint="0" * 64)
    assert [group.runs for group in grouped(images)] == [(images[0],), (images[1],)]


def test_a_run_belongs_to_the_row_with_its_arguments():
    for changed, rows in (
        ({}, [VPRTEMPO]),
        ({"rules": "reference"}, [PUBLIC]),
        ({"rules": "v1"}, []),
        ({"epochs": 9}, []),
    ):
        group = DatasetRuns(RAIL, 1, (tempo(changed=changed),), ())
        assert [each for each in ROWS if select_row_runs(group, each, "cpu").runs] == rows


OTHERS = [
    *({"config": each} for each in ({"code": "beef"}, {"files": [["net.pth", "a1"]]})),
    {"config": {"method": {"rules": "paper", "max_module": 1100, "epochs": 3}}},
    *({"machine": {**ABACUS, **each}} for each in ({"libraries": {"torch": "2.7.0"}}, {"threads": 2})),
    {"machine": {**ABACUS, "processor": "Loom 3"}},
    {"network": "5a" * 32, "fit_seconds": None},
]
OLD = [tempo(seed, day="2025-03-03") for seed in (0, 1, 2)]
TIMED_OTHERWISE = tempo(2, config={"timing": {"minimum_seconds": 10.0}})
NEWER = tempo(0, day="2025-03-04", config={"code": "beef"})
TRAINED = run(day="2025-01-01")
LOADED = run(day="2025-03-01", network="5a" * 32, fit_seconds=None)


@pytest.mark.parametrize(
    ("row", "stored", "runs", "missing", "n_aside"),
    [
        (VPRTEMPO, [OLD[2], OLD[0]], [OLD[0], OLD[2]], (1,), 0),
        (VPRTEMPO, [*OLD[:2], TIMED_OTHERWISE], [*OLD[:2], TIMED_OTHERWISE], (), 0),
        (SAD, [TRAINED, run(seed=7)], [TRAINED], (), 1),
        (SAD, [TRAINED, run(device="cuda:1")], [TRAINED], (), 0),
        *((VPRTEMPO, [*OLD[:2], tempo(2, **changes)], OLD[:2], (2,), 1) for changes in OTHERS),
        # of incomplete sets the one with the newest run, but first a complete one, and a network that was trained
        (VPRTEMPO, [*OLD[:2], NEWER], [NEWER], (1, 2), 2),
        (VPRTEMPO, [*OLD, NEWER], OLD, (), 1),
        (SAD, [LOADED, TRAINED], [TRAINED], (), 1),
        (SAD, [run(day="2025-01-02"), TRAINED], [run(day="2025-01-02")], (), 1),
    ],
)
def test_runs_that_differ_in_more_than_their_seed_are_never_put_together(row, stored, runs, missing, n_aside):
    found = select_row_runs(DatasetRuns(RAIL, 1, tuple(stored), ()), row, "cpu")
    assert [each.key for each in found.runs] == [each.key for each in runs]
    assert (found.missing_seeds, found.n_aside) == (missing, n_aside)


@pytest.mark.parametrize(
    ("stored", "told"),
    [((), ["first", "last"]), ((tempo(1),), ["last"]), ((tempo(0), tempo(1), tempo(2)), [])],
)
def test_a_seed_without_a_run_has_its_newest_failure(stored, told):
    own = [lost(1, "first", day="2025-04-01"), lost(2, "older", day="2025-01-01"), lost(2, "last", day="2025-01-02")]
    (group,) = grouped(stored, [*own, lost(2, device="cuda"), lost(2, changed={"rules": "v1"}), failure("sad", 2)])
    assert [failure.error for failure in select_row_runs(group, VPRTEMPO, "cpu").failures] == told


def test_series_are_the_rows_with_runs_under_the_names_of_the_table_and_a_protocol_is_told_without_its_numbers():
    group = DatasetRuns(RAIL, 1, (tempo(1), tempo(0), run(device="cuda:1")), ())
    (cpu,) = list_method_runs(group, ROWS, "cpu")
    assert cpu.name == "VPRTempo"
    assert [stored.config["seed"] for stored in cpu.runs] == [0, 1]
    assert [one.name for one in list_method_runs(group, ROWS, "cuda")] == ["SAD"]
    protocol = {"references": ("sun", "rain"), "places": 450, "query_places": 360}
    made = run(protocol=protocol | {"repeated_images": {"sun": 5, "rain": 2}})
    assert selection.describe_protocol(made) == "references sun+rain, repeated images 5 in sun+2 in rain"


def test_accuracy_is_taken_from_the_device_with_more_seeds_and_of_equals_the_cpu():
    cpu, gpu = ([tempo(seed, device=device) for seed in (0, 1, 2)] for device in ("cpu", "cuda"))
    failed = tuple(lost(day="2025-04-01", device=device) for device in ("cpu", "cuda"))
    two = cpu[:2]
    for runs, taken in (cpu + gpu, cpu), (two + gpu, gpu), ([*two, gpu[0]], two), (gpu[1:2], gpu[1:2]):
        for failures in ((), failed[:1], failed[1:]):
            (one,) = list_method_runs(DatasetRuns(RAIL, 1, tuple(runs), failures), ROWS)
            assert (one.name, list(one.runs)) == ("VPRTempo", taken)
    assert list_method_runs(DatasetRuns(RAIL, 1, (), (lost(),)), ROWS) == []

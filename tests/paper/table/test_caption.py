"""Sentences beside a table tell what its numbers stand for and what is not shown, and only where it is so."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from assembled import absences, measured, table, tempo
from stored_runs import ABACUS, PLAN, RAIL, SAD, STREET, TOWN, VPRTEMPO, failure, run

from vprbench.paper.selection import ResolvedColumn, groups
from vprbench.paper.table.build import assemble
from vprbench.run.record import Run


def test_seeds_are_named_where_they_differ_between_columns_and_devices() -> None:
    runs = [tempo(0), tempo(1), *(tempo(seed, dataset=STREET, changed={"max_module": 450}) for seed in (0, 1, 2))]
    made = table(runs, rows=[VPRTEMPO], asked=[RAIL, TOWN])
    of_seeds = "; of R@1 and rates the mean, of minutes the median."
    assert f"VPRTempo: seeds 0 and 1 (Railway (rendered)), seeds 0, 1 and 2 (City street){of_seeds}" in made.caption
    devices = table([*runs[:2], tempo(0, device="cuda")], rows=[VPRTEMPO])
    where = "seeds 0 and 1 (Railway (rendered), CPU), seed 0 (Railway (rendered), GPU)"
    assert f"VPRTempo: {where}{of_seeds}" in devices.caption
    assert not any("seed" in sentence for sentence in table(runs[:1], rows=[VPRTEMPO]).caption)


def test_runs_of_other_options_are_told_where_they_fill_a_column_of_their_own() -> None:
    asked = ResolvedColumn(RAIL.planned, {**RAIL.dataset, "fog": 0.5})
    before = run(protocol={"query": "summer", "renderer": 1}, day="2025-01-01")
    todays = run(dataset=asked.dataset, protocol={"query": "summer", "renderer": 2})
    told = [s for s in table([before, todays], rows=[SAD], asked=[asked]).caption if "other options" in s]
    assert told == ["Railway (rendered), renderer 1: its runs are of a time when the dataset had other options (fog)."]
    assert not any("other options" in s for s in table([before], rows=[SAD], asked=[asked]).caption)


def test_a_seed_that_failed_after_it_was_stored_is_named_in_the_caption() -> None:
    runs = [tempo(seed) for seed in (0, 1, 2)]
    made = table(runs, [failure("vprtempo", 1, "it diverged", day="2025-04-01")], rows=[VPRTEMPO])
    assert absences(made, "VPRTempo")[0] == "measured"
    assert "VPRTempo, Railway (rendered), CPU: seed 1 failed since: it diverged." in made.caption


CODE = {"config": {"code": "beef"}, "day": "2025-01-01"}
LIBRARIES = {"machine": {**ABACUS, "libraries": {"torch": "2.7.0"}}, "day": "2025-01-01"}


@pytest.mark.parametrize(
    ("runs", "words"),
    [
        ([run(dataset=STREET), run(**CODE), run(dataset=STREET, **CODE)], "2 runs of other code are"),
        ([run(day="2025-01-02")], "1 run measured again since is"),
        (
            [run(day="2025-01-02"), run(**CODE), run(**LIBRARIES)],
            "2 runs of other code or libraries and 1 run measured again since are",
        ),
    ],
)
def test_what_a_row_sets_aside_in_all_columns_is_one_sentence(runs: list[Run], words: str) -> None:
    made = table([run(), run(device="cuda"), *runs], rows=[SAD], asked=[RAIL, TOWN])
    assert [s for s in made.caption if "set aside" in s] == [f"SAD: {words} set aside."]


def test_what_a_reader_has_to_know_of_a_column_stands_in_the_caption() -> None:
    remark = "How hard it is was set by hand."
    asked = ResolvedColumn(replace(RAIL.planned, remark=remark), RAIL.dataset)
    columns = [asked, ResolvedColumn(replace(TOWN.planned, remark=remark), TOWN.dataset)]
    made = assemble(groups([run()], (), columns, [SAD]), [SAD], PLAN, {})
    assert made.caption.count(remark) == 1


def test_the_caption_tells_how_long_the_blocks_of_each_interval_are_and_where_wilsons_is_wider() -> None:
    made = table([run(hits=np.repeat([1, 0, 1, 1, 0, 0, 1, 0, 1, 1], 20).tolist()), run("vprsnn", hits=[1] * 200)])
    (sentence,) = [sentence for sentence in made.caption if "length in queries of the blocks" in sentence]
    block = measured(made, "SAD", "recall_at_1").block
    assert block is not None
    assert block > 10
    assert sentence.endswith(f": SAD {block}, VPRSNN 1 (Wilson).")
    assert not any("length in queries" in sentence for sentence in table([], rows=[SAD]).caption)

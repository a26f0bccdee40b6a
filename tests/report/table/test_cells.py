"""Cells say what was measured and printed, or which word stands for nothing; bold is what every test separates."""

from dataclasses import replace

import numpy as np
import pytest
import stored_runs
from pandas.testing import assert_frame_equal
from stored_runs import (
    ABACUS,
    NAMES,
    SAD,
    VPRSNN,
    VPRTEMPO,
    absences,
    cell,
    failure,
    measured,
    notes,
    run,
    table,
    tempo,
)

from vprbench.report.plan import Column, Row
from vprbench.report.table.formats import list_facts
from vprbench.report.table.quantities import list_quantities
from vprbench.runs.notes import Note

approx = pytest.approx
WILSON = (approx(15.00, abs=0.005), approx(85.00, abs=0.005))  # 95 % of 2 hits of 4
FAST = [0.0010, 0.0011, 0.0012, 0.0013, 0.0014]


def test_the_numbers_of_one_run_and_of_several_seeds_are_those_worked_by_hand():
    made = table([run(), run("netvlad")])  # 2 of 4 right; 10 ms to encode and 2.5 ms to match
    recall = measured(made, "SAD", "recall_at_1")
    assert (recall.value, recall.spread, recall.total, recall.seeds) == (50.0, None, None, (0,))
    assert (recall.low, recall.high) == WILSON
    for row, alone in (("SAD", 400), ("NetVLAD", 100)):
        query = measured(made, row, "query_cpu")
        assert (query.value, query.at_boundary, query.low) == (approx(80), approx(alone), None)
    (column,) = made.groups
    protocol = "references spring+fall, query summer, tolerance places 0"
    assert column.data == f"10 places; 4 queries; {protocol}; stands in for Nordland"
    # R@1 75, 50 and 25 %: mean 50, sample deviation 25, 2 of 4 hits in the mean; rates 80, 66.7 and 50 Hz, to match
    # alone 400, 200 and 100; 1, 9 and 2 minutes, with the images 11, 10 and 3
    runs = [
        tempo(0, hits=[1, 1, 1, 0], match_seconds=[0.0025] * 5, fit_compute_seconds=60, fit_seconds=660),
        tempo(1, hits=[1, 1, 0, 0], match_seconds=[0.005] * 5, fit_compute_seconds=540, fit_seconds=600),
        tempo(2, hits=[1, 0, 0, 0], match_seconds=[0.010] * 5, fit_compute_seconds=120, fit_seconds=180),
    ]
    made = table(runs, rows=[VPRTEMPO])
    recall, train, query = (measured(made, "VPRTempo", quantity) for quantity in NAMES[:3])
    assert (recall.value, recall.spread, recall.seeds) == (approx(50), approx(25), (0, 1, 2))
    assert (recall.low, recall.high) == WILSON
    assert (query.value, query.spread, query.at_boundary) == approx((590 / 9, 15.0308, 700 / 3), abs=1e-3)
    assert (train.value, train.spread, train.total) == (approx(2), approx(19**0.5), approx(10))


def test_a_difference_to_the_paper_is_given_on_its_own_frames_alone_and_a_comparison_has_no_published_numbers():
    runs = [run(), *(tempo(seed, fit_compute_seconds=120) for seed in (0, 1, 2))]
    cells = [("SAD", "recall_at_1"), ("SAD", "query_cpu"), ("VPRTempo", "train_cpu")]
    real = table(runs, asked=[replace(stored_runs.NORDLAND, dataset=stored_runs.RAILWAY)])
    assert [cell(real, row, q, "nordland").difference for row, q in cells] == approx([50 - 48, 400 - 10, 2 - 60])
    rendered = table(runs)
    assert [cell(rendered, row, q).published for row, q in cells] == [48, 10, 60]
    assert {*rendered.cells["difference"]} == {None}
    mine = Column("mine", "My street", ("dataset=street",))
    asked, rows = [replace(mine, dataset=stored_runs.STREET)], [replace(VPRTEMPO, seeds=(0,)), SAD]
    runs = [run(dataset=stored_runs.STREET), tempo(dataset=stored_runs.STREET)]
    made = table(runs, (), rows, asked, quantities=list_quantities(["recall_at_5"]), title="My street")
    assert [q.name for q in made.quantities] == [*NAMES, "recall_at_5"]
    assert {*made.cells["published_mark"]} == {"none"}
    assert list_facts(made)[0].endswith("query GPU in Hz, R@5 in %.")


def test_an_empty_store_shows_words_in_every_cell_and_without_runs_on_a_cpu_accuracy_is_of_the_gpu():
    made = table()
    (column,) = made.groups
    assert (column.data.split(";")[0], made.machines) == ("no run is stored", ())
    assert absences(made, "SAD") == ["unfinished", "not applicable", "unfinished", "not applicable", "not run"]
    assert absences(made, "VPRTempo") == ["unfinished", "unfinished", "unfinished", "not run", "not run"]
    assert made.notes == ()
    made = table([run(device="cuda", day="2025-03-04"), run("vprsnn", device="cuda", day="2025-03-01")])
    assert absences(made, "SAD") == ["measured", "not applicable", "not run", "not applicable", "measured"]
    assert made.machines == ("Loom 3, 1 of 8 cores, Spindle 80GB, torch 2.6.0, 2025-03-04",)


def test_what_was_loaded_or_kept_is_no_training_and_a_run_that_was_not_timed_has_a_recall_and_a_training_but_no_rate():
    for changes in {"network": "5a" * 32}, {}:
        made = table([run("vprsnn", fit_seconds=None, fit_compute_seconds=None, **changes)], rows=[VPRSNN])
        assert absences(made, "VPRSNN")[:3] == ["measured", "not run", "measured"]
        assert notes(made, "VPRSNN", "train_cpu") == []
    mute = {"timing": None, "hits": [1] * 60, "fit_compute_seconds": 60}
    slow = run("vprsnn", hits=[0] * 60, fit_compute_seconds=600)
    made = table([*(tempo(seed, **mute) for seed in (0, 1, 2)), slow], rows=[VPRSNN, VPRTEMPO])
    assert absences(made, "VPRTempo")[:3] == ["measured", "measured", "not timed"]
    recall = measured(made, "VPRTempo", "recall_at_1")
    assert (recall.best, recall.seeds, measured(made, "VPRTempo", "train_cpu").value) == (True, (0, 1, 2), approx(1))
    one = table([tempo(0), tempo(1, timing=None), tempo(2, timing=None)], rows=[VPRTEMPO])
    assert measured(one, "VPRTempo", "query_cpu").seeds == (0,)
    assert "seeds: 1 of 3" in notes(one, "VPRTempo", "query_cpu")


def test_recall_tells_its_ties_its_notes_and_that_it_is_undefined_and_a_cost_that_is_not_known_why():
    # the right place shares the highest score with a wrong one for two of four queries
    outcome, two, nothing = run(hits=[1, 0, 1, 1]).outcome, np.array([1, 1, 2, 2]), np.zeros(4, np.int64)
    tied = run(outcome=replace(outcome, top_tied=two, tied=two))
    undefined = replace(outcome, above=nothing + 10, tied=nothing, tied_correct=nothing, n_positives=nothing)
    kinds = tuple(Note(kind, kind) for kind in ("answers", "index", "noisy"))
    runs = [tied, run("hog", outcome=undefined), run("vprsnn", notes=kinds)]
    made = table(runs, rows=[SAD, Row("hog", "hog", training="map"), VPRSNN])
    assert measured(made, "SAD", "recall_at_1").value == approx(50)
    assert "ties: R@1 25.0 to 75.0 %" in notes(made, "SAD", "recall_at_1")
    undefined = "undefined: no query has a right place"
    assert (absences(made, "hog")[0], notes(made, "hog", "recall_at_1")) == ("not applicable", [undefined])
    query = measured(made, "hog", "query_cpu")  # of a row that the paper does not have
    assert (query.value, query.at_boundary, notes(made, "hog", "query_cpu")) == (approx(80), None, [])
    for quantity, shown, hidden in (("recall_at_1", "index", "answers"), ("query_cpu", "answers", "index")):
        found = notes(made, "VPRSNN", quantity)
        assert (shown in found, hidden in found, "noisy" in found) == (True, False, False)
    energy = {"values": {"operations": 2e6, "joules_measured": None}, "how": {"joules_measured": "no counter here"}}
    costs = list_quantities(["operations", "joules_measured"])
    made = table([run(energy=energy)], rows=[SAD], quantities=costs)
    assert measured(made, "SAD", "operations").value == 2
    assert notes(made, "SAD", "joules_measured") == ["undefined: no counter here"]


@pytest.mark.parametrize(
    ("tuned_on", "best"),
    [
        ({"dataset": "railway", "places": "half of the places"}, False),
        ({"dataset": "rails", "places": "half of the places", "also_in": {"railway": "unknown"}}, False),
        ({"dataset": "street", "places": "half of the places"}, True),
    ],
)
def test_a_row_that_was_tuned_on_a_columns_places_says_so_and_is_in_no_contest_there(tuned_on, best):
    tuned = [tempo(s, hits=[1] * 60, match_seconds=FAST, fit_compute_seconds=6, tuned_on=tuned_on) for s in (0, 1, 2)]
    slow = {"match_seconds": [10 * each for each in FAST], "fit_compute_seconds": 600}
    made = table([*tuned, run("vprsnn", hits=[0] * 60, **slow)], rows=[VPRSNN, VPRTEMPO])
    for quantity in NAMES[:3]:
        assert measured(made, "VPRTempo", quantity).best == (best and quantity != "train_cpu")
        for row, tuned_here in (("VPRTempo", not best), ("VPRSNN", False)):
            assert any(note.startswith("tuned on") for note in notes(made, row, quantity)) == tuned_here
    others = table([*tuned, run("vprsnn", hits=[1, 0] * 30, **slow), run(hits=[0] * 60)])
    assert measured(others, "VPRSNN", "recall_at_1").best == (not best)  # it beats the others that are in the contest


def test_two_protocols_are_two_columns_with_titles_that_tell_them_apart():
    old = run(protocol={"query": "summer", "renderer": 1}, day="2025-01-01", hits=[1, 1, 1, 1])
    made = table([run(protocol={"query": "summer", "renderer": 2}), old], rows=[SAD, VPRSNN])
    titles = {"railway": "Railway (rendered), renderer 2", "railway-2": "Railway (rendered), renderer 1"}
    assert {column.name: column.title for column in made.groups} == titles
    assert measured(made, "SAD", "recall_at_1", "railway-2").value == approx(100)
    assert cell(made, "VPRSNN", "recall_at_1", "railway-2").mark == "not run"
    other_images = table([run(), run(fingerprint="0" * 64)], rows=[SAD])
    assert [group.title for group in other_images.groups] == ["Railway (rendered)", "Railway (rendered), version 2"]


def test_the_order_of_a_store_changes_nothing():
    sads = [run(), run(day="2025-01-01"), run(device="cuda"), run(protocol={"query": "night"}, day="2025-02-01")]
    runs = [*sads, *map(tempo, (0, 1, 2)), tempo(config={"code": "beef"}, day="2025-04-01"), run("netvlad")]
    failures = [failure("vprsnn"), failure("vprtempo", 2, day="2025-05-01")]
    first = table(runs, failures)
    for order in (runs[::-1], runs[4:] + runs[:4]):
        other = table(order, failures[::-1])
        assert_frame_equal(other.cells, first.cells)
        assert (other.to_markdown(), other.groups, other.n_aside) == (first.to_markdown(), first.groups, first.n_aside)


RECALL, RATE = "recall_at_1", "query_cpu"
NOISY = (Note("noisy", "two carts passed"),)


def bold(quantity, contest, unfinished=""):
    """Return the row that is bold; a row has a run for each seed, an unfinished one lacks one more seed."""
    rows, seeded = [], []
    for name, runs in contest.items():
        rows.append(Row(name, name, seeds=tuple(range(len(runs) + (name == unfinished)))))
        for seed, each in enumerate(runs):
            seeded.append(replace(each, method=name, key=f"{name}-{seed}", config={**each.config, "seed": seed}))
    made = table(seeded, rows=rows)
    best = [row.name for row in rows if cell(made, row.name, quantity).best]
    return " ".join(best)


def misses(*wrong, n_queries=60):
    """Return a run that is right everywhere but at these queries."""
    return run(hits=[int(query not in wrong) for query in range(n_queries)])


def spread(count, n_queries=60):
    """Return a run of misses that are ten queries apart and never come together."""
    return misses(*range(0, 10 * count, 10), n_queries=n_queries)


SAME, ALL_WRONG = misses(), misses(*range(60))


@pytest.mark.parametrize(
    ("contest", "best", "unfinished"),
    [
        ({"a": [SAME]}, "", ""),
        # McNemar: p = 2 / 2^6 = 0.031 and 2 / 2^5 = 0.063
        ({"b": [spread(6)], "a": [SAME]}, "a", ""),
        ({"b": [spread(5, 50)], "a": [misses(n_queries=50)]}, "", ""),
        # of three rows: 0.031 > 0.05 / 2; seven to nothing: 2 / 2^7 = 0.016
        ({"a": [SAME], "b": [spread(6)], "c": [spread(6)]}, "", ""),
        ({"a": [misses(n_queries=70)], "b": [spread(7, 70)], "c": [spread(7, 70)]}, "a", ""),
        # every pair of seeds has to agree
        ({"a": [SAME, SAME], "b": [spread(6), spread(6)]}, "a", ""),
        ({"a": [SAME, SAME], "b": [spread(6), misses(0)]}, "", ""),
        ({"a": [SAME, misses(0)], "b": [spread(6)]}, "", ""),
        # a row with missing seeds cannot win but keeps others from it
        ({"a": [SAME], "b": [spread(6)], "c": [ALL_WRONG]}, "", "a"),
        ({"b": [SAME], "c": [ALL_WRONG]}, "b", "c"),
    ],
)
def test_recall_is_best_where_every_pair_of_runs_is_separated(contest, best, unfinished):
    assert bold(RECALL, contest, unfinished) == best


def test_the_interval_allows_for_as_many_comparisons_as_the_test_does():
    # McNemar: p = 2 / 2^9 = 0.0039 < 0.05 / 9. Of the 60 stretches of four queries, which is how long blocks are here,
    # 42 hold none of the misses, so of all draws of 15 (42 / 60)^15 = 0.5 % show no difference: less than 2.5 % (1.3 %
    # with the allowance for few blocks) and more than 2.5 % / 9.
    pair = {"a": [SAME], "b": [misses(0, 1, 2, 20, 21, 22, 29, 30, 31)]}
    assert bold(RECALL, pair) == "a"
    assert bold(RECALL, {**pair, **{f"beaten {i}": [ALL_WRONG] for i in range(8)}}) == ""


@pytest.mark.parametrize(("length", "n_queries", "shuffled"), [(10, 60, False), (60, 600, False), (60, 600, True)])
def test_a_difference_of_one_stretch_of_the_route_separates_nothing_in_whatever_order_it_is_asked(
    length, n_queries, shuffled
):
    # p < 2 / 2^10, but many draws of blocks miss the stretch
    order = np.random.default_rng(0).permutation(n_queries) if shuffled else np.arange(n_queries)
    asked = {"n_places": n_queries, "positives": tuple(np.array([place]) for place in order)}
    hits = [int(not n_queries // 3 <= place < n_queries // 3 + length) for place in order]
    assert bold(RECALL, {"a": [run(hits=[1] * n_queries, **asked)], "b": [run(hits=hits, **asked)]}) == ""


def test_hits_by_luck_among_equal_scores_separate_nothing_and_rows_without_a_number_are_in_no_contest():
    two = np.full(60, 2)
    lucky = replace(SAME, outcome=replace(SAME.outcome, top_tied=two, tied=two))  # expected R@1 1 / 2
    assert bold(RECALL, {"a": [lucky], "b": [ALL_WRONG]}) == ""
    assert bold(RECALL, {"a": [SAME], "b": [lucky]}) == ""  # with luck the other one is right as often
    half = misses(*range(0, 60, 2))
    unlucky = replace(half, outcome=replace(half.outcome, top_tied=two, tied=np.where(np.arange(60) % 2, two, 1)))
    assert bold(RECALL, {"a": [SAME], "b": [unlucky]}) == "a"  # at best right at every other query
    third = misses(*(query for query in range(60) if query % 3))  # expected R@1 1 / 3, and no luck in it
    assert bold(RECALL, {"a": [lucky], "b": [third]}) == ""
    nothing = np.zeros(60, np.int64)
    undefined = replace(SAME, outcome=replace(SAME.outcome, n_positives=nothing, tied=nothing, above=nothing + 10))
    assert bold(RECALL, {"a": [SAME], "b": [spread(6)], "c": [undefined]}) == "a"
    assert bold(RECALL, {"a": [SAME], "c": [undefined]}) == ""


def timed(match_ms, encode_ms=0.001, **changes):
    seconds = [[encode_ms / 1e3] * len(match_ms), [each / 1e3 for each in match_ms]]
    return run(encode_seconds=seconds[0], match_seconds=seconds[1], **changes)


NEAR = (-0.02, -0.01, 0, 0.01, 0.02)
FAST, SLOW = [10.0, 10.1, 10.2, 10.3, 10.4], [20.0, 20.1, 20.2, 20.3, 20.4]


@pytest.mark.parametrize(
    ("fast", "slow", "best"),
    [
        # Mann-Whitney, exact: p = 2 / C(10, 5) = 0.0079 and 2 / C(8, 4) = 0.029
        ([timed(FAST)], [timed(SLOW, day="2025-12-31")], "fast"),
        ([timed(FAST[:4])], [timed(SLOW[:4])], ""),
        # a quarter faster
        ([timed(FAST)], [timed([10.2 * 1.26 + each for each in NEAR])], "fast"),
        ([timed(FAST)], [timed([10.2 * 1.24 + each for each in NEAR])], ""),
        # encode and match together: 110 ms against 20, and 25 ms against 40
        ([timed(FAST, encode_ms=100.0)], [timed(SLOW)], "slow"),
        ([timed(FAST, encode_ms=15.0)], [timed(SLOW, encode_ms=20.0)], "fast"),
        # a busy machine, another machine, and one pair of seeds that is not faster
        ([timed(FAST)], [timed(SLOW, notes=NOISY)], ""),
        ([timed(FAST)], [timed(SLOW, machine={**ABACUS, "processor": "Loom 3"})], ""),
        ([timed(FAST), timed(SLOW)], [timed(SLOW), timed(SLOW)], ""),
        # timed in another way
        ([timed(FAST)], [timed(SLOW, config={"timing": {"minimum_seconds": 0.01, "minimum_queries": 1}})], ""),
        ([timed(FAST)], [timed(SLOW, machine={**ABACUS, "libraries": {"torch": "2.6.0", "numba": "0.61"}})], ""),
        ([timed(FAST)], [timed(SLOW, machine={**ABACUS, "threads": 2})], ""),
        # a rate with other answers is never best and keeps others from it
        ([timed(FAST), timed(FAST, notes=(Note("answers", "other answers"),))], [timed(SLOW)], ""),
        ([timed(FAST)], [timed(SLOW, notes=(Note("answers", "other answers"),))], "fast"),
    ],
)
def test_a_rate_is_best_where_it_is_a_quarter_faster_than_all_others(fast, slow, best):
    assert bold(RATE, {"slow": slow, "fast": fast}) == best

"""Sequences and filters as views: a run in, a run out, and options in words."""

from dataclasses import replace

import numpy as np
import pytest
from little import Lookup, a_run, journey
from little_runs import QUICK, asked_for, table

from vprbench.api import BadInput
from vprbench.metrics.ranking import judge_scores, rank_places
from vprbench.metrics.sequences import Filter, Sequences
from vprbench.runs import answers
from vprbench.runs.get_or_run import get_or_run
from vprbench.runs.sequences import NoScoresError, apply_sequences, format_view_suffix, parse_views
from vprbench.runs.store import Store
from vprbench.runs.views import list_shown_queries, select_queries

N = 40


def aligned(n=N, positives=None, **changes):
    """A run whose query i shows place i, with noise that a single score hardly exceeds."""
    scores = np.random.default_rng(0).normal(size=(n, n)).astype(np.float32) + 1.5 * np.eye(n, dtype=np.float32)
    right = tuple(np.array([place]) for place in range(n)) if positives is None else positives
    places, values = rank_places(scores, 5)
    known = {"n_references": n, "positives": right, "top_places": places, "top_scores": values, "scores": scores}
    return a_run(**{**known, "outcome": judge_scores(scores, right), **changes})


def mean_hits(run):
    return float((run.outcome.above == 0).mean())


def test_a_sequence_of_one_answers_as_the_run_itself_and_longer_ones_for_the_query_at_the_end_or_in_the_middle():
    run = aligned()
    view = apply_sequences(run, Sequences(1))
    assert np.array_equal(view.top_places, run.top_places)
    assert np.array_equal(view.outcome.above, run.outcome.above)
    assert view.protocol == {**run.protocol, "sequence": "1 causal"}
    for window in ("causal", "centred"):
        view = apply_sequences(run, Sequences(8, window))
        assert mean_hits(view) > 0.9 > 0.5 > mean_hits(run)
        assert list_shown_queries(view).tolist() == [right[0] for right in view.positives]


def as_lens_scores(scores, positives, length):
    """LENS, step by step: sums along the diagonal, zeros around them, 3 places to either side, queries with a match."""
    padded, before = np.zeros_like(scores), (length - 1) // 2
    for query, place in np.ndindex(N - length + 1, N - length + 1):
        total = np.trace(scores[query : query + length, place : place + length]) / length
        padded[query + before, place + before] = total
    asked = [query for query in range(N) if len(positives[query])]
    found = [padded[query].any() and min(abs(padded[query].argmax() - positives[query])) <= 3 for query in asked]
    return float(np.mean(found))  # where all is padding, any place would do: a miss here


@pytest.mark.parametrize("length", [1, 4, 5])
def test_the_protocol_of_lens_counts_as_its_code_counts(length):
    positives = tuple(np.array([] if query % 9 == 4 else [max(0, query - 1)], np.int64) for query in range(N))
    run = aligned(query_breaks=np.array([10]), place_breaks=np.array([20]), positives=positives)
    scores = (run.scores - run.scores.min() + 1).astype(np.float32)
    run = replace(run, scores=scores, outcome=judge_scores(scores, positives))
    (view,) = (seen(run) for seen in parse_views({"length": length, "window": "lens"}))
    assert mean_hits(view) == pytest.approx(as_lens_scores(scores, positives, length))
    found = np.isfinite(view.outcome.best_score)
    full = [q for q in list_shown_queries(view) if (length - 1) // 2 <= q < N - length // 2]
    assert list_shown_queries(view)[found].tolist() == full
    assert view.protocol["sequence"] == f"{length} lens, within 3 places"
    assert len(view.outcome) == sum(len(places) > 0 for places in positives)


def test_queries_without_a_full_window_are_left_out_or_scored_with_what_there_is():
    run = aligned(query_breaks=np.array([10]), place_breaks=np.array([10]))
    left_out, shortened = apply_sequences(run, Sequences(4)), apply_sequences(run, Sequences(4, incomplete="shortened"))
    wanted = [*range(3, 10), *range(13, N)]
    assert list_shown_queries(left_out).tolist() == wanted
    assert len(shortened.outcome) == N
    assert np.array_equal(shortened.top_scores[wanted], left_out.top_scores)
    assert np.array_equal(shortened.top_scores[10], run.top_scores[10])  # it begins a new part
    told = [view.protocol["sequence"] for view in (left_out, shortened)]
    assert told == ["4 causal", "4 causal, incomplete shortened"]
    bridged = apply_sequences(run, Sequences(4, gaps="bridge"))
    assert list_shown_queries(bridged).tolist() == list(range(3, N))
    assert bridged.protocol["sequence"] == "4 causal, gaps bridge"
    some = select_queries(aligned(), np.array([3, 4, 5, 9, 10, 11]), {"places": "other"})
    assert list_shown_queries(apply_sequences(some, Sequences(3))).tolist() == [5, 11]
    with pytest.raises(BadInput, match="gaps:bridge"):
        apply_sequences(aligned(), Sequences(41))
    with pytest.raises(NoScoresError, match="scores=true"):
        apply_sequences(aligned(scores=None), Sequences(2))


@pytest.mark.usefixtures("surroundings")
def test_all_scores_are_kept_on_request_and_for_sequences_and_not_lost_when_a_run_is_made_again(tmp_path, monkeypatch):
    monkeypatch.setattr(answers, "_LARGEST_MATRIX", 10)

    def kept(folder="a", **asked):
        experiment = asked_for(Lookup(table(6, 4)), journey(6, 4), replace(QUICK, rates=False), **asked)
        return get_or_run(experiment, Store(tmp_path / folder)).run.scores is not None

    assert [kept(), kept(scores=True), kept(), kept(force=True)] == [False, True, True, True]
    assert kept("b", sequence=2)


BRIDGED = {"velocities": (0.8, 1), "gaps": "bridge"}


def test_options_in_words_and_the_names_of_their_files():
    for options, wanted, name in (
        ((None,), [], ""),
        ((4, False), [Sequences(4)], "-sequence-4"),
        (([2, 10], True), [Sequences(2), Sequences(10), Filter()], "-sequence-2-10-filter"),
        (
            ({"length": [4, 10], **BRIDGED},),
            [Sequences(4, **BRIDGED), Sequences(10, **BRIDGED)],
            "-sequence-4-10-velocities=0.8+1.0-gaps=bridge",
        ),
        ((None, {"back": -2, "ahead": 10}), [Filter(-2, 10)], "-filter-back=-2-ahead=10"),
    ):
        assert [view.keywords["options"] for view in parse_views(*options)] == wanted
        assert format_view_suffix(parse_views(*options)) == name

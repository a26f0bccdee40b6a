"""What the report says of each query, from worked examples and a slow count."""

from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from little import a_run
from PIL import Image
from report_page import SAD_WRONG, TEMPO_WRONG, UNANSWERABLE, answered, journey_run, right_place

from vprbench.metrics.accuracy import recall_at
from vprbench.paper.page.fitting import fitting, text_bytes
from vprbench.run.verdicts import Answers, by_interest, columns, judged, place_ranges, places_shown

NO = -np.inf  # the score of a place that is no candidate


def judged_alone(scores: list[float], right: list[int], **changes: object) -> Answers:
    return judged(answered([scores], [right], **changes))


def test_a_query_whose_best_place_is_right_is_right_by_the_gap_to_the_best_wrong_place() -> None:
    answers = judged_alone([0.125, 0.875, 0.5, 0.25], [1])
    assert (answers.verdicts, answers.margins.tolist(), answers.bounds) == ("r", [0.375], "=")
    assert answers.places.tolist() == [[1, 2, 3]]
    assert answers.scores.tolist() == [[0.875, 0.5, 0.25]]
    assert (answers.right_places.tolist(), answers.ranks.tolist()) == ([1], [1])


def test_a_wrong_query_has_the_negative_gap_to_its_right_place_which_may_stand_beyond_those_shown() -> None:
    answers = judged_alone([0.875, 0.5, 0.25, 0.125, 0.0], [3])
    assert (answers.verdicts, answers.margins.tolist(), answers.bounds) == ("w", [-0.75], "=")
    assert (answers.right_places.tolist(), answers.right_scores.tolist(), answers.ranks.tolist()) == ([3], [0.125], [4])


def test_a_tie_of_a_right_and_a_wrong_place_is_no_hit_and_lists_the_wrong_one_first() -> None:
    answers = judged_alone([0.75, 0.75, 0.5, 0.0], [0])
    assert (answers.verdicts, answers.margins.tolist(), answers.bounds) == ("t", [0.0], "=")
    assert answers.places.tolist() == [[1, 0, 2]]
    assert (answers.ranks.tolist(), answers.equals.tolist()) == ([1], [1])


def test_right_places_that_tie_among_themselves_are_a_hit() -> None:
    answers = judged_alone([0.75, 0.75, 0.5, 0.0], [0, 1])
    assert (answers.verdicts, answers.margins.tolist()) == ("r", [0.25])


def test_of_several_right_places_the_best_one_counts() -> None:
    answers = judged_alone([0.875, 0.0, 0.125, 0.5, 0.25], [2, 3, 4])
    assert (answers.verdicts, answers.right_places.tolist(), answers.margins.tolist()) == ("w", [3], [-0.375])


def test_a_right_place_that_ties_with_wrong_ones_lower_down_shares_their_ranks() -> None:
    answers = judged_alone([0.875, 0.5, 0.5, 0.5, 0.0], [2])
    assert (answers.verdicts, answers.ranks.tolist(), answers.equals.tolist()) == ("w", [2], [2])


def test_a_query_without_a_right_place_is_unanswerable_and_has_no_margin() -> None:
    answers = judged_alone([0.875, 0.5, 0.25, 0.0], [])
    assert (answers.verdicts, answers.bounds, answers.right_places.tolist()) == ("u", "?", [-1])
    assert np.isnan(answers.margins[0])


def test_a_query_without_any_candidate_is_wrong_and_has_no_margin() -> None:
    answers = judged_alone([NO, NO, NO, NO], [2])
    assert (answers.verdicts, answers.bounds, answers.ranks.tolist()) == ("w", "?", [0])
    assert answers.places.tolist() == [[-1, -1, -1]]
    assert answers.right_places.tolist() == [2]


def test_a_right_place_that_is_no_candidate_has_a_margin_below_all_others() -> None:
    answers = judged_alone([0.875, NO, 0.5, NO], [1])
    assert (answers.verdicts, answers.margins.tolist(), answers.ranks.tolist()) == ("w", [-np.inf], [0])
    assert answers.places.tolist() == [[0, 2, -1]]


def test_a_right_place_without_a_wrong_candidate_has_a_margin_above_all_others() -> None:
    answers = judged_alone([0.875, NO, NO, NO], [0])
    assert (answers.verdicts, answers.margins.tolist(), answers.bounds) == ("r", [np.inf], "=")


def test_where_the_best_places_alone_are_kept_a_margin_may_be_known_as_a_bound() -> None:
    scores, best_two = [0.875, 0.75, 0.5, 0.25], {"depth": 2}
    beyond = judged(replace(answered([scores], [[3]], **best_two), scores=None))
    assert (beyond.verdicts, beyond.margins.tolist(), beyond.bounds) == ("w", [-0.125], "<")
    assert beyond.right_scores.tolist() == [0.75]
    all_right = judged(replace(answered([scores], [[0, 1]], **best_two), scores=None))
    assert (all_right.verdicts, all_right.margins.tolist(), all_right.bounds) == ("r", [0.125], ">")
    kept = judged(replace(answered([scores], [[1]], **best_two), scores=None))
    assert (kept.verdicts, kept.margins.tolist(), kept.bounds) == ("w", [-0.125], "=")


def test_a_tie_is_exact_even_where_the_right_place_of_it_is_not_kept() -> None:
    answers = judged(replace(answered([[0.5, 0.5, 0.5, 0.0]], [[2]], depth=2), scores=None))
    assert (answers.verdicts, answers.margins.tolist(), answers.bounds) == ("t", [0.0], "=")


@pytest.mark.parametrize("depth", [2, 5, 9])
def test_verdicts_and_margins_agree_with_a_slow_count_under_many_ties(depth: int) -> None:
    random = np.random.default_rng(7)
    scores = random.integers(0, 6, (200, 9)).astype(np.float32)
    scores[random.random(scores.shape) < 0.1] = NO
    positives = [sorted(random.choice(9, random.integers(0, 4), replace=False).tolist()) for _ in range(200)]
    run = answered(scores, positives, depth=depth)
    for answers in (judged(run), judged(replace(run, scores=None))):
        for query, right in enumerate(positives):
            best_right = max((scores[query, place] for place in right), default=NO)
            best_wrong = max(scores[query, place] for place in range(9) if place not in right)
            bound, margin = answers.bounds[query], answers.margins[query]
            if not right:
                assert answers.verdicts[query] == "u"
            elif best_right == best_wrong:
                assert answers.verdicts[query] == ("w" if best_right == NO else "t")
            else:
                assert answers.verdicts[query] == ("r" if best_right > best_wrong else "w")
            if not right or best_right == best_wrong == NO:
                assert bound == "?"
            else:
                true = best_right - best_wrong
                assert {"=": margin == true, "<": margin >= true, ">": margin <= true}[bound]
        recall = recall_at(run.outcome, 1)
        assert recall is not None
        assert answers.verdicts.count("r") == round(recall.pessimistic * 200)
        assert answers.verdicts.count("r") + answers.verdicts.count("t") == round(recall.optimistic * 200)


def test_a_run_of_two_places_fills_the_third_with_nothing() -> None:
    answers = judged(answered([[0.25, 0.5]], [[1]]))
    assert answers.places.tolist() == [[1, 0, -1]]
    assert columns(answers)["scores"] == [0.5, 0.25, None]


def test_what_the_page_reads_is_plain_and_holds_every_query() -> None:
    scores = [[0.875, NO, 0.5], [0.875, NO, NO], [0.5, 0.25, 0.125], [1 / 3, 2 / 3, 0.0]]
    told = columns(judged(answered(scores, [[1], [0], [], [0]])))
    assert json.loads(json.dumps(told, allow_nan=False)) == {
        "verdicts": "wruw",
        "places": [0, 2, -1, 0, -1, -1, 0, 1, 2, 1, 0, 2],
        "scores": [0.875, 0.5, None, 0.875, None, None, 0.5, 0.25, 0.125, 0.66667, 0.33333, 0.0],
        "right": [1, 0, -1, 0],
        "rightScores": [None, 0.875, None, 0.33333],
        "ranks": [0, 1, 0, 2],
        "equals": {},
        "margins": ["-", "+", None, -0.33333],
        "bounds": "==?=",
    }


def test_a_run_with_a_map_of_its_own_making_is_judged_by_its_stored_outcome() -> None:
    assert judged(replace(a_run(), scores=None)).verdicts == "rrww"
    assert judged(replace(a_run(), scores=None)).ranks.tolist() == [1, 1, 3, 8]


@pytest.mark.parametrize(
    ("places", "text"), [([], ""), ([4], "4"), ([7, 3, 4, 5], "3-5, 7"), ([0, 1, 10, 11, 12], "0-1, 10-12")]
)
def test_places_read_as_ranges(places: list[int], text: str) -> None:
    assert place_ranges(np.array(places, np.int64)) == text


def test_the_places_shown_are_the_best_three_and_the_right_ones() -> None:
    first = judged_alone([0.5, 0.375, 0.25, 0.125, 0.0, 0.0], [4])
    second = judged_alone([0.0, 0.0, NO, NO, NO, 0.5], [])
    assert places_shown([first, second]) == [0, 1, 2, 4, 5]


def noise(seed: int, quality: int = 95) -> bytes:
    written = io.BytesIO()
    pixels = np.random.default_rng(seed).integers(0, 256, (54, 96, 3), np.uint8)
    Image.fromarray(pixels).save(written, "WEBP", quality=quality)
    return written.getvalue()


def test_queries_that_are_not_answered_right_come_first_with_their_places_and_then_all_others() -> None:
    run = journey_run(SAD_WRONG)
    listed = dict(by_interest(run))
    assert set([*listed][:6]) == {*SAD_WRONG, UNANSWERABLE}
    assert sorted(listed) == list(range(len(run.outcome)))
    assert all({right_place(query), *run.top_places[query, :3]} == listed[query] for query in (10, 40))


def test_two_runs_list_the_queries_that_both_answer_right_in_one_order() -> None:
    first, second = ([query for query, _ in by_interest(journey_run(wrong))] for wrong in (SAD_WRONG, TEMPO_WRONG))
    common = {*first} - {*SAD_WRONG, *TEMPO_WRONG, UNANSWERABLE}
    assert [query for query in first if query in common] == [query for query in second if query in common]
    assert sorted(common) != [query for query in first if query in common]  # from all over the journey


def test_frames_that_fit_stay_as_they_are() -> None:
    frames = [noise(seed) for seed in range(5)]
    assert fitting(frames, text_bytes(frames)) == frames


def test_frames_that_do_not_fit_become_coarser_and_stay_images_of_the_same_shape() -> None:
    frames = [noise(seed) for seed in range(5)]
    budget = text_bytes(frames) // 4
    made = fitting(frames, budget)
    assert made is not None
    assert text_bytes(made) <= budget
    for frame in made:
        with Image.open(io.BytesIO(frame)) as image:
            image.load()
            assert image.width / image.height == pytest.approx(96 / 54, rel=0.1)


def test_frames_that_cannot_fit_are_none_at_all() -> None:
    assert fitting([noise(0), noise(1)], 50) is None


def test_frames_that_are_not_kept_stay_empty_where_the_others_become_coarser() -> None:
    frames = [noise(0), b"", noise(1), b""]
    made = fitting(frames, text_bytes(frames) // 4)
    assert made is not None
    assert [bool(frame) for frame in made] == [True, False, True, False]


def test_no_frames_always_fit() -> None:
    assert fitting([], -1) == []

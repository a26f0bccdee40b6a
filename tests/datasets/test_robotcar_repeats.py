"""Images that a list names for several places: what they leave of recall at 1, and what is said of them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vprbench.datasets.oxford_robotcar.lists import published_timestamps
from vprbench.datasets.oxford_robotcar.repeats import ceiling, remarks, sharing, steps_back
from vprbench.datasets.readers.traverses import every
from vprbench.metrics.accuracy import recall_at
from vprbench.metrics.ranking import outcome

PUBLISHED = {traverse: every(published_timestamps(traverse), 7, 450) for traverse in ("sun", "rain", "dusk")}
DIAGONAL = tuple(np.array([place]) for place in range(450))


def best_by_trying(references: Sequence[int], queries: Sequence[int], positives: Sequence[np.ndarray]) -> float:
    """The best recall at 1 of all answers that images allow: for each query image some groups of places tie as best."""
    groups, images = sorted(set(references)), sorted(set(queries))
    answers = [set(some) for size in range(1, len(groups) + 1) for some in combinations(groups, size)]
    best = 0.0
    for chosen in product(answers, repeat=len(images)):
        answer = dict(zip(images, chosen, strict=True))
        scores = np.array([[float(group in answer[image]) for group in references] for image in queries], np.float32)
        recall = recall_at(outcome(scores, tuple(positives)), 1)
        best = max(best, recall.expected if recall else 0.0)
    return best


@st.composite
def small_lists(draw: st.DrawFn) -> tuple[list[int], list[int], list[np.ndarray]]:
    references = draw(st.lists(st.integers(0, 2), min_size=1, max_size=5))
    queries = draw(st.lists(st.integers(0, 2), min_size=1, max_size=4))
    places = st.sets(st.integers(0, len(references) - 1), max_size=3)
    positives = draw(st.lists(places, min_size=len(queries), max_size=len(queries)))
    return references, queries, [np.array(sorted(right), np.int64) for right in positives]


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(small_lists())
def test_the_ceiling_is_the_best_of_all_answers_that_images_allow(
    case: tuple[list[int], list[int], list[np.ndarray]],
) -> None:
    assert ceiling(*case) == pytest.approx(best_by_trying(*case))


# The published list; the counts of distinct images and of steps back are those of the list's description


def test_both_published_reference_traverses_together_leave_one_pair_of_queried_places_alike() -> None:
    both = [*zip(PUBLISHED["sun"], PUBLISHED["rain"], strict=True)]
    alike = [(a, b) for a in range(450) for b in range(a) if both[a] == both[b]]
    queried = [pair for pair in alike if min(pair) >= 90]
    assert (len(alike), len(queried)) == (2, 1)
    assert ceiling(both, PUBLISHED["dusk"][90:], DIAGONAL[90:]) == pytest.approx(359 / 360)


@pytest.mark.parametrize(("traverse", "steps"), [("sun", 55), ("rain", 59), ("dusk", 5)])
def test_steps_back_in_time_are_those_of_the_list(traverse: str, steps: int) -> None:
    assert steps_back(PUBLISHED[traverse]) == steps


def test_a_row_that_repeats_the_one_before_is_no_step_back() -> None:
    assert steps_back([3, 3, 2, 5]) == 1


@pytest.mark.parametrize(("traverse", "places"), [("sun", 10), ("rain", 4), ("dusk", 2)])
def test_places_that_share_an_image_are_counted_all(traverse: str, places: int) -> None:
    # 445, 448 and 449 distinct images of 450, and none stands at more than two places.
    assert sharing(PUBLISHED[traverse]) == places


def test_a_reader_is_told_in_two_lines() -> None:
    maps = {traverse: PUBLISHED[traverse] for traverse in ("sun", "rain")}
    images, steps = remarks(maps, PUBLISHED["dusk"][90:], DIAGONAL[90:], 0)
    assert re.findall(r"[\d.]+", images) == ["10", "450", "4", "450", "0", "360", "1", "0", "99.72"]
    assert re.findall(r"[\d.]+", steps) == ["55", "449", "59", "449", "4", "359"]

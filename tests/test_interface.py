"""The contract: what a descriptor method gets for free, and parts of a dataset that do not fit."""

import numpy as np
import pytest

from vprbench.images import Images
from vprbench.interface import BadInput, Dataset, DescriptorMethod, NotFittedError, best_image_of_place


class Colour(DescriptorMethod):
    """The mean colour as a unit vector; counts the images of every call."""

    def __init__(self):
        self.encoded = []

    def encode(self, images):
        self.encoded.append(len(images))
        mean = np.array([image.mean(axis=(0, 1)) for image in images], np.float32).reshape(-1, 3)
        return mean / np.linalg.norm(mean, axis=1, keepdims=True)


RED, GREEN, OLIVE = (200, 0, 0), (0, 9, 0), (30, 40, 0)


def plain(*colours):
    return Images.from_arrays([np.full((2, 2, 3), colour, np.uint8) for colour in colours])


def dataset(n_references=4, n_queries=2, **parts):
    parts = {
        "name": "mine",
        "references": plain(*[RED] * n_references),
        "places": np.arange(n_references),
        "queries": plain(*[RED] * n_queries),
        "positives": (np.array([0]),) * n_queries,
        "protocol": {},
    } | parts
    return Dataset(**parts)


def answer(**parts):
    with pytest.raises(BadInput) as error:
        dataset(**parts)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_a_descriptor_method_scores_by_the_inner_product():
    # OLIVE is (0.6, 0.8, 0) as a unit vector
    scores = Colour().fit(plain(RED, GREEN), np.arange(2)).query(plain(OLIVE, RED))
    assert scores == pytest.approx(np.array([[0.6, 0.8], [1, 0]]), abs=1e-6)


def test_a_descriptor_method_takes_the_best_image_of_a_place():
    scores = Colour().fit(plain(RED, GREEN, GREEN, OLIVE), np.array([0, 1, 0, 1])).query(plain(OLIVE))
    assert scores == pytest.approx(np.array([[0.8, 1]]), abs=1e-6)


def test_a_descriptor_method_encodes_its_references_in_blocks():
    method = Colour().fit(plain(*[RED] * 150), np.arange(150))
    assert sum(method.encoded) == 150
    assert max(method.encoded) < 150


def test_a_descriptor_method_keeps_the_order_of_its_references():
    colours = [(1 + i, 200 - i, 0) for i in range(150)]
    scores = Colour().fit(plain(*colours), np.arange(150)).query(plain(*colours[::-1]))
    assert scores.argmax(axis=1).tolist() == list(range(150))[::-1]


def test_a_descriptor_method_forgets_its_earlier_map():
    method = Colour().fit(plain(RED, GREEN), np.arange(2)).fit(plain(GREEN), np.arange(1))
    assert method.query(plain(OLIVE)) == pytest.approx(np.array([[0.8]]), abs=1e-6)


def test_a_descriptor_method_keeps_its_own_copy_of_the_places():
    places = np.array([1, 0])
    method = Colour().fit(plain(RED, GREEN), places)
    places[:] = [0, 1]
    assert method.query(plain(RED)).argmax() == 1


def test_a_descriptor_method_without_a_map_says_what_to_do():
    with pytest.raises(NotFittedError, match=r"Colour has no map yet: call fit\(references, places\) first"):
        Colour().match(np.zeros((1, 3), np.float32))


@pytest.mark.parametrize(
    "places",
    [[0, 1, 2], [2, 0, 1], [0, 0, 1, 1], [0, 1, 0, 1], [1, 1, 1, 0, 2, 0], [0] * 5, [0]],
)
def test_a_place_is_worth_its_most_similar_image(places):
    similarity = np.random.default_rng(0).normal(size=(6, len(places))).astype(np.float32)
    expected = [
        [max(row[i] for i in range(len(places)) if places[i] == place) for place in range(max(places) + 1)]
        for row in similarity
    ]
    assert np.array_equal(best_image_of_place(similarity, np.array(places)), expected)


def test_the_best_image_of_a_place_counts_where_all_are_negative():
    similarity = np.array([[-9, -3, -7, -5]], np.float32)
    assert best_image_of_place(similarity, np.array([0, 1, 0, 1])).tolist() == [[-7, -3]]


def test_no_queries_have_no_best_images():
    assert best_image_of_place(np.empty((0, 4), np.float32), np.array([0, 1, 0, 1])).shape == (0, 2)


def test_a_place_of_no_candidate_keeps_its_minus_infinity():
    similarity = np.array([[-np.inf, 1, -np.inf, 2]], np.float32)
    assert best_image_of_place(similarity, np.array([0, 1, 0, 1])).tolist() == [[-np.inf, 2]]


def test_the_number_of_places_is_counted():
    assert dataset(places=np.array([0, 1, 0, 1])).n_places == 2


def test_a_query_may_have_several_right_places_or_none():
    assert dataset(positives=(np.array([0, 3]), np.array([], np.int64))).n_places == 4


def test_a_dataset_without_references_is_refused():
    assert "dataset mine has no reference images" in answer(n_references=0, places=np.array([], np.int64))


def test_a_dataset_without_queries_is_refused():
    assert "dataset mine has no query images" in answer(n_queries=0)


def test_places_of_another_number_than_the_references_are_refused_with_both_numbers():
    assert "4 reference images but 3 place ids" in answer(places=np.arange(3))


def test_a_gap_in_the_places_is_refused():
    assert "without a gap" in answer(places=np.array([0, 1, 1, 4]))


def test_the_places_missing_in_a_gap_are_said_to_be_missing():
    message = answer(places=np.array([0, 1, 1, 4]))  # 2 and 3 are missing
    assert "[2, 3]" in message
    assert "[2, 3] came" not in message


def test_a_negative_place_is_refused_with_its_number():
    assert "-1 came" in answer(places=np.array([-1, 0, 1, 2]))


def test_ground_truth_of_another_number_than_the_queries_is_refused_with_both_numbers():
    assert "2 queries but ground truth for 1" in answer(positives=(np.array([0]),))


@pytest.mark.parametrize(("right", "culprit"), [([1, 4], 4), ([-1], -1), ([-2, 1], -2)])
def test_a_right_place_that_does_not_exist_is_refused_with_its_query_and_number(right, culprit):
    message = answer(positives=(np.array([0]), np.array(right)))
    assert f"the ground truth of query 1 (image 1) names place {culprit}, but places run from 0 to 3" in message

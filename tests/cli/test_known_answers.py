"""The rendered journeys where the right answer of any sound method and metric is known beforehand."""

import numpy as np
import pytest

from vprbench.datasets.street import street
from vprbench.datasets.synthetic import synthetic
from vprbench.errors import BadInput
from vprbench.methods.sad import SAD
from vprbench.metrics.tolerance import hits_within

PLACES = 40
JOURNEYS = pytest.mark.parametrize(("journey", "season"), [(synthetic, "summer"), (street, "rain")])


def answered(dataset):
    """The best place of each query under SAD, which gives a frame itself the highest score there is."""
    scores = SAD().fit(dataset.references, dataset.places).query(dataset.queries)
    return scores, scores.argmax(axis=1)


@JOURNEYS
def test_of_identical_traverses_every_query_finds_its_place(journey, season):
    dataset = journey(places=PLACES, references=[season], query=season, first_query_place=0)
    assert answered(dataset)[1].tolist() == list(range(PLACES))


@pytest.mark.parametrize("shift", [3, -2])
@JOURNEYS
def test_a_shifted_traverse_finds_places_so_far_off_and_never_the_right_one(journey, season, shift):
    dataset = journey(
        places=PLACES, references=[season], query=season, first_query_place=5, query_places=30, query_shift=shift
    )
    scores, best = answered(dataset)
    assert best.tolist() == [place + shift for place in range(5, 35)]
    order = np.argsort(-scores, axis=1, kind="stable")[:, :5]
    hits = hits_within(
        order, np.take_along_axis(scores, order, axis=1), dataset.positives, (0, abs(shift) - 1, abs(shift))
    )
    assert hits.mean(axis=1).tolist() == [0.0, 0.0, 1.0]


@JOURNEYS
def test_queries_beyond_the_map_have_no_right_place_and_look_like_none_of_it(journey, season):
    dataset = journey(places=PLACES, references=[season], query=season, first_query_place=0, unanswerable=10)
    assert [len(right) for right in dataset.positives] == [1] * PLACES + [0] * 10
    mapped = {image.tobytes() for image in dataset.references}
    assert not mapped & {image.tobytes() for image in dataset.queries[PLACES:]}


def test_the_protocol_says_what_was_damaged_and_a_shift_beyond_the_journey_is_refused():
    sound = synthetic(places=PLACES).protocol
    damaged = synthetic(places=PLACES, query_shift=3, unanswerable=2).protocol
    assert {name: damaged[name] for name in damaged.keys() - sound.keys()} == {"query_shift": 3, "unanswerable": 2}
    with pytest.raises(BadInput, match=r"dataset\.query_shift=-1"):
        synthetic(places=PLACES, query_shift=-1, first_query_place=0)

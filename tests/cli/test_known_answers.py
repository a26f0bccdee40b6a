"""The rendered railway where the right answer of any sound method and metric is known beforehand."""

import numpy as np
import pytest

from vprbench.datasets.synthetic import synthetic
from vprbench.methods.sad import SAD
from vprbench.metrics.accuracy import hits_within


@pytest.mark.parametrize("shift", [0, 3, -2])
def test_a_traverse_finds_places_as_far_off_as_it_is_shifted_and_beyond_the_map_none(shift):
    asked = {"places": 40, "references": ["summer"], "query": "summer", "query_shift": shift}
    dataset = synthetic(first_query_place=5, query_places=30, unanswerable=3, **asked)
    scores = SAD().fit(dataset.references, dataset.places).query(dataset.queries)
    order = np.argsort(-scores, axis=1, kind="stable")[:, :5]
    assert order[:30, 0].tolist() == [place + shift for place in range(5, 35)]
    tolerances = (0, max(0, abs(shift) - 1), abs(shift))
    hits = hits_within(order, np.take_along_axis(scores, order, axis=1), dataset.positives, tolerances)
    assert hits[:, :30].mean(axis=1).tolist() == [float(shift == 0)] * 2 + [1.0]
    mapped = {image.tobytes() for image in dataset.references}
    assert not mapped & {image.tobytes() for image in dataset.queries[30:]}

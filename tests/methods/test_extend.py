"""Places learnt after the fit: what is appended is the map of all, and neurons join a network that stays as it is."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.hog import HOG
from vprbench.methods.pca import PCA
from vprbench.methods.sad import SAD
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.plugins.rules import Journey

WORLD = Journey.draw(3)
IMAGES, QUERIES = Images.from_arrays(WORLD.references), Images.from_arrays(WORLD.queries)
SMALL: dict[str, Any] = {"height": 12, "width": 12, "max_module": 8}


def learnt(method: Method, first: int, *more: int) -> Any:
    """Fit the first places, then learn those up to each of the next numbers."""
    for start, end in zip((0, first, *more), (first, *more), strict=False):
        own = np.flatnonzero((WORLD.places >= start) & (WORLD.places < end))
        (method.extend if start else method.fit)(IMAGES[own], WORLD.places[own])
    return method


@pytest.mark.parametrize("make", [SAD, HOG])
def test_a_map_that_grew_answers_as_one_that_was_learnt_at_once(make: Callable[[], Method]) -> None:
    grown = learnt(make(), 12, 13, 14, 19, 20)
    at_once = make().fit(IMAGES, WORLD.places)
    assert grown.query(QUERIES) == pytest.approx(at_once.query(QUERIES), rel=1e-6)
    again = grown.fit(IMAGES, WORLD.places)
    assert np.array_equal(again.query(QUERIES), at_once.query(QUERIES))


@pytest.mark.parametrize("make", [SAD, HOG, lambda: VPRTempo(**SMALL)])
def test_new_places_follow_the_known_ones_without_a_gap_and_after_a_fit(make: Callable[[], Method]) -> None:
    new = np.flatnonzero(WORLD.places >= 15)
    with pytest.raises(NotFittedError):
        make().extend(IMAGES[new], WORLD.places[new])
    method = learnt(make(), 15)
    for wrong in (WORLD.places[new] - 1, WORLD.places[new] + 1, WORLD.places[new][1:]):
        with pytest.raises(BadInput):
            method.extend(IMAGES[new], wrong)
    assert method.query(QUERIES).shape[1] == 15


@pytest.mark.parametrize("method", [PCA(), HOG(index="sq8"), VPRTempo(**SMALL, silent_winner=True)])
def test_what_learns_its_places_together_says_so(method: Method) -> None:
    assert not method.extends
    with pytest.raises(BadInput):
        learnt(method, 15, 16)


@pytest.mark.parametrize(
    "rules",
    [{}, {"rules": "reference"}, {"calibrated_scores": True, "output_rule": "covariance", "feature_rule": "rates"}],
)
def test_known_neurons_keep_their_weights_and_after_a_module_of_new_ones_another_begins(rules: dict[str, Any]) -> None:
    before, after = learnt(VPRTempo(**SMALL, **rules), 15).state(), learnt(VPRTempo(**SMALL, **rules), 15, 18, 19, 20)
    grown = after.state()
    for name in ("outputs_0", "outputs_1", "output_thresholds_1"):
        assert np.array_equal(before[name], grown[name])
    assert [len(grown[f"outputs_{module}"]) for module in range(3)] == [8, 7, 5]
    assert [len(learnt(VPRTempo(**SMALL, **rules), 8, 12, 20).state()[f"outputs_{n}"]) for n in range(3)] == [8, 4, 8]
    assert all(np.array_equal(features, grown["features"][1]) for features in grown["features"][1:])
    readable = learnt(VPRTempo(**SMALL, **rules, engine="readable"), 15, 18, 19, 20).state()
    assert grown["outputs_2"] == pytest.approx(readable["outputs_2"], abs=1e-3)
    of_two = learnt(VPRTempoEnsemble(**SMALL, **rules, members=2), 15, 16, 20)
    restored = VPRTempoEnsemble(**SMALL, **rules, members=2).restore(of_two.state())
    assert restored.query(QUERIES) == pytest.approx(of_two.query(QUERIES), abs=1e-5)
    with pytest.raises(BadInput):
        restored.extend(IMAGES[:1], np.array([20]))

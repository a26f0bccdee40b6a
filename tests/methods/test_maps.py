"""What every method without a published network does with its arguments and its map, and with places learnt later."""

import re

import numpy as np
import pytest
from described_images import drawn_images

from vprbench.api.images import Images
from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.cohog import CoHOG
from vprbench.methods.densevlad.method import DenseVLAD
from vprbench.methods.flyhash import FlyHash
from vprbench.methods.hog import HOG
from vprbench.methods.hyperdimensional import HyperDimensional
from vprbench.methods.pca import PCA
from vprbench.methods.random_projection import RandomProjection
from vprbench.methods.sad import SAD
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.plugins import registry
from vprbench.plugins.rules import Journey

IMAGES = Images.from_arrays(drawn_images(*[(40, 48)] * 12))
METHODS = {
    "cohog": lambda: CoHOG(size=64, cell=8, entropy_size=20, entropy_radius=3),
    "densevlad": lambda: DenseVLAD(words=6, n_components=0),
    "flyhash": FlyHash,
    "hog": lambda: HOG(height=32, width=40),
    "hyperdimensional": HyperDimensional,
    "pca": PCA,
    "random_projection": RandomProjection,
    "sad": SAD,
}
STORED = ["cohog", "densevlad", "pca"]

#: Arguments of which each does not fit.
REFUSED = {
    "cohog": {"size": 16, "cell": 0, "bins": 1, "sobel": 4, "entropy_radius": -1, "entropy_threshold": float("nan")},
    "densevlad": {"words": 0, "n_components": -1},
    "flyhash": {"units": 0, "summed": 785, "winners": 7841},
    "hog": {"height": 500, "width": 8, "cell": 0, "block": 0, "stride": 0, "bins": 256, "sigma": 0.0},
    "hyperdimensional": {"cell": 33, "stride": 0, "reach": 0.0, "components": 0},
    "pca": {"components": 0},
    "random_projection": {"components": 0},
}
#: Arguments that do not fit one another; the refusal names the first and, here last, another.
TOGETHER = [
    ("cohog", {"size": 500}, "method.cell=16"),
    ("cohog", {"region_cells": 0}, ""),
    ("cohog", {"entropy_size": 0}, ""),
    ("flyhash", {"winners": 7841}, "method.units=7840"),
    ("flyhash", {"summed": 0}, "784 pixels"),
    ("hog", {"block": 16, "cell": 12}, "method.cell=12"),
    ("hog", {"bins": 0}, ""),
    ("hyperdimensional", {"stride": 33, "features": "oriented"}, ""),
    ("pca", {"height": 0, "preprocessing": "grey"}, "method.width=28"),
    ("sad", {"width": 0, "preprocessing": "grey"}, ""),
]


@pytest.fixture(params=METHODS)
def make(request):
    return METHODS[request.param]


@pytest.mark.parametrize(
    ("name", "arguments", "besides"),
    [*((name, {one: value}, "") for name, wrong in REFUSED.items() for one, value in wrong.items()), *TOGETHER],
)
def test_arguments_that_do_not_fit_are_named(name, arguments, besides):
    argument, value = next(iter(arguments.items()))
    with pytest.raises(BadInput, match=rf"method\.{argument}={value}\b.*{re.escape(besides)}"):
        registry.entries("method")[name].target()(**arguments).fit(IMAGES, np.arange(12))


def test_of_several_traverses_the_most_similar_image_of_a_place_counts(make):
    places = np.array([3, 0, 1, 2, 0, 1, 3, 2, 2, 0, 1, 3])
    each = make().fit(IMAGES, np.arange(12)).query(IMAGES)
    best = np.stack([each[:, places == place].max(1) for place in range(4)], axis=1)
    assert make().fit(IMAGES, places).query(IMAGES) == pytest.approx(best, abs=1e-6)
    assert np.array_equal(best.argmax(1), places)


def test_fit_keeps_its_own_copy_of_the_places_and_no_queries_have_no_scores(make):
    places = np.arange(12)[::-1].copy()
    method = make().fit(IMAGES, places)
    before = method.query(IMAGES)
    places[:] = 0
    assert np.array_equal(method.query(IMAGES), before)
    assert method.query(IMAGES[:0]).shape == (0, 12)
    with pytest.raises(NotFittedError, match=r"call fit\(references, places\) first"):
        make().match(method.encode(IMAGES))


@pytest.mark.parametrize("name", STORED)
def test_a_stored_map_answers_as_the_learnt_one(name):
    learnt = METHODS[name]().fit(IMAGES, np.arange(12))
    assert np.array_equal(METHODS[name]().restore(learnt.state()).query(IMAGES), learnt.query(IMAGES))


@pytest.mark.parametrize("name", STORED)
def test_arrays_that_are_no_map_are_refused_by_name_and_leave_none(name):
    method = METHODS[name]().fit(IMAGES, np.arange(12))
    state = dict(method.state())
    broken = [
        ("weights", state | {"weights": np.zeros(3)}),
        ("places", state | {"places": state["places"] + 1}),
        ("places", state | {"places": np.array(0)}),
    ]
    for array, values in state.items():
        broken += [(array, state | {array: wrong}) for wrong in (values[:-1], values.astype(np.float16))]
        broken.append((array, {name: kept for name, kept in state.items() if name != array}))
        broken += [] if array == "places" else [(array, state | {array: np.full_like(values, np.nan)})]
    for array, wrong in broken:
        with pytest.raises(BadInput, match=array):
            method.restore(wrong)
    with pytest.raises(NotFittedError):
        method.state()


WORLD = Journey.draw(3)
TRAVERSES, QUERIES = Images.from_arrays(WORLD.references), Images.from_arrays(WORLD.queries)
TEMPO = {"height": 12, "width": 12, "max_module": 8}


def learnt(method, first, *more):
    """Fit the first places, then learn those up to each of the next numbers."""
    for start, end in zip((0, first, *more), (first, *more), strict=False):
        own = np.flatnonzero((WORLD.places >= start) & (WORLD.places < end))
        (method.extend if start else method.fit)(TRAVERSES[own], WORLD.places[own])
    return method


@pytest.mark.parametrize("make", [SAD, HOG])
def test_a_map_that_grew_answers_as_one_that_was_learnt_at_once(make):
    grown = learnt(make(), 12, 13, 14, 19, 20)
    at_once = make().fit(TRAVERSES, WORLD.places)
    assert grown.query(QUERIES) == pytest.approx(at_once.query(QUERIES), rel=1e-6)
    again = grown.fit(TRAVERSES, WORLD.places)
    assert np.array_equal(again.query(QUERIES), at_once.query(QUERIES))


@pytest.mark.parametrize("make", [SAD, HOG, lambda: VPRTempo(**TEMPO)])
def test_new_places_follow_the_known_ones_without_a_gap_and_after_a_fit(make):
    new = np.flatnonzero(WORLD.places >= 15)
    with pytest.raises(NotFittedError):
        make().extend(TRAVERSES[new], WORLD.places[new])
    method = learnt(make(), 15)
    for wrong in (WORLD.places[new] - 1, WORLD.places[new] + 1, WORLD.places[new][1:]):
        with pytest.raises(BadInput):
            method.extend(TRAVERSES[new], wrong)
    assert method.query(QUERIES).shape[1] == 15


@pytest.mark.parametrize("method", [PCA(), HOG(index="sq8"), VPRTempo(**TEMPO, silent_winner=True)])
def test_what_learns_its_places_together_says_so(method):
    assert not method.extends
    with pytest.raises(BadInput):
        learnt(method, 15, 16)


@pytest.mark.parametrize(
    "rules",
    [{}, {"rules": "reference"}, {"calibrated_scores": True, "output_rule": "covariance", "feature_rule": "rates"}],
)
def test_known_neurons_keep_their_weights_and_after_a_module_of_new_ones_another_begins(rules):
    before, after = (learnt(VPRTempo(**TEMPO, **rules), 15).state(), learnt(VPRTempo(**TEMPO, **rules), 15, 18, 19, 20))
    grown = after.state()
    for name in ("outputs_0", "outputs_1", "output_thresholds_1"):
        assert np.array_equal(before[name], grown[name])
    assert [len(grown[f"outputs_{module}"]) for module in range(3)] == [8, 7, 5]
    assert [len(learnt(VPRTempo(**TEMPO, **rules), 8, 12, 20).state()[f"outputs_{n}"]) for n in range(3)] == [8, 4, 8]
    assert all(np.array_equal(features, grown["features"][1]) for features in grown["features"][1:])
    readable = learnt(VPRTempo(**TEMPO, **rules, engine="readable"), 15, 18, 19, 20).state()
    assert grown["outputs_2"] == pytest.approx(readable["outputs_2"], abs=1e-3)
    of_two = learnt(VPRTempoEnsemble(**TEMPO, **rules, members=2), 15, 16, 20)
    restored = VPRTempoEnsemble(**TEMPO, **rules, members=2).restore(of_two.state())
    assert restored.query(QUERIES) == pytest.approx(of_two.query(QUERIES), abs=1e-5)
    with pytest.raises(BadInput):
        restored.extend(TRAVERSES[:1], np.array([20]))

"""Defaults of methods without a published network, arguments that they refuse, and how they learn places later."""

import math
import re
from dataclasses import fields

import numpy as np
import pytest
from described_images import drawn_images

from vprbench.api.images import Images
from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.hog import HOG
from vprbench.methods.sad import SAD
from vprbench.methods.vprtempo.ensemble import VPRTempoEnsemble
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.plugins import registry
from vprbench.plugins.rules import Journey

IMAGES = Images.from_arrays(drawn_images(*[(40, 48)] * 12))

#: Of a method, arguments of which each does not fit.
REFUSED = {
    "cohog": {
        **{"size": [16, 500], "cell": [0], "bins": [1], "region_cells": [0], "sobel": [4]},
        **{"entropy_radius": [-1], "entropy_size": [0], "entropy_threshold": [math.nan]},
    },
    "densevlad": {"words": [0], "n_components": [-1]},
    "flyhash": {"units": [0], "summed": [0, 785], "winners": [7841]},
    "gabor": {"height": [5], "block": [4], "epsilon": [0.0], "patch": [4]},
    "hog": {
        **{"height": [500], "width": [8], "cell": [0, 12], "block": [0]},
        **{"stride": [0], "bins": [0, 256], "sigma": [0.0]},
    },
    "hyperdimensional": {"cell": [33], "stride": [0], "reach": [0.0], "components": [0]},
    "oriented_binary": {
        **{"height": [0], "columns": [0], "orientations": [1], "block": [4]},
        **{"epsilon": [0.0, math.nan], "shares": [[], [0.0], [0.5, 1.2]]},
    },
    "pca": {"components": [0]},
    "random_projection": {"components": [0]},
    "sad": {"patch": [1, 6, -7], "height": [0], "width": [-1]},
    "vprsnn": {
        **dict.fromkeys(("places_per_module", "n_excitatory", "height"), (0,)),
        **dict.fromkeys(("time_step_ms", "presentation_ms", "weight_max", "excitatory_tau_ms"), (0.0,)),
        **dict.fromkeys(("rest_ms", "inhibitory_to_excitatory_weight"), (-1.0,)),
        **dict.fromkeys(("theta_start_mv", "weight_offset"), (math.nan,)),
        "inhibition_tau_ms": [0.1],  # no longer than a step
        "input_delay_max_ms": [-1.0, 151.0],  # longer than the rest
        "levels_per_hz": [0.0, 0.0255],  # a white pixel in every step
        "recorded_presentations": [0, 9],  # fewer than a module has images
        "calibration_places": [-1, 1],  # without an order that is shuffled
        **{"patch": [4], "hyperactive_threshold": [-1], "hyperactive_candidates": [[], [0, -5]]},
        **{"weight_scale": [math.inf], "published_weights": ["no such folder"], "seed": [-1, 2**32]},
    },
    "vprsnn_ensemble": {
        **{"seeds": [[], [0, 10, 0], [0, -1]], "member_epochs": [[5], [5, 5, 5, 5, 0]]},
        "member_thresholds": [[1, 2, 3], [1, 1, 1, 1, -1]],
    },
    "vprtempo": {
        **{"epochs": [0], "max_module": [0], "features_per_pixel": [0.0], "output_stdp_rate": [-0.1]},
        **{"itp_rate": [math.nan], "rate_min": [0.95], "p_excitatory": [1.5], "clip": [0.0], "annealing_interval": [0]},
    },
    "vprtempo_int8": {"features_per_pixel": [100.0]},  # more inputs than 32 bits can sum
}
ALONE = [(name, {one: value}) for name, own in REFUSED.items() for one, values in own.items() for value in values]
#: Arguments of which the first does not fit the others.
TOGETHER = [
    ("hyperdimensional", {"stride": 33, "features": "oriented"}),
    ("pca", {"height": 0, "preprocessing": "grey"}),
    ("sad", {"width": 0, "preprocessing": "grey"}),
    ("vprtempo", {"contrast_power": 0.0, "encoding": "oriented"}),
    ("vprtempo", {"rows": 0, "encoding": "oriented"}),
    ("vprtempo", {"height": 4, "encoding": "gabor"}),
    ("vprtempo", {"equal_output_weights": True, "rules": "reference"}),
    ("vprtempo", {"query_rule": "linear", "output_rule": "covariance"}),
]


@pytest.mark.parametrize(("name", "arguments"), [*ALONE, *TOGETHER])
def test_arguments_that_do_not_fit_are_named(name, arguments):
    argument, value = next(iter(arguments.items()))
    method = registry.find_entries("method")[name].target()(**arguments)
    with pytest.raises(BadInput, match=rf"(?i)method\.{argument}={re.escape(str(value))}(?![\d.])"):
        method.fit(IMAGES, np.arange(12))


@pytest.mark.parametrize(
    ("name", "differs"), [("vprsnn", {}), ("vprsnn_fast", {"fast": True}), ("vprsnn_ensemble", {}), ("vprtempo", {})]
)
def test_a_configuration_has_every_argument_and_its_default_of_the_class(name, differs):
    entry = registry.find_entries("method")[name]
    configured, own = entry.values(), entry.target()()
    defaults = {one.name: getattr(own, one.name) for one in fields(own) if one.init} | differs
    wanted = {**defaults, "seed": "${seed}"} | ({"device": "${device}"} if "device" in defaults else {})
    assert {key: configured[key] for key in defaults} == wanted


WORLD = Journey.draw(3)
TRAVERSES, QUERIES = Images.from_arrays(WORLD.references), Images.from_arrays(WORLD.queries)
TEMPO = {"height": 12, "width": 12, "max_module": 8}


def learnt(method, first, *more):
    """Fit the first places, then learn those up to each of the next numbers."""
    for start, end in zip((0, first, *more), (first, *more), strict=False):
        own = np.flatnonzero((WORLD.places >= start) & (WORLD.places < end))
        (method.extend if start else method.fit)(TRAVERSES[own], WORLD.places[own])
    return method


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

"""VPRTempo as a method: its modules, arguments, seeds and refusals, and what it reads of a frame."""

from dataclasses import fields
from functools import cache
from typing import get_args, get_type_hints

import numpy as np
import pytest
import torch
from tempo_networks import QUERIES, REFERENCES, RULE_SETS, SMALL, WORLD, fitted

from vprbench.api.images import Images
from vprbench.errors import BadInput, NotFittedError, TrainingDivergedError
from vprbench.methods.parts.filters.patches import PatchNormalisation
from vprbench.methods.vprtempo.encoding import make_spikes
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.methods.vprtempo.rules import PAPER, V1, Rules


@cache
def scores_of(**arguments):
    return fitted(**arguments).query(QUERIES)


@pytest.mark.parametrize("rules", [{}, {"output_rule": "covariance", "feature_rule": "rates"}], ids=["paper", "rates"])
def test_modules_draw_differently_and_the_first_learns_the_same_whether_or_not_others_follow(rules):
    first, before = np.flatnonzero(WORLD.places < 7), torch.random.get_rng_state()
    alone = VPRTempo(**SMALL, **rules).fit(REFERENCES[first], WORLD.places[first])
    assert scores_of(**rules)[:, :7] == pytest.approx(alone.query(QUERIES), abs=1e-6)
    # The same references in both modules: equal draws would give equal scores.
    half = np.tile(np.arange(8), 2)
    scores = VPRTempo(**SMALL, **rules).fit(REFERENCES[half], np.arange(16)).query(QUERIES)
    assert not np.allclose(scores[:, :8], scores[:, 8:], rtol=0.01)
    assert torch.equal(torch.random.get_rng_state(), before)


CHOICES = [field.name for field in fields(Rules)]


def another_value(name):
    """Return a value that the paper's rules do not have."""
    said = getattr(PAPER, name)
    if isinstance(said, bool):
        return not said
    if isinstance(said, str):
        return next(option for option in get_args(get_type_hints(Rules)[name]) if option != said)
    return said + 1


OTHER_VALUES = {
    **{"preprocessing": "A", "height": 13, "width": 13, "patch": 5, "max_module": 10, "features_per_pixel": 1.5},
    **{"epochs": 3, "stdp_rate": 0.004, "output_stdp_rate": 0.002, "itp_rate": 0.1, "threshold_max": 0.4},
    **{"rate_min": 0.3, "rate_max": 0.8, "p_excitatory": 0.2, "p_inhibitory": 0.4, "output_norm": 2.0},
    # No query here is silent: silent_winner has a test of its own in test_query.py.
    **{name: another_value(name) for name in CHOICES if name != "silent_winner"},
    "clip": 0.1,
}


@pytest.mark.parametrize("name", OTHER_VALUES)
def test_every_argument_changes_the_scores(name):
    # The modules train for 64 steps, so that annealing every 100 would never act.
    usual = {"annealing_interval": 10}
    assert not np.allclose(scores_of(**{**usual, name: OTHER_VALUES[name]}), scores_of(**usual), rtol=1e-3)


def test_the_defaults_are_those_of_table_1():
    own = VPRTempo()
    table = ("threshold_max", "stdp_rate", "itp_rate", "rate_min", "rate_max", "p_excitatory", "p_inhibitory")
    assert [getattr(own, name) for name in table] == [0.5, 0.005, 0.15, 0.2, 0.9, 0.1, 0.5]
    assert (PAPER.constant_input, V1.constant_input) == (0.1, 0.1)


@RULE_SETS
def test_a_diverged_training_is_an_error_and_leaves_the_method_unfitted(rules):
    method = VPRTempo(**SMALL, rules=rules).restore(fitted(rules=rules).state())
    method.stdp_rate = 50.0
    with pytest.raises(TrainingDivergedError, match="training diverged"):
        method.fit(REFERENCES, WORLD.places)
    with pytest.raises(NotFittedError):
        method.query(QUERIES)


@pytest.mark.parametrize(("size", "n_alike"), [((48, 64), 11), ((1, 1), 20)])
def test_references_that_show_nothing_are_called_so_and_no_diverged_training(size, n_alike):
    empty = [np.zeros((*size, 3), np.uint8)] * n_alike
    with pytest.raises(BadInput, match=f"{n_alike} of 20 images.* same input"):
        VPRTempo(**SMALL).fit(Images.from_arrays([*empty, *WORLD.references[n_alike:20]]), np.arange(20))


@pytest.mark.parametrize("variant", ["A", "B", "C"])
def test_spikes_are_the_levels_over_255_in_variant_c_by_the_8_bit_step(variant):
    image = np.full((12, 12, 3), 150, np.uint8)
    image[3, 3] = 100  # one dark pixel: all others are only somewhat above the mean, so no level is 255
    shown = Images.from_arrays([*WORLD.queries, image])
    levels = PatchNormalisation(variant, 12, 12, 7)(shown).astype(np.float64)
    largest = levels.max(1, keepdims=True)
    assert 127 < largest[-1] < 255
    expected = np.round(levels * 255 / largest) * largest / 255 / 255 if variant == "C" else levels / 255
    found = VPRTempo(preprocessing=variant, height=12, width=12).encode(shown)
    assert not make_spikes(np.zeros((1, 3), np.uint8), True).any()
    assert found.dtype == np.float32
    assert found == pytest.approx(expected, abs=1e-6)


INPUTS = {
    "oriented": {"encoding": "oriented", "height": 16, "width": 20, "rows": 4, "columns": 5, "max_module": 20},
    # At the paper's fan-in so many inputs that are active at once leave nearly all features silent.
    "gabor": {
        **{"encoding": "gabor", "height": 12, "width": 12, "features_per_pixel": 0.5, "max_module": 8},
        **{"p_excitatory": 0.02, "p_inhibitory": 0.02},
    },
}


@pytest.mark.parametrize("encoding", INPUTS)
def test_spikes_begin_with_the_input_and_another_input_is_refused_on_restoring(encoding):
    method = fitted(**INPUTS[encoding])
    layers, n_inputs = method.spikes(method.encode(QUERIES)), method.encoder().n_inputs
    assert [layer.name for layer in layers] == ["input", "feature", "output"]
    assert np.array_equal(layers[0].values, method.encode(QUERIES))
    assert layers[0].values.shape[1] == n_inputs
    with pytest.raises(BadInput, match=rf"reads {n_inputs} inputs, not the 144 of method\.encoding=patches"):
        VPRTempo(**SMALL).restore(method.state())

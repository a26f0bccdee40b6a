"""Several VPRSNN networks of the same places: each is the one of its seed, and their scores are summed."""

from functools import cache

import numpy as np
import pytest
from little_vprsnn import SMALL, WORLD, fitted, images, layers, references
from states import member, same

from vprbench.methods.vprsnn.ensemble import VPRSNNEnsemble

QUERIES = images(WORLD.queries)


def ensemble(**arguments):
    method = VPRSNNEnsemble(**{**SMALL, "seeds": [0, 10], **arguments})
    method.fit(*references(7))
    return method


@cache
def alone(**arguments):
    return fitted(7, **arguments)


@pytest.mark.parametrize(
    ("together", "first", "second"),
    [
        ({"seed": 3}, {"seed": 3}, {"seed": 13}),
        ({"member_epochs": [2, 5]}, {"epochs": 2}, {"seed": 10, "epochs": 5}),
        ({"member_thresholds": [0, 4]}, {"hyperactive_threshold": 0}, {"seed": 10, "hyperactive_threshold": 4}),
    ],
    ids=lambda given: str(given),
)
def test_each_member_is_the_network_of_its_own_seed_epochs_and_threshold(together, first, second):
    state = ensemble(**together).state()
    assert same(member(state, 0), alone(**first).state())
    assert same(member(state, 1), alone(**second).state())
    assert not same(member(state, 0), member(state, 1))


@pytest.mark.parametrize("change", [{}, {"assignment": "weighted", "hyperactive_threshold": 6}], ids=str)
def test_scores_are_the_sum_of_the_members_scores_and_spikes_those_of_the_first(change):
    trained = ensemble(seeds=[0, 10, 20], **change)
    together = VPRSNNEnsemble(**SMALL, seeds=[0, 10, 20], assignment=trained.assignment).restore(trained.state())
    assert same(together.state(), trained.state())
    codes = together.encode(QUERIES)
    parts = [alone(seed=seed, **change).match(codes).astype(np.float64) for seed in (0, 10, 20)]
    expected = np.sum([np.where(np.isneginf(part), 0, part) for part in parts], axis=0)
    expected[~expected.any(axis=1)] = -np.inf
    assert np.isfinite(expected).any()
    assert together.match(codes) == pytest.approx(expected, rel=1e-5)
    assert together.match(codes).dtype == np.float32
    first = layers(alone(**change), codes)
    assert all(np.array_equal(counts, first[name]) for name, counts in layers(together, codes).items())
    less = expected - expected.min(axis=1, keepdims=True)
    together.probabilities = True
    assert together.match(codes) == pytest.approx(less / less.sum(axis=1, keepdims=True), rel=1e-5)

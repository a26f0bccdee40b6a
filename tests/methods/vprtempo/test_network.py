"""A trained VPRTempo network as arrays: stored, restored, published by the authors, refused, and how fast it learns."""

from functools import cache

import numpy as np
import pytest
import torch
from tempo_networks import QUERIES, REFERENCES, RULE_SETS, SMALL, WORLD, fitted

from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.vprtempo.method import VPRTempo

SIDE = SMALL["height"]


def method(**arguments):
    return VPRTempo(**{**SMALL, **arguments})


def test_the_arrays_are_the_layers_of_each_module_without_padding_and_a_restored_network_follows_none_of_them():
    n_pixels, n_features, state = SIDE * SIDE, 2 * SIDE * SIDE, fitted().state()
    features = {"features": (3, n_features, n_pixels)}
    per_feature = dict.fromkeys(("constant", "feature_thresholds"), (3, n_features))
    outputs = {f"outputs_{module}": (size, n_features) for module, size in enumerate([7, 7, 6])}
    thresholds = {f"output_thresholds_{module}": (size,) for module, size in enumerate([7, 7, 6])}
    assert {name: array.shape for name, array in state.items()} == features | per_feature | outputs | thresholds
    assert all(array.dtype == np.float32 and array.flags.c_contiguous for array in state.values())
    copies = {name: array.copy() for name, array in state.items()}
    for array in copies.values():
        array.flags.writeable = False
    restored = method().restore(copies)
    for array in copies.values():
        array.flags.writeable = True
        array[:] = 7
    assert all(np.array_equal(array, state[name]) for name, array in restored.state().items())
    assert np.array_equal(restored.query(QUERIES), fitted().query(QUERIES))


def little():
    """Return the arrays of a network of two modules of 3 and 2 places, 4 features and 144 pixels."""
    draw = np.random.default_rng(0)
    shapes = {
        **{"features": (2, 4, SIDE * SIDE), "constant": (2, 4), "feature_thresholds": (2, 4)},
        **{"outputs_0": (3, 4), "outputs_1": (2, 4), "output_thresholds_0": (3,), "output_thresholds_1": (2,)},
    }
    return {name: draw.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}


def refusal(state, **arguments):
    """Return the line that refuses the arrays, and see that the method, which had a network, answers nothing."""
    asked = method().restore(little())
    assert asked.query(QUERIES).shape == (len(WORLD.queries), 5)
    for name, value in arguments.items():
        setattr(asked, name, value)
    with pytest.raises(BadInput) as error:
        asked.restore(state)
    for ask in (lambda: asked.query(QUERIES), asked.state):
        with pytest.raises(NotFittedError):
            ask()
    assert "\n" not in str(error.value)
    return str(error.value)


def test_an_array_that_is_missing_or_too_many_is_named():
    for name in little():
        line = refusal({other: array for other, array in little().items() if other != name})
        assert name in line.replace(",", " ").split()
    for name in ("means", "outputs", "outputs_2", "output_thresholds_2"):
        line = refusal({**little(), name: np.zeros((3, 4), np.float32)})
        assert ("_2" if "_2" in name else name) in line  # or the one that it lacks


@pytest.mark.parametrize("name", little())
def test_an_array_of_another_shape_or_without_finite_values_is_refused(name):
    own = little()[name]
    for array in (own[None], own[0], own.ravel()[0], own.reshape(-1, 1, 1, 1), own[:0]):
        assert "has the shape" in refusal({**little(), name: np.asarray(array)})
    for value in (np.nan, np.inf):
        assert name in refusal({**little(), name: np.full_like(own, value)})
    wider = np.concatenate([own, own[..., :1]], axis=-1)
    same = f"{name} has the shape {wider.shape}; wanted {own.shape}"
    assert ("145 inputs" if name == "features" else same) in refusal({**little(), name: wider})
    longer = np.concatenate([own, own[:1]])
    assert name.removeprefix("outputs") in refusal({**little(), name: longer})  # or it is held against its thresholds


N_FEATURES = 10
PUBLISHED = ("feature_layer.w.weight", "feature_layer.thr", "output_layer.w.weight", "output_layer.thr")


def checkpoint(sizes=(8, 4), n_features=N_FEATURES):
    """Return what the authors' code saves (64154e5): a state dictionary for each module, thresholds as (1, n)."""
    draw = np.random.default_rng(5)

    def layer(n_post, n_pre):
        return torch.from_numpy(draw.normal(0, n_pre**-0.5, (n_post, n_pre)).astype(np.float32))

    return {
        f"model_{module}": {
            "feature_layer.thr": torch.zeros(1, n_features),
            "feature_layer.w.weight": layer(n_features, SIDE * SIDE),
            "output_layer.thr": torch.zeros(1, size),
            "output_layer.w.weight": layer(size, n_features),
        }
        for module, size in enumerate(sizes)
    }


def flat(content):
    return {f"{module}.{name}": part.numpy() for module, layers in content.items() for name, part in layers.items()}


def products(content, x):
    """Return W_o W_f x, (n_queries, n_places), places module by module."""
    scores = []
    for module in range(len(content)):
        w_f, w_o = (content[f"model_{module}"][f"{name}_layer.w.weight"].double() for name in ("feature", "output"))
        scores.append((w_o @ (w_f @ torch.from_numpy(x.T).double())).numpy())
    return np.concatenate(scores).T


@pytest.mark.parametrize("sizes", [(5,), tuple(range(1, 13))], ids=str)
def test_a_published_network_scores_as_the_product_of_its_matrices(sizes):
    content = checkpoint(sizes)
    restored = method(rules="reference").restore(flat(dict(reversed(content.items()))))  # in any order
    x = restored.encode(QUERIES)
    assert restored.match(x) == pytest.approx(products(content, x), abs=2e-6)
    assert restored.match(x[:1]) == pytest.approx(products(content, x[:1]), abs=2e-6)


def test_published_thresholds_act_where_the_query_is_spiking():
    content = checkpoint((1,), 1)
    # All pixels at 1 leave 0.75.
    for name, value in zip(PUBLISHED, (1.0, SIDE * SIDE - 0.75, 1.0, 0.25), strict=True):
        content["model_0"][name][:] = value
    restored = method(rules="reference", query_rule="spiking").restore(flat(content))
    assert restored.match(np.ones((1, SIDE * SIDE), np.float32)) == pytest.approx(0.5, abs=1e-4)


FIRST_8 = np.flatnonzero(WORLD.places < 8)  # so few that an untrained output layer is not taken for a diverged one


@cache
def trained(**arguments):
    return method(max_module=5, **arguments).fit(REFERENCES[FIRST_8], WORLD.places[FIRST_8]).state()


def differing(one, other):
    """Return the names of arrays that differ, without the number of their module."""
    return {name.rstrip("_0123456789") for name, array in one.items() if not np.array_equal(array, other[name])}


@RULE_SETS
def test_the_output_layer_alone_learns_at_a_rate_of_its_own_by_default_at_stdp_rate(rules):
    slow = trained(rules=rules, stdp_rate=0.003)
    assert not differing(slow, trained(rules=rules, stdp_rate=0.003, output_stdp_rate=0.003))
    learnt = {"outputs", "output_thresholds"} if rules == "v1" else {"outputs"}
    assert differing(slow, trained(rules=rules, stdp_rate=0.003, output_stdp_rate=0.002)) == learnt
    still = {"rules": rules, "output_stdp_rate": 0.0}
    changed = differing(trained(**still), trained(**still, epochs=7))
    assert "features" in changed
    assert not changed & {"outputs", "output_thresholds"}

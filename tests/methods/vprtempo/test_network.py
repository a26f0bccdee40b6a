"""A trained VPRTempo network as arrays: stored, restored, published by the authors, refused, and how fast it learns."""

import numpy as np
import pytest
from tempo_networks import QUERIES, SMALL, fitted

from vprbench.errors import BadInput, NotFittedError
from vprbench.methods.vprtempo.method import VPRTempo

SIDE = SMALL["height"]


def method(**arguments):
    return VPRTempo(**{**SMALL, **arguments})


def test_the_arrays_are_the_layers_of_each_module_without_padding_and_a_restored_network_follows_none_of_them():
    n_pixels, n_features, state = SIDE * SIDE, 2 * SIDE * SIDE, fitted().state()
    shapes = {"features": (3, n_features, n_pixels)}
    shapes |= dict.fromkeys(("constant", "feature_thresholds"), (3, n_features))
    shapes |= {f"outputs_{module}": (size, n_features) for module, size in enumerate([7, 7, 6])}
    shapes |= {f"output_thresholds_{module}": (size,) for module, size in enumerate([7, 7, 6])}
    assert {name: array.shape for name, array in state.items()} == shapes
    assert all(array.dtype == np.float32 and array.flags.c_contiguous for array in state.values())
    copies = {name: array.copy() for name, array in state.items()}
    restored = method().restore(copies)
    for array in copies.values():
        array[:] = 7
    assert all(np.array_equal(array, state[name]) for name, array in restored.state().items())


PUBLISHED = ("feature_layer.w.weight", "feature_layer.thr", "output_layer.w.weight", "output_layer.thr")


def checkpoint(sizes, n_features=10):
    """Return the arrays that the authors' code saves (64154e5), thresholds as (1, n)."""
    draw, found = np.random.default_rng(5), {}
    for module, size in enumerate(sizes):
        for layer, shape in (("feature", (n_features, SIDE * SIDE)), ("output", (size, n_features))):
            found[f"model_{module}.{layer}_layer.thr"] = np.zeros((1, shape[0]), np.float32)
            weights = draw.normal(0, shape[1] ** -0.5, shape).astype(np.float32)
            found[f"model_{module}.{layer}_layer.w.weight"] = weights
    return found


def little(**changes):
    """Return the arrays of a network of two modules of 3 and 2 places, 4 features and 144 pixels."""
    draw = np.random.default_rng(0)
    shapes = {
        **{"features": (2, 4, SIDE * SIDE), "constant": (2, 4), "feature_thresholds": (2, 4)},
        **{"outputs_0": (3, 4), "outputs_1": (2, 4), "output_thresholds_0": (3,), "output_thresholds_1": (2,)},
    }
    return {name: draw.normal(size=shape).astype(np.float32) for name, shape in shapes.items()} | changes


def spoilt(name):
    """Yield arrays that cannot stand in the place of one."""
    own = little()[name]
    yield from (own[None], own.ravel()[0], own.reshape(-1, 1, 1, 1), own[:0], np.full_like(own, np.nan))
    yield np.concatenate([own, own[..., :1]], axis=-1)


@pytest.mark.parametrize(
    ("state", "culprit"),
    [
        *(({other: array for other, array in little().items() if other != name}, "lacks") for name in little()),
        *((little(**{name: np.zeros((3, 4), np.float32)}), name) for name in ("means", "output_thresholds_2")),
        *((little(**{name: np.asarray(array)}), "145 inputs|stored") for name in little() for array in spoilt(name)),
        ({**checkpoint((8, 4)), "model_2.feature_layer.thr": np.zeros((1, 10))}, "model_2.output_layer.thr"),
        ({**checkpoint((8, 4)), "model_1.feature_layer.w.weight": np.zeros((9, 144))}, "different shapes"),
    ],
)
def test_arrays_that_are_no_network_are_refused_and_leave_none(state, culprit):
    asked = method().restore(little())
    with pytest.raises(BadInput, match=culprit):
        asked.restore(state)
    for ask in (lambda: asked.query(QUERIES), asked.state):
        with pytest.raises(NotFittedError):
            ask()


@pytest.mark.parametrize("sizes", [(5,), tuple(range(1, 13))], ids=str)
def test_a_published_network_scores_as_the_product_of_its_matrices(sizes):
    state = checkpoint(sizes)
    restored = method(rules="reference").restore(dict(reversed(state.items())))  # in any order
    x, layers = restored.encode(QUERIES), [name for name in PUBLISHED if name.endswith("weight")]
    matrices = [[state[f"model_{n}.{name}"].astype(float) for name in layers] for n in range(len(sizes))]
    products = np.concatenate([w_o @ (w_f @ x.T.astype(float)) for w_f, w_o in matrices]).T
    assert restored.match(x) == pytest.approx(products, abs=2e-6)
    assert restored.match(x[:1]) == pytest.approx(products[:1], abs=2e-6)


def test_published_thresholds_act_where_the_query_is_spiking():
    # All pixels at 1 leave 0.75.
    values = dict(zip(PUBLISHED, (1.0, SIDE * SIDE - 0.75, 1.0, 0.25), strict=True))
    state = {name: np.full_like(array, values[name[8:]]) for name, array in checkpoint((1,), 1).items()}
    restored = method(rules="reference", query_rule="spiking").restore(state)
    assert restored.match(np.ones((1, SIDE * SIDE), np.float32)) == pytest.approx(0.5, abs=1e-4)

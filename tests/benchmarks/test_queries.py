"""Queries to a fitted method, encode and match together, beside a plain read of the bytes that it compares with."""

from functools import cache

import numpy as np
import pytest
from full_size import FULL

PIXELS = 28 * 28
ORIENTED = 16 * 16 * 8
TWO_LAYERS = 2 * PIXELS * PIXELS  # weights of features; outputs have 2 * PIXELS a place

#: Arguments of each, the bytes of a number, numbers a place and numbers a module.
NETWORKS = {
    "sad": ("sad", {"height": 28, "width": 28}, 1, 2 * PIXELS, 0),
    "vprtempo, paper rules": ("vprtempo", {}, 4, 2 * PIXELS, TWO_LAYERS),
    "vprtempo, reference rules": ("vprtempo", {"rules": "reference"}, 4, PIXELS, 0),
    "vprtempo_int8, paper rules": ("vprtempo_int8", {}, 1, 2 * PIXELS, TWO_LAYERS),
    "vprtempo_int8, reference rules": ("vprtempo_int8", {"rules": "reference"}, 1, PIXELS, 0),
    "vprtempo_ensemble, reference rules": ("vprtempo_ensemble", {"rules": "reference", "epochs": 1}, 4, PIXELS, 0),
    "vprtempo_oriented": ("vprtempo_oriented", {}, 4, ORIENTED, ORIENTED),
    "vprtempo_oriented_int8": ("vprtempo_oriented_int8", {}, 1, ORIENTED, ORIENTED),
    "vprtempo_oriented_int8, linear": (
        *("vprtempo_oriented_int8", {"query_rule": "linear", "calibrated_scores": True}),
        *(1, ORIENTED, 0),
    ),
    "vprtempo_oriented_ensemble": ("vprtempo_oriented_ensemble", {}, 4, 5 * ORIENTED, 5 * ORIENTED),
    "vprtempo_oriented_ensemble_int8": ("vprtempo_oriented_ensemble_int8", {}, 1, 5 * ORIENTED, 5 * ORIENTED),
    "oriented_binary": ("oriented_binary", {}, 1, 16 * 16 * 6 * 3 // 8, 0),
}


@pytest.fixture(scope="module")
def fitted(size, route, build):
    @cache
    def fit(name):
        places = size(3300, 20)
        method, arguments, *_ = NETWORKS[name]
        if not FULL and method.startswith("vprtempo"):
            arguments = {**arguments, "max_module": places}
        return build(method, **arguments).fit(*route(places).references(places, 2 if name == "sad" else 1))

    return fit


@pytest.mark.parametrize("images", [1, 128])
@pytest.mark.parametrize("name", NETWORKS)
def test_query(name, images, measure, size, route, fitted, reads):
    places = size(3300, 20)
    *_, bytes_each, per_place, per_module = NETWORKS[name]
    floor = reads(bytes_each * (per_place * places + per_module * -(-places // 1100)))
    method, queries = fitted(name), route(places).queries(places, images)
    code = method.encode(queries)
    encode = {"encode alone": lambda: method.encode(queries)}
    measure(f"{name}, {images} together", lambda: method.query(queries), images, {**encode, **floor}, n_codes=len(code))


@pytest.mark.parametrize("full", [18, 111])
@pytest.mark.parametrize("name", ["vprsnn", "vprsnn_fast"])
def test_many_modules_of_vprsnn(name, full, measure, size, route, build):
    places, modules = size(25, 2), size(full, full // 18)
    module = {"places_per_module": places, "epochs": size(30, 1), "n_excitatory": size(400, 8)}
    state = build(name, **module).fit(*route(places).references(places, 2)).state()
    many = {
        key: each if each.ndim == 0 else np.broadcast_to(each[0], (modules, *each.shape[1:]))
        for key, each in state.items()
    }
    many["places"] = state["places"] + places * np.arange(modules)[:, None]
    network, query = build(name, **module).restore(many), route(places).queries(places, 1)
    measure(f"{name}, {modules} modules of {places} places", lambda: network.query(query))

"""What a GPU trains and answers, beside the CPU."""

from functools import cache

import numpy as np
import pytest
from agreement import Agreement, compare_descriptors, compare_networks, compare_scores

from vprbench.runs.stopwatch import make_synchroniser

RULES = pytest.mark.parametrize("rules", ["paper", "reference"])
TRAVERSES = 2
TRAINED = "efficientnet"


@pytest.fixture(scope="module")
def fit(size, route, build):
    """Return what trains a network: fit(device, rules, places, max_module, engine)."""

    def fitted(device, rules, places, max_module, engine="fused"):
        seen = {"height": size(28, 12), "width": size(28, 12), "epochs": size(4, 2)}
        network = build("vprtempo", device, rules=rules, engine=engine, max_module=max_module, **seen)
        network.fit(*route(places).references(places, TRAVERSES))
        make_synchroniser(device)()
        return network

    return fitted


@RULES
def test_a_network_is_that_of_the_cpu_and_of_the_readable_engine(rules, device, size, route, fit, measure):
    places = size(200, 12)
    asked = rules, places, 2 * places // 5  # three modules
    queries = route(places).queries(places, places)
    network = fit(device, *asked)
    with_cpu = compare_networks(network, fit("cpu", *asked), queries)
    with_readable = compare_networks(network, fit(device, *asked, "readable"), queries)
    one_by_one = np.concatenate([network.query(queries[i : i + 1]) for i in range(places)])
    with_singles = compare_scores(network.query(queries), one_by_one)
    measure(
        f"fit, {places} places in 3 modules, {rules} rules",
        lambda: fit(device, *asked),
        TRAVERSES * places,
        {"CPU": lambda: fit("cpu", *asked), "readable engine": lambda: fit(device, *asked, "readable")},
        **with_cpu.columns(),
    )
    assert with_cpu.holds, with_cpu
    assert with_readable.holds, with_readable
    assert with_singles.holds, with_singles


@RULES
def test_fit_of_a_large_map(rules, device, size, fit, measure):
    places, most = size(3300, 20), size(1100, 10)
    measure(
        f"fit, {places:,} places, {rules} rules",
        lambda: fit(device, rules, places, most),
        TRAVERSES * places,
        {"CPU": lambda: fit("cpu", rules, places, most)},
    )


@pytest.fixture(scope="module")
def copies(device, size, build, fit):
    """Return what gives a network on the device, and its copy on the CPU."""

    @cache
    def pair(rules):
        places, most = size(3300, 20), size(1100, 10)
        network = fit(device, rules, places, most)
        own = {"rules": rules, "max_module": most, "height": size(28, 12), "width": size(28, 12)}
        return network, build("vprtempo", **own).restore(network.state())

    return pair


@pytest.mark.parametrize("images", [1, 128, 1024, 8192])
@RULES
def test_queries_of_a_large_map(rules, images, device, size, route, copies, measure):
    places, images = size(3300, 20), min(images, size(8192, 4))
    (network, on_cpu), queries = copies(rules), route(places).queries(places, images)
    found = compare_scores(network.query(queries), on_cpu.query(queries))
    measure(
        f"query, {images:,} together, {places:,} places, {rules} rules",
        lambda: network.query(queries),
        images,
        {"CPU": lambda: on_cpu.query(queries), "encode alone": lambda: network.encode(queries)},
        **found.columns(),
    )
    assert found.holds, found


@pytest.fixture(scope="module")
def described(device, size, route, build):
    """Return the trained network on the device and on the CPU, each with its map, and the queries."""
    places, frames = size(200, 12), {"height": size(128, 64), "width": size(224, 112)}
    shown = route(places).references(places)
    here, there = (build(TRAINED, where, **frames).fit(*shown) for where in (device, "cpu"))
    return here, there, route(places).queries(places, places)


@pytest.mark.parametrize("images", [1, 128])
def test_descriptors_of_a_trained_network(images, described, size, measure):
    here, there, queries = described
    found, few = compare_descriptors(here, there, queries), queries[: min(images, size(128, 4))]
    measure(
        f"{TRAINED}, {len(few)} together",
        lambda: here.query(few),
        len(few),
        {"CPU": lambda: there.query(few)},
        **found.columns(),
    )
    assert found.holds, found


class Bent:
    """A network whose state or whose scores are wrong."""

    def __init__(self, network, state=lambda state: state, scores=lambda scores: scores):
        self.state = lambda: state(network.state())
        self.query = lambda queries: scores(network.query(queries))


def bend_largest(name, change):
    """Return what changes the largest number of an array by a share of it."""

    def bend(state):
        array = state[name].copy()
        array.flat[np.abs(array).argmax()] *= 1 + change
        return {**state, name: array}

    return bend


def test_a_wrong_answer_is_caught(route, fit):
    places = 12
    network, queries = fit("cpu", "paper", places, 5), route(places).queries(places, places)
    assert compare_networks(network, fit("cpu", "paper", places, 5), queries) == Agreement(0.0, 0, places)
    assert compare_networks(Bent(network, bend_largest("features", 5e-5)), network, queries).holds
    for name in ("features", "outputs_0", "feature_thresholds"):
        found = compare_networks(Bent(network, bend_largest(name, 2e-4)), network, queries)
        assert (found.holds, found.difference) == (False, pytest.approx(2e-4, rel=0.01))
        assert not compare_networks(Bent(network, bend_largest(name, np.nan)), network, queries).holds
    rolled = compare_networks(Bent(network, scores=lambda scores: np.roll(scores, 1, axis=1)), network, queries)
    assert (rolled.holds, rolled.difference, rolled.other_places) == (False, 0.0, places)
    scores = network.query(queries)
    stretched = compare_scores(scores * np.float32(1.001), scores)
    assert (stretched.holds, stretched.difference) == (False, pytest.approx(1e-3, rel=0.01))

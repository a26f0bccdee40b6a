"""What a GPU trains and answers, beside the CPU."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from vprbench.runs.stopwatch import make_synchroniser

RULES = pytest.mark.parametrize("rules", ["paper", "reference"])
TRAVERSES = 2
TRAINED = "efficientnet"
TOLERANCE = 1e-4  # of the largest number


@dataclass(frozen=True)
class Agreement:
    """How far the answers of two devices lie apart."""

    difference: float  # the largest, as a share of the largest number of its array
    other_places: int  # queries whose best place here is not among the best there, but for the tolerance

    @classmethod
    def of(cls, arrays, here, there):
        """Compare pairs of arrays, and the best places of scores (n_queries, n_places)."""
        shares = [np.abs(ours - theirs).max() / (np.abs(theirs).max() or 1.0) for ours, theirs in arrays]
        named = np.take_along_axis(there, here.argmax(1)[:, None], axis=1)
        enough = there.max(1, keepdims=True) - TOLERANCE * np.abs(there).max(1, keepdims=True)
        return cls(float(np.max(shares)), int((~(named >= enough)).sum()))

    @property
    def holds(self):
        """Whether both are the same but for rounding; a difference that is no number is none."""
        return self.difference <= TOLERANCE and self.other_places == 0

    def columns(self):
        return {"difference": f"{self.difference:.1e}", "other best places": self.other_places}


def compare_networks(here, there, queries):
    ours, theirs = here.state(), there.state()
    return Agreement.of([(ours[name], theirs[name]) for name in theirs], here.query(queries), there.query(queries))


def compare_scores(here, there):
    return Agreement.of(zip(here, there, strict=True), here, there)


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
    codes = [(here.encode(queries), there.encode(queries))]
    found, few = Agreement.of(codes, here.query(queries), there.query(queries)), queries[: min(images, size(128, 4))]
    measure(
        f"{TRAINED}, {len(few)} together",
        lambda: here.query(few),
        len(few),
        {"CPU": lambda: there.query(few)},
        **found.columns(),
    )
    assert found.holds, found

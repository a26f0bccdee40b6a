"""Training VPRTempo and VPRSNN from images in memory; growth with the number of places."""

import pytest
from full_size import FULL

RULES = ("paper", "reference")


@pytest.mark.parametrize("rules", RULES)
def test_a_module(rules, measure, size, route, build, reads):
    places, pixels = size(1100, 10), size(28, 12)
    shown = route(places).references(places, 2)
    arguments = {"rules": rules, "max_module": places, "epochs": 1, "height": pixels, "width": pixels}
    n_weights = 2 * pixels**2 * (pixels**2 + places)
    one = {
        engine: lambda e=engine: build("vprtempo", engine=e, **arguments).fit(*shown)
        for engine in ("fused", "readable")
    }
    beside = {"readable engine": one["readable"], **reads(2 * 4 * n_weights, write=True)}
    measure(f"a module of {places:,} places, 1 epoch, {rules} rules", one["fused"], 2 * places, beside)


@pytest.mark.parametrize("rules", RULES)
def test_the_fit_that_users_ask_for(rules, measure, size, route, build):
    places = size(3300, 40)
    shown = route(places).references(places, 2)
    arguments = {"rules": rules, "max_module": size(1100, 20), "epochs": size(4, 2)}
    measure(
        f"{places:,} places, 4 epochs, {rules} rules", lambda: build("vprtempo", **arguments).fit(*shown), len(shown[1])
    )


@pytest.mark.parametrize("places", [100, 300, 1000, 3300, 10_000, 27_000] if FULL else [100, 200])
@pytest.mark.parametrize("rules", RULES)
def test_growth(rules, places, measure, size, route, build):
    shown = route(places).references(places)
    arguments = {"rules": rules, "max_module": min(1100, places), "epochs": 4}
    measure(
        f"{places:,} places, 1 traverse, {rules} rules",
        lambda: build("vprtempo", **arguments).fit(*shown),
        places,
        places=places,
        grows=f"fit, {rules} rules",
    )


@pytest.mark.parametrize("name", ["vprsnn", "vprsnn_fast"])
def test_a_module_of_vprsnn(name, measure, size, route, build):
    places, epochs = size(25, 2), size(30, 1)
    shown = route(places).references(places, 2)
    arguments = {"places_per_module": places, "epochs": epochs, "n_excitatory": size(400, 8)}
    what = f"{name}: a module of {places} places, {epochs} epochs"
    measure(what, lambda: build(name, **arguments).fit(*shown), 2 * places * epochs)

"""VPRSNN as a method: how it answers queries against a direct simulation."""

import direct_vprsnn as direct
import numpy as np
import pytest
from little_vprsnn import SMALL, WORLD, fitted, images, layers, recorded_trains, references
from states import same

from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.methods.vprsnn.method import VPRSNN
from vprbench.methods.vprsnn.model import Model

QUERIES = images(WORLD.queries)
SHORT = {"presentation_ms": 120.0, "rest_ms": 30.0, "excitatory_start_mv": -80.0}


@pytest.fixture(scope="module")
def trained():
    """A network of ten places, in two modules; tests leave it as it is."""
    return fitted(10)


def asked_directly(method, trains, carried):
    """Return the spikes of excitatory and inhibitory neurons, (n_images, n_neurons), of a method of one module."""
    state, model = method.state(), Model.of(method)
    delays = model.draw_delays(0, new=True)
    excitatory, inhibitory = [], []
    for shown in [trains] if carried else [[train] for train in trains]:
        run = direct.simulate(state["weights"][0], delays, state["theta"][0], shown, model, learning=False)
        excitatory.append(run.counts)
        so_far = np.cumsum(run.inhibitory, axis=0)[[1200 + 1500 * number - 1 for number in range(len(shown))]]
        inhibitory.append(np.diff(so_far, axis=0, prepend=0))  # as they are counted: from image's end to image's end
    return np.concatenate(excitatory), np.concatenate(inhibitory)


@pytest.mark.parametrize("carried", [False, True], ids=["each from rest", "carried"])
def test_the_answers_are_those_of_the_direct_simulation(carried, monkeypatch):
    # The first silence is so long that nothing is left of the start.
    trains = recorded_trains(monkeypatch)
    method = fitted(carried_potentials=carried, **SHORT | {"first_rest_ms": 5000.0})
    codes = method.encode(QUERIES)[:4]
    trains.clear()  # of the training
    found = layers(method, codes)
    excitatory, inhibitory = asked_directly(method, trains[:4], carried)
    assert excitatory.sum() > 20
    assert found["excitatory"].tolist() == excitatory.tolist()
    assert found["inhibitory"].tolist() == inhibitory.tolist()
    assert found["input"].tolist() == [train.sum(axis=0).tolist() for train in trains[:4]]


def test_new_delays_are_not_those_of_the_training_and_fast_leaves_them_out_and_nothing_else(trained):
    same_again = VPRSNN(**SMALL, delays_at_query="trained").restore(trained.state())
    codes = trained.encode(QUERIES)
    assert not np.array_equal(trained.match(codes), same_again.match(codes))
    fast, without = fitted(10, fast=True, epochs=12), fitted(10, input_delay_max_ms=0.0, epochs=12)
    assert same(fast.state(), without.state())
    assert np.array_equal(fast.match(codes), without.match(codes))
    shown, places = references(10)
    assert np.mean(fast.query(shown).argmax(1) == places) > 0.7


def test_a_gpu_is_refused_to_a_method_without_an_argument_device():
    for name, fits in (("vprsnn", False), ("vprsnn_ensemble", False), ("vprtempo", True)):
        with pytest.raises(BadInput, match=r"device=cuda") as error:
            make_request([f"method={name}"], {"device": "cuda:999"}).require_machine()
        assert ("has no option device" in str(error.value)) is not fits

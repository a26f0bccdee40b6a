"""How VPRSNN answers queries: against a direct simulation, its scores and its spikes."""

from __future__ import annotations

from typing import Any

import direct_vprsnn as direct
import numpy as np
import numpy.typing as npt
import pytest
from little_vprsnn import SMALL, WORLD, fitted, images, layers, recorded_trains

from vprbench.methods.vprsnn import scoring
from vprbench.methods.vprsnn.method import VPRSNN
from vprbench.methods.vprsnn.model import Model
from vprbench.methods.vprsnn.scoring import Responses

QUERIES = images(WORLD.queries)


@pytest.fixture(scope="module")
def trained() -> VPRSNN:
    """A network of ten places, in two modules; tests leave it as it is."""
    return fitted(10)


# --- how it is asked --------------------------------------------------------------------------------------------

SHORT: dict[str, Any] = {"presentation_ms": 120.0, "rest_ms": 30.0, "excitatory_start_mv": -80.0}


def asked_directly(
    method: VPRSNN, trains: list[npt.NDArray[np.bool_]], carried: bool
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the spikes of excitatory and inhibitory neurons, (n_images, n_neurons), of a method of one module."""
    state, model = method.state(), Model.of(method)
    delays = model.delays(0, new=True)
    excitatory, inhibitory = [], []
    for shown in [trains] if carried else [[train] for train in trains]:
        run = direct.simulate(state["weights"][0], delays, state["theta"][0], shown, model, learning=False)
        excitatory.append(run.counts)
        so_far = np.cumsum(run.inhibitory, axis=0)[[1200 + 1500 * number - 1 for number in range(len(shown))]]
        inhibitory.append(np.diff(so_far, axis=0, prepend=0))  # as they are counted: from image's end to image's end
    return np.concatenate(excitatory), np.concatenate(inhibitory)


@pytest.fixture
def trains(monkeypatch: pytest.MonkeyPatch) -> list[npt.NDArray[np.bool_]]:
    """A list to which every train that is drawn at a query is added, (n_steps, n_inputs)."""
    return recorded_trains(monkeypatch)


@pytest.mark.parametrize("carried", [False, True], ids=["each from rest", "carried"])
def test_the_answers_are_those_of_the_direct_simulation(trains: list[npt.NDArray[np.bool_]], carried: bool) -> None:
    # The first silence is so long that nothing is left of the start.
    method = fitted(carried_potentials=carried, **{**SHORT, "first_rest_ms": 5000.0})
    codes = method.encode(QUERIES)[:4]
    trains.clear()  # of the training
    found = layers(method, codes)
    excitatory, inhibitory = asked_directly(method, trains[:4], carried)
    assert excitatory.sum() > 20
    assert found["excitatory"].tolist() == excitatory.tolist()
    assert found["inhibitory"].tolist() == inhibitory.tolist()
    assert found["input"].tolist() == [train.sum(axis=0).tolist() for train in trains[:4]]


def test_an_asked_module_starts_as_published_and_relaxes_in_the_first_silence() -> None:
    v = -105.0
    for _ in range(5000):  # steps of 0.1 ms
        v += (-65 - v) * 0.1 / 100
    state, now = Model(height=1, width=3).started(np.array([20.0, 21.0]))
    assert now == 5000
    assert state.v[:2] == pytest.approx(v)
    assert state.theta[:2].tolist() == [20, 21]
    assert not state.ge.any()
    assert not state.gi.any()


def test_the_start_acts_on_the_first_query_where_potentials_are_carried() -> None:
    low = {**SHORT, "excitatory_start_mv": -105.0, "first_rest_ms": 50.0, "carried_potentials": True}
    method = fitted(**low)
    codes = method.encode(QUERIES)
    from_low, from_rest = (
        layers(VPRSNN(**{**SMALL, **low, **start}).restore(method.state()), codes)["excitatory"]
        for start in ({}, {"excitatory_start_mv": -65.0})
    )
    assert from_low[0].sum() < from_rest[0].sum()  # it takes longer from there
    other = VPRSNN(**{**SMALL, **low, "carried_potentials": False}).restore(method.state())
    same_start = VPRSNN(**{**SMALL, **low, "carried_potentials": False, "excitatory_start_mv": -65.0})
    assert np.array_equal(other.match(codes), same_start.restore(method.state()).match(codes))


def test_new_delays_are_not_those_of_the_training() -> None:
    new = fitted()
    same_again = VPRSNN(**SMALL, delays_at_query="trained").restore(new.state())
    codes = new.encode(QUERIES)
    assert not np.array_equal(layers(new, codes)["excitatory"], layers(same_again, codes)["excitatory"])


# --- scores and spikes ------------------------------------------------------------------------------------------


def test_scores_are_the_mean_spikes_of_the_neurons_of_each_place(trained: VPRSNN) -> None:
    codes, state = trained.encode(QUERIES), trained.state()
    spikes = layers(trained, codes)["excitatory"].reshape(len(codes), 2, -1)
    expected = np.zeros((len(codes), 10))
    means = state["sums"] / state["shown"][:, None]
    for module, of_module in enumerate(means):
        spoken_for = np.array([state["places"][module][own.argmax()] if own.any() else -1 for own in of_module])
        for place in set(spoken_for.tolist()) - {-1}:
            expected[:, place] = spikes[:, module, spoken_for == place].mean(axis=1)
    assert expected.max() > 1
    assert trained.match(codes) == pytest.approx(expected.astype(np.float32))


def test_weighted_scores_are_those_of_the_same_spikes(trained: VPRSNN) -> None:
    state = trained.state()
    weighted = VPRSNN(**SMALL, assignment="weighted").restore(state)
    codes = trained.encode(QUERIES)
    spikes = layers(trained, codes)["excitatory"].reshape(len(codes), 2, -1)
    learnt = Responses(state["sums"], state["shown"], state["places"])
    expected = scoring.weighted(spikes, learnt, np.zeros(spikes.shape[1:], np.bool_), 10)
    assert np.array_equal(weighted.match(codes), expected)
    assert not np.allclose(expected, trained.match(codes))


def test_probabilities_add_up_to_one_and_keep_the_order_of_places(trained: VPRSNN) -> None:
    codes = np.concatenate([trained.encode(QUERIES), np.zeros((1, 144), np.uint8)])
    plain, parts = trained.match(codes), VPRSNN(**SMALL, probabilities=True).restore(trained.state()).match(codes)
    assert parts[:-1].min(axis=1).tolist() == [0] * len(QUERIES)
    assert parts[:-1].sum(axis=1) == pytest.approx(1)
    assert np.array_equal(parts.argmax(1), plain.argmax(1))
    assert np.isneginf(parts[-1]).all()


def test_all_modules_see_the_same_input(trained: VPRSNN) -> None:
    # Both modules have the weights of the first: they differ in their delays alone, and so but a little.
    state = {name: np.array(array) for name, array in trained.state().items()}
    for name in ("weights", "theta"):
        state[name][1] = state[name][0]
    twice = VPRSNN(**SMALL, fast=True).restore(state)
    first, second = layers(twice, twice.encode(QUERIES))["excitatory"].reshape(len(QUERIES), 2, -1).swapaxes(0, 1)
    assert first.any()
    assert np.array_equal(first, second)

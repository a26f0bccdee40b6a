"""Many VPRSNN modules at once in PyTorch do what the compiled simulation does with one after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from vprsnn_constants import constants

from vprbench.methods.vprsnn import batched
from vprbench.methods.vprsnn.input import generator_for, spike_train
from vprbench.methods.vprsnn.module import Room, State, Synapses, Train, unpadded
from vprbench.methods.vprsnn.physics import Physics, Traces, physics_of, traces_of
from vprbench.methods.vprsnn.simulation import normalise, present

N_MODULES, N_IMAGES = 3, 4
BEGIN = 400  # the step of the first presentation
CLOSE = 1e-9
CPU = torch.device("cpu")


@dataclass(frozen=True)
class Case:
    """Modules that differ in weights, delays and input; the neurons of a case fire a few times for most images."""

    changes: dict[str, float] = field(default_factory=dict)  # of the published constants
    n_inputs: int = 60
    n_neurons: int = 10
    longest_delay: int = 100
    weight_sum: float = 9.0
    silent_image: int | None = None

    @property
    def physics(self) -> Physics:
        return physics_of(constants(**{"presentation_ms": 120.0, "rest_ms": 20.0, **self.changes}))

    @property
    def traces(self) -> Traces:
        return traces_of(constants(**self.changes))

    def weights(self) -> npt.NDArray[np.float64]:
        return 0.3 * generator_for(1, 1).random((N_MODULES, self.n_inputs, self.n_neurons))

    def delays(self) -> npt.NDArray[np.int16]:
        shape = (N_MODULES, self.n_inputs, self.n_neurons)
        return generator_for(1, 2).integers(0, self.longest_delay + 1, shape).astype(np.int16)

    def trains(self) -> list[list[Train]]:
        """Return the input of each module for each image; some of the inputs never spike."""
        physics, generator = self.physics, generator_for(1, 3)
        levels = generator.integers(0, 256, (N_IMAGES, N_MODULES, self.n_inputs)).astype(np.uint8)
        levels[:, :, ::7] = 0
        if self.silent_image is not None:
            levels[self.silent_image] = 0
        return [[spike_train(row, generator, 0.7, physics.shown, physics.step_ms) for row in rows] for rows in levels]

    def start(self, theta: npt.NDArray[np.float64]) -> State:
        """Return a module that has not come to rest when the first image is shown."""
        state = State.at_rest(self.physics, theta, self.n_inputs)
        state.v[:] = -66.0
        state.v_i[:] = -80.0
        return state

    def room(self, learning: bool) -> Room:
        return Room.of(self.physics, self.n_neurons, self.n_inputs, self.longest_delay, learning)


CASES = {
    "as published": Case(),
    "one image after the other without a rest": Case({"rest_ms": 0.0}, longest_delay=0),
    "a rest in which all relax": Case({"rest_ms": 150.0}),
    "no delays": Case(longest_delay=0),
    "fewer than eight neurons": Case(n_neurons=3),
    "an image without spikes": Case(silent_image=2),
    "spikes at short intervals": Case({"excitatory_minimum_interval_ms": 2.0, "excitatory_refractory_ms": 0.0}),
    "refractory for almost the whole interval": Case(
        {"excitatory_refractory_ms": 9.0, "excitatory_minimum_interval_ms": 9.5}
    ),
    "weights at their limits": Case({"post_rate": 0.5, "pre_rate": 0.05, "weight_max": 0.3}),
    "weights above their limit": Case({"weight_max": 0.1}),
    "an arrival weakens": Case({"pre_rate": -0.01}),
    "inhibitory neurons that fire more than once": Case({"excitatory_to_inhibitory_weight": 60.0}),
    "slow inhibition": Case({"inhibition_tau_ms": 30.0, "inhibitory_to_excitatory_weight": 0.5}),
    "thresholds that change much": Case({"theta_plus_mv": 1.0, "theta_tau_ms": 500.0}),
}


@dataclass(frozen=True)
class Learnt:
    weights: npt.NDArray[np.float64]
    theta: npt.NDArray[np.float64]
    counts: npt.NDArray[np.integer]  # (N_IMAGES, N_MODULES, n_neurons)


@cache
def one_by_one(name: str) -> Learnt:
    """Return what the compiled simulation learns."""
    case = CASES[name]
    physics, traces, room = case.physics, case.traces, case.room(True)
    counts = np.zeros((N_IMAGES, N_MODULES, case.n_neurons), np.int64)
    weights, thetas = [], []
    for module, (own, delays) in enumerate(zip(case.weights(), case.delays(), strict=True)):
        synapses, state = Synapses.of(own, delays), case.start(np.full(case.n_neurons, 20.0))
        for image, trains in enumerate(case.trains()):
            now = BEGIN + image * (physics.shown + physics.rest)
            normalise(synapses.weights, case.weight_sum)
            present(synapses, state, trains[module], room, physics, traces, now, True, True)
            counts[image, module] = state.counts[: case.n_neurons]
        weights.append(unpadded(synapses.weights, case.n_neurons))
        thetas.append(state.theta[: case.n_neurons])
    return Learnt(np.array(weights), np.array(thetas), counts)


def trained(
    case: Case, n_kept: int = N_IMAGES, device: torch.device = CPU, report: Callable[[float], None] = lambda _: None
) -> Learnt:
    start = case.start(np.full(case.n_neurons, 20.0))
    synapses, model = (case.weights(), case.delays()), (case.physics, case.traces, case.weight_sum)
    shown = case.trains().__getitem__
    return Learnt(*batched.train(*synapses, start, BEGIN, *model, shown, N_IMAGES, n_kept, device, report))


@cache
def all_at_once(name: str) -> Learnt:
    return trained(CASES[name])


@pytest.mark.parametrize("name", CASES)
def test_all_modules_at_once_fire_as_often(name: str) -> None:
    assert one_by_one(name).counts.sum() > 0
    np.testing.assert_array_equal(all_at_once(name).counts, one_by_one(name).counts)


@pytest.mark.parametrize("name", CASES)
def test_all_modules_at_once_learn_the_same_weights(name: str) -> None:
    np.testing.assert_allclose(all_at_once(name).weights, one_by_one(name).weights, rtol=0, atol=CLOSE)


@pytest.mark.parametrize("name", CASES)
def test_all_modules_at_once_come_to_the_same_thresholds(name: str) -> None:
    np.testing.assert_allclose(all_at_once(name).theta, one_by_one(name).theta, rtol=0, atol=CLOSE)


def test_training_does_not_change_what_it_is_given() -> None:
    case = CASES["as published"]
    weights, start = case.weights(), case.start(np.full(case.n_neurons, 20.0))
    model = (case.physics, case.traces, case.weight_sum)
    batched.train(weights, case.delays(), start, 0, *model, case.trains().__getitem__, 2, 0, CPU, lambda _: None)
    np.testing.assert_array_equal(weights, case.weights())
    np.testing.assert_array_equal(start.theta[: case.n_neurons], 20.0)


def test_the_responses_to_the_last_presentations_are_kept() -> None:
    kept = trained(CASES["as published"], n_kept=2).counts
    np.testing.assert_array_equal(kept, one_by_one("as published").counts[-2:])


def test_the_progress_of_training_is_told_after_each_presentation() -> None:
    told: list[float] = []
    trained(CASES["fewer than eight neurons"], report=told.append)
    assert told == pytest.approx([0.25, 0.5, 0.75, 1.0])


@pytest.fixture
def little_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batched.arrivals, "_AT_ONCE", 500)
    monkeypatch.setattr(batched.learning, "_AT_ONCE", 500)


@pytest.mark.usefixtures("little_at_once")
def test_how_much_is_worked_on_at_once_does_not_change_what_is_learnt() -> None:
    little, much = trained(CASES["as published"]), all_at_once("as published")
    np.testing.assert_array_equal(little.weights, much.weights)
    np.testing.assert_array_equal(little.counts, much.counts)


def answers(
    name: str, images: slice = slice(None), *, carried: bool = False, held: int = batched.VALUES_HELD, **given: Any
) -> npt.NDArray[np.int32]:
    """Return the spikes, (2, n_images, n_modules, n_neurons), with which trained modules answer."""
    case, network = CASES[name], one_by_one(name)
    shown = [trains[0] for trains in case.trains()][images]
    given = {"device": CPU, "report": lambda _: None} | given
    start = (case.start(network.theta[0]), BEGIN) if carried else None
    model = (network.weights, case.delays(), network.theta, case.physics)
    return np.array(batched.ask(*model, shown, **given, carried=start, values_held=held))


@cache
def answers_one_by_one(name: str, carried: bool) -> npt.NDArray[np.int64]:
    """Return what the compiled simulation answers."""
    case, network = CASES[name], one_by_one(name)
    physics, room = case.physics, case.room(False)
    spikes = np.zeros((2, N_IMAGES, N_MODULES, case.n_neurons), np.int64)
    for module, (weights, delays) in enumerate(zip(network.weights, case.delays(), strict=True)):
        synapses, state, now = Synapses.of(weights, delays), case.start(network.theta[module]), BEGIN
        for image, trains in enumerate(case.trains()):
            if not carried:
                state, now = State.at_rest(physics, network.theta[module], case.n_inputs), 0
            present(synapses, state, trains[0], room, physics, case.traces, now, False, carried)
            now += physics.shown + physics.rest
            spikes[:, image, module] = state.counts[: case.n_neurons], state.counts_i[: case.n_neurons]
    return spikes


ASKED = ["as published", "no delays", "fewer than eight neurons", "inhibitory neurons that fire more than once"]


@pytest.mark.parametrize("carried", [False, True], ids=["from rest", "carried"])
@pytest.mark.parametrize("name", ASKED)
def test_all_modules_at_once_answer_the_same(name: str, carried: bool) -> None:
    expected = answers_one_by_one(name, carried)
    assert (expected.sum(axis=(1, 2, 3)) > 0).all()
    np.testing.assert_array_equal(answers(name, carried=carried), expected)


def test_inhibitory_neurons_that_fire_more_than_once_do() -> None:
    excitatory, inhibitory = answers("inhibitory neurons that fire more than once")
    assert inhibitory.sum() > 1.5 * excitatory.sum()


@pytest.mark.parametrize("images", [slice(2, 3), slice(None, None, -1)], ids=["alone", "in another order"])
def test_an_answer_does_not_depend_on_the_other_images(images: slice) -> None:
    np.testing.assert_array_equal(answers("as published", images), answers("as published")[:, images])


# A neuron holds 3 values for each of 60 synapses, and for each image 6 for each of 250 steps and 100 more.
ONE_MODULE, TWO_MODULES, THREE_IMAGES = 0, 10 * 2 * (3 * 60 + 1600), 10 * 3 * (3 * 60 + 3 * 1600)


@pytest.mark.parametrize("held", [ONE_MODULE, THREE_IMAGES])
def test_answers_do_not_depend_on_the_memory_allowed(held: int) -> None:
    np.testing.assert_array_equal(answers("as published", held=held), answers("as published"))


@pytest.mark.parametrize(
    ("held", "turns"),
    [
        (batched.VALUES_HELD, [12]),  # images of modules that have been asked
        (THREE_IMAGES, [9, 12]),
        (TWO_MODULES, [2, 4, 6, 8, 9, 10, 11, 12]),
    ],
)
def test_asking_takes_as_many_turns_as_memory_demands(held: int, turns: list[int]) -> None:
    told: list[float] = []
    answers("as published", held=held, report=told.append)
    assert told == pytest.approx([asked / 12 for asked in turns])


def test_no_images_have_no_answers() -> None:
    assert answers("as published", slice(0, 0)).shape == (2, 0, N_MODULES, 10)


def test_four_gibibytes_hold_a_few_hundred_published_modules() -> None:
    # 400 neurons, each with 784 synapses of 3 values and 250 steps of 6 values, and 100 steps to come.
    assert batched.modules_at_once(physics_of(constants()), 784, 400, 100) == 2**29 // (400 * (784 * 3 + 250 * 6 + 100))


def test_one_module_is_trained_however_little_memory_there_is() -> None:
    assert batched.modules_at_once(physics_of(constants()), 784, 400, 100, values_held=1) == 1


@pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU that CUDA can use")
@pytest.mark.parametrize("name", ASKED)
def test_a_gpu_learns_and_answers_the_same(name: str) -> None:
    device = torch.device("cuda")
    found, expected = trained(CASES[name], device=device), one_by_one(name)
    np.testing.assert_array_equal(found.counts, expected.counts)
    np.testing.assert_allclose(found.weights, expected.weights, rtol=0, atol=CLOSE)
    np.testing.assert_allclose(found.theta, expected.theta, rtol=0, atol=CLOSE)
    np.testing.assert_array_equal(answers(name, device=device), answers_one_by_one(name, False))

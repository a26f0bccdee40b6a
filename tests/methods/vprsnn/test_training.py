"""VPRSNN's training: what a module is shown, what it learns from that, and what outlives an interruption."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import direct_vprsnn as direct
import numpy as np
import pytest
import torch
from little_vprsnn import SMALL, WORLD, fitted, images, recorded_trains, references, same, tiny_recipe
from vprsnn_constants import constants

from vprbench import progress
from vprbench.errors import BadInput
from vprbench.methods.vprsnn import recipe
from vprbench.methods.vprsnn.method import VPRSNN
from vprbench.methods.vprsnn.module import unpadded
from vprbench.methods.vprsnn.physics import physics_of, traces_of
from vprbench.methods.vprsnn.threads import Tell, for_each_module
from vprbench.methods.vprsnn.training import train
from vprbench.methods.vprsnn.training_sets import Lesson, lesson


@pytest.fixture(autouse=True)
def one_thread() -> Iterator[None]:
    """Modules are trained one after the other, unless a test says otherwise."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


class Interrupted(Exception):
    """Somebody ended the training."""


def quiet(share: float) -> None:
    """Tell nobody how far a module is."""


# --- the lesson -------------------------------------------------------------------------------------------------


def shown(places: list[int], members: list[int]) -> tuple[list[int], list[int]]:
    """Return which images, told by their one level, a module is shown, and the label of each."""
    levels = np.arange(len(places), dtype=np.uint8)[:, None]
    found = lesson(7, np.array(members), levels, np.array(places))
    assert found.number == 7
    assert found.places.tolist() == members
    return found.levels[:, 0].tolist(), found.labels.tolist()


def test_a_module_is_shown_its_places_along_the_first_traverse_and_then_along_the_second() -> None:
    assert shown([0, 1, 2, 3, 0, 1, 2, 3], [1, 2]) == ([1, 2, 5, 6], [0, 1, 0, 1])


def test_the_traverses_are_told_apart_by_how_often_a_place_was_seen_before() -> None:
    assert shown([2, 2, 0, 0, 1, 1], [0, 1, 2]) == ([2, 4, 0, 3, 5, 1], [0, 1, 2, 0, 1, 2])


def test_a_place_that_only_one_traverse_passed_is_left_out_in_the_second() -> None:
    assert shown([0, 1, 2, 0, 2], [0, 1, 2]) == ([0, 1, 2, 3, 4], [0, 1, 2, 0, 2])


def test_places_are_shown_in_the_order_of_the_module() -> None:
    assert shown([0, 1, 2, 3, 0, 1, 2, 3], [3, 0]) == ([3, 0, 7, 4], [0, 1, 0, 1])


# --- one module -------------------------------------------------------------------------------------------------


def test_a_trained_module_equals_the_direct_simulation_from_its_first_silence_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Neurons that start at rest, so that the silence, 150 ms as every later presentation with its rest, is one more
    # image of the direct simulation, without input. Theta falls in it too, and here so fast that it matters.
    values = constants(presentation_ms=100.0, rest_ms=50.0, theta_tau_ms=1e4)
    n_inputs, n_neurons, delays_ms = 30, 5, 10.0
    how = tiny_recipe(
        physics=physics_of(values),
        traces=traces_of(values),
        n_inputs=n_inputs,
        n_neurons=n_neurons,
        v_start=-65.0,
        v_start_inhibitory=-60.0,
        first_rest=1500,
        longest_delay=delays_ms / 0.1,
        epochs=2,
        weight_sum=20.0,
    )
    levels = np.random.default_rng(0).integers(0, 256, (3, n_inputs)).astype(np.uint8)
    task = Lesson(4, levels, np.array([0, 1, 0]), np.array([8, 9]))
    theta = np.full(n_neurons, 20.0)
    trains = recorded_trains(monkeypatch, recipe)
    found = train(how, task, quiet)

    silence = np.zeros((1000, n_inputs), np.bool_)
    expected = direct.simulate(how.weights(4), how.delays(4), theta, [silence, *trains], values, True, 20.0)
    counts = expected.counts[1:]
    assert len(counts) == 6
    assert counts.sum() > 20
    assert unpadded(found["weights"], n_neurons) == pytest.approx(expected.weights, abs=1e-9)
    assert found["theta"] == pytest.approx(expected.theta, abs=1e-9)
    assert found["sums"].tolist() == np.stack([counts[[0, 2, 3, 5]].sum(0), counts[[1, 4]].sum(0)], 1).tolist()
    assert found["shown"].tolist() == [4, 2]
    assert found["places"].tolist() == [8, 9]


def test_initial_weights_are_uniform_from_the_offset_on() -> None:
    weights = tiny_recipe(n_inputs=200, n_neurons=50).weights(0)
    assert weights.shape == (200, 50)
    shares = (weights / 0.3 - 0.01).ravel()
    assert np.histogram(shares, 10, (0, 1))[0] == pytest.approx(1000, abs=150)  # five standard deviations
    assert 0 <= shares.min() < shares.max() < 1


def test_weights_that_do_not_learn_keep_the_published_sum() -> None:
    state = fitted(pre_rate=0.0, post_rate=0.0).state()
    assert state["weights"].sum(axis=1) == pytest.approx(78.0)


def test_every_spike_raises_the_threshold_of_its_neuron() -> None:
    state = fitted(theta_tau_ms=1e15, epochs=3).state()  # all 30 presentations are recorded
    spikes = state["sums"].sum(axis=2)
    assert spikes.min() < spikes.max()
    assert state["theta"] == pytest.approx(20 + 0.05 * spikes)


def test_delays_are_uniform_and_rounded_to_the_nearest_step() -> None:
    delays = tiny_recipe(n_inputs=300, n_neurons=1000).delays(0)
    times = np.bincount(delays.ravel(), minlength=101)
    assert len(times) == 101
    assert times[1:100] == pytest.approx(3000, abs=300)
    assert times[[0, 100]] == pytest.approx(1500, abs=200)  # half a step is nearest to each of them


def test_delays_differ_between_modules_and_between_training_and_asking() -> None:
    how = tiny_recipe(n_inputs=50, n_neurons=20)
    drawn = [
        how.delays(0),
        how.delays(1),
        how.delays(0, new=True),
        tiny_recipe(n_inputs=50, n_neurons=20, seed=1).delays(0),
    ]
    assert np.array_equal(how.delays(0), drawn[0])
    for number, one in enumerate(drawn):
        for other in drawn[:number]:
            assert np.mean(one == other) < 0.05


def test_a_module_learns_the_same_whether_or_not_others_follow() -> None:
    alone, first = fitted(5).state(), fitted(10).state()
    for name in ("weights", "theta", "sums", "shown", "places"):
        assert np.array_equal(first[name][:1], alone[name])


def test_modules_of_the_same_images_draw_differently() -> None:
    five, places = references(5)
    twice = images([*WORLD.references[:5], *WORLD.references[:5]])
    state = VPRSNN(**SMALL).fit(twice, np.arange(10)).state()
    assert len(five) == len(places) == 10
    assert not np.allclose(state["weights"][0], state["weights"][1], rtol=0.1)


# --- recorded presentations -------------------------------------------------------------------------------------


def test_fewer_presentations_than_are_recorded_are_all_recorded() -> None:
    assert fitted(epochs=3).state()["shown"].tolist() == [[6] * 5]


def test_only_the_last_presentations_are_recorded() -> None:
    # Of 30 presentations, 10 an epoch, the last 12: places 3 and 4 of the second traverse, then two of every place.
    state = fitted(epochs=3, recorded_presentations=12).state()
    assert state["shown"].tolist() == [[2, 2, 2, 3, 3]]
    assert 0 < state["sums"].sum() < fitted(epochs=3).state()["sums"].sum()


def test_fewer_recorded_presentations_than_a_module_has_images_are_refused() -> None:
    assert fitted(recorded_presentations=10).state()["shown"].tolist() == [[2] * 5]
    with pytest.raises(BadInput, match=r"method\.recorded_presentations=9: .* 10 images"):
        fitted(recorded_presentations=9)


def test_what_is_recorded_changes_nothing_else() -> None:
    few, all_ = fitted(recorded_presentations=11).state(), fitted().state()
    assert np.array_equal(few["weights"], all_["weights"])
    assert np.array_equal(few["theta"], all_["theta"])


# --- threads ----------------------------------------------------------------------------------------------------


def test_two_threads_train_what_one_does() -> None:
    alone = fitted(15)
    torch.set_num_threads(2)
    together = fitted(15)
    assert same(alone.state(), together.state())
    codes = alone.encode(images(WORLD.queries))
    assert np.array_equal(alone.match(codes), together.match(codes))


def test_each_module_has_its_own_result_in_order() -> None:
    torch.set_num_threads(2)
    assert for_each_module(lambda module, tell: module**2, 20, "squares") == [n**2 for n in range(20)]


def test_a_module_that_fails_ends_the_others() -> None:
    torch.set_num_threads(2)
    others_began, running = threading.Event(), []

    def work(module: int, tell: Tell) -> None:
        if module == 0:
            others_began.wait()
            raise Interrupted
        running.append(module)
        others_began.set()
        try:
            while True:  # until somebody says that it is over
                tell(0.5)
        finally:
            running.remove(module)

    with pytest.raises(Interrupted):
        for_each_module(work, 6, "training")
    assert not running


def test_an_interruption_ends_all_modules() -> None:
    torch.set_num_threads(2)
    running = set()

    def work(module: int, tell: Tell) -> None:
        running.add(module)
        try:
            while True:
                tell(0.5)
        finally:
            running.remove(module)

    def interrupt(stage: str, done: float) -> None:
        if running:
            raise KeyboardInterrupt

    with progress.listening(interrupt), pytest.raises(KeyboardInterrupt):
        for_each_module(work, 6, "training")
    assert not running


def test_the_progress_of_a_training_rises_from_nothing_to_all() -> None:
    told: list[tuple[str, float]] = []
    with progress.listening(lambda stage, done: told.append((stage, done))):
        fitted(15, epochs=1)
    shares = [done for stage, done in told if stage == "training"]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)


def test_a_stage_in_parts_goes_on_where_the_part_before_ended() -> None:
    told: list[float] = []
    with progress.listening(lambda stage, done: told.append(done)):
        for_each_module(lambda module, tell: tell(1.0), 3, "reactions", (0.25, 0.75))
    assert (told[0], told[-1]) == (0.25, 0.75)

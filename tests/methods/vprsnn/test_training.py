"""VPRSNN's training: what a module is shown and learns by which arguments, and how an interrupted one goes on."""

from types import SimpleNamespace

import direct_vprsnn as direct
import numpy as np
import pytest
import torch
from little_vprsnn import SMALL, WORLD, fitted, held_out, images, recorded_trains, references
from states import same
from threads import torch_threads

from vprbench.methods.vprsnn import training
from vprbench.methods.vprsnn.arrays import unpack_neurons
from vprbench.methods.vprsnn.ensemble import VPRSNNEnsemble
from vprbench.methods.vprsnn.method import VPRSNN
from vprbench.methods.vprsnn.model import Model
from vprbench.methods.vprsnn.parallel import Stage, for_each_module
from vprbench.methods.vprsnn.training import Lesson, make_lessons, split_places, train


@pytest.fixture(autouse=True)
def one_thread():
    """Modules are trained one after the other, unless a test says otherwise."""
    with torch_threads(1):
        yield


class Interrupted(Exception):
    """Somebody ended the training."""


def published_order(n_test, n_calibration, seed):
    """Return the places for testing, ascending, and the order in which the authors' modules take them.

    Call by call over the list of all places, as their data split draws it, with the numbers of that list.
    """
    n_all = n_test + n_calibration
    state = np.random.RandomState(42)
    calibration = state.permutation(n_all)[:n_calibration].tolist()
    state.seed(seed)
    state.shuffle(calibration)
    everything = state.permutation(n_all)
    rest = sorted(set(everything.tolist()) - set(calibration))
    shuffled = list(rest)
    state.shuffle(shuffled)
    return rest, shuffled


def split(n_places, **arguments):
    return [group.tolist() for group in split_places(n_places, Model(**arguments))]


@pytest.mark.parametrize(("seed", "n_test", "n_calibration"), [(0, 375, 75), (40, 360, 0), (40, 53, 10)])
def test_shuffled_modules_hold_the_places_that_the_published_split_gives_them(seed, n_test, n_calibration):
    rest, shuffled = published_order(n_test, n_calibration, seed)
    groups = split(n_test, module_order="shuffled", seed=seed, calibration_places=n_calibration)
    assert [len(group) for group in groups[:-1]] == [25] * (-(-n_test // 25) - 1)
    assert [rest[place] for group in groups for place in group] == shuffled


@pytest.mark.parametrize(
    ("places", "shown", "labels"),
    [
        pytest.param([0, 1, 2, 0, 1, 2], [0, 1, 3, 4], [0, 1, 0, 1], id="one traverse, then the other"),
        pytest.param([1, 1, 0, 0, 2, 0], [2, 0, 3, 1, 5], [0, 1, 0, 1, 0], id="by how often seen"),
    ],
)
def test_a_module_is_shown_its_places_along_the_first_traverse_and_then_along_the_second(places, shown, labels):
    levels = np.arange(len(places), dtype=np.uint8)[:, None]
    first, second = make_lessons(Model(places_per_module=2), levels, np.array(places), 7)
    assert (first.number, first.places.tolist()) == (7, [0, 1])
    assert (first.levels[:, 0].tolist(), first.labels.tolist()) == (shown, labels)
    assert (second.number, second.places.tolist()) == (8, [2])


def test_a_trained_module_equals_the_direct_simulation_from_its_first_silence_on(monkeypatch):
    # Neurons that start at rest, so that the silence, 150 ms as every later presentation with its rest, is one more
    # image of the direct simulation, without input. Theta falls in it too, and here so fast that it matters.
    model = Model(
        **{"height": 1, "width": 30, "n_excitatory": 5, "epochs": 2, "weight_sum": 20.0, "theta_tau_ms": 1e4},
        **{"presentation_ms": 100.0, "rest_ms": 50.0, "first_rest_ms": 150.0},
        **{"excitatory_start_mv": -65.0, "inhibitory_start_mv": -60.0},
    )
    levels = np.random.default_rng(0).integers(0, 256, (3, 30)).astype(np.uint8)
    task = Lesson(4, levels, np.array([0, 1, 0]), np.array([8, 9]))
    trains = recorded_trains(monkeypatch)
    found = train(model, task, lambda share: None)

    silence = np.zeros((1000, 30), np.bool_)
    theta = np.full(5, 20.0)
    expected = direct.simulate(
        model.draw_weights(4), model.draw_delays(4), theta, [silence, *trains], model, True, 20.0
    )
    counts = expected.counts[1:]
    assert len(counts) == 6
    assert counts.sum() > 20
    assert unpack_neurons(found["weights"], 5) == pytest.approx(expected.weights, abs=1e-9)
    assert found["theta"] == pytest.approx(expected.theta, abs=1e-9)
    assert found["sums"].tolist() == np.stack([counts[[0, 2, 3, 5]].sum(0), counts[[1, 4]].sum(0)], 1).tolist()
    assert found["shown"].tolist() == [4, 2]
    assert found["places"].tolist() == [8, 9]


def test_initial_weights_are_uniform_from_the_offset_on_and_delays_rounded_to_the_nearest_step():
    weights = Model(height=1, width=200, n_excitatory=50).draw_weights(0)
    assert weights.shape == (200, 50)
    shares = (weights / 0.3 - 0.01).ravel()
    assert np.histogram(shares, 10, (0, 1))[0] == pytest.approx(1000, abs=150)  # five standard deviations
    assert 0 <= shares.min() < shares.max() < 1
    times = np.bincount(Model(height=1, width=300, n_excitatory=1000).draw_delays(0).ravel(), minlength=101)
    assert len(times) == 101
    assert times[1:100] == pytest.approx(3000, abs=300)
    assert times[[0, 100]] == pytest.approx(1500, abs=200)  # half a step is nearest to each of them


def test_two_threads_train_and_answer_what_one_does():
    alone = fitted(15, epochs=2)
    codes = alone.encode(images(WORLD.queries))
    expected = alone.match(codes)
    torch.set_num_threads(2)
    together = fitted(15, epochs=2)
    assert same(alone.state(), together.state())
    assert np.array_equal(together.match(codes), expected)
    assert for_each_module(lambda module, tell: module**2, 20, Stage("squares")) == [n**2 for n in range(20)]


@pytest.fixture
def trainings(tmp_path, monkeypatch):
    """The folder of partial trainings."""
    monkeypatch.setenv("VPRBENCH_PARTIAL", str(tmp_path))
    return tmp_path


@pytest.fixture
def trained(monkeypatch):
    """The `numbers` of modules in the order they are trained; at the one called `fatal` the training is interrupted."""
    seen = SimpleNamespace(numbers=[], fatal=None)

    def watched(model, shown, *others):
        if len(seen.numbers) == seen.fatal:
            raise Interrupted
        seen.numbers.append(shown.number)
        return train(model, shown, *others)

    monkeypatch.setattr(training, "train", watched)
    return seen


def interrupt(trained, after, work):
    """Do the work, interrupted once so many modules are trained, and forget that they were."""
    trained.fatal = after
    with pytest.raises(Interrupted):
        work()
    assert len(trained.numbers) == after
    trained.numbers, trained.fatal = [], None


@pytest.mark.parametrize(
    ("work", "n_trained", "n_missing"),
    [
        pytest.param(lambda: fitted(20, epochs=2), 2, 2, id="training"),
        pytest.param(lambda: VPRSNNEnsemble(**SMALL, seeds=[0, 10]).fit(*references(10)), 3, 1, id="ensemble"),
        pytest.param(lambda: fitted().calibrate(held_out()), 2, 1, id="calibration"),  # after a map of one module
    ],
)
def test_what_was_interrupted_trains_only_what_is_missing_also_in_other_threads(
    trainings, trained, work, n_trained, n_missing
):
    expected = work().state()
    assert not list(trainings.iterdir())
    trained.numbers = []
    interrupt(trained, n_trained, work)
    assert list(trainings.iterdir())
    torch.set_num_threads(2)
    found = work()
    assert len(trained.numbers) == n_missing
    assert [f"leaves out {n_trained} modules" in note for note in found.notes()].count(True) == 1
    assert same(found.state(), expected)
    assert not list(trainings.iterdir())


@pytest.mark.parametrize("change", [{"seed": 1}, {"theta_plus_mv": 0.06}, {"assignment": "weighted"}, "image", "place"])
@pytest.mark.usefixtures("trainings")
def test_a_training_goes_on_with_modules_of_the_same_training_alone(trained, change):
    interrupt(trained, 1, lambda: fitted(10))
    shown, places = references(10)
    if change == "image":
        shown = images([image // 2 if row == 15 else image for row, image in enumerate(shown)])
    elif change == "place":
        places = places[::-1].copy()
    VPRSNN(**{**SMALL, **(change if isinstance(change, dict) else {})}).fit(shown, places)
    # A weighted assignment asks otherwise, but learns the same.
    assert trained.numbers == ([1] if change == {"assignment": "weighted"} else [0, 1])


OTHERS = {  # than the published numbers, and each changes what is learnt
    **{"preprocessing": "C", "patch": 5, "places_per_module": 4, "n_excitatory": 23, "epochs": 5, "levels_per_hz": 5.0},
    **{"time_step_ms": 0.2, "first_rest_ms": 50.0, "presentation_ms": 300.0, "rest_ms": 100.0},
    "input_delay_max_ms": 5.0,
    **{"weight_scale": 0.2, "weight_offset": 0.1, "weight_sum": 60.0, "weight_max": 0.7, "theta_start_mv": 22.0},
    **{"excitatory_rest_mv": -66.0, "excitatory_reset_mv": -64.0, "excitatory_threshold_mv": -70.0},
    **{"excitatory_tau_ms": 80.0, "excitatory_refractory_ms": 6.0, "excitatory_minimum_interval_ms": 40.0},
    **{"theta_plus_mv": 0.1, "theta_tau_ms": 1e5, "inhibitory_rest_mv": -70.0, "inhibitory_threshold_mv": -30.0},
    **{"inhibitory_tau_ms": 8.0, "excitation_reversal_mv": 5.0, "excitatory_inhibition_reversal_mv": -110.0},
    **{"excitation_tau_ms": 1.2, "inhibition_tau_ms": 0.8, "excitatory_to_inhibitory_weight": 8.0},
    **{"inhibitory_to_excitatory_weight": 12.0, "pre_trace_tau_ms": 30.0, "post_trace_tau_ms": 30.0},
    **{"slow_post_trace_tau_ms": 60.0, "pre_rate": 2e-4, "post_rate": 0.02, "fast": True, "seed": 1},
}
PAIRS = [
    {"excitatory_start_mv": -95.0, "first_rest_ms": 50.0},
    {"inhibitory_refractory_ms": 0.0, "excitatory_to_inhibitory_weight": 30.0},
]


@pytest.fixture(scope="module")
def usual_weights():
    return fitted(epochs=2).state()["weights"]


@pytest.mark.parametrize("change", [*({name: value} for name, value in OTHERS.items()), *PAIRS], ids=str)
def test_every_argument_of_the_training_changes_what_is_learnt(change, usual_weights):
    one, other = usual_weights, fitted(**{"epochs": 2, **change}).state()["weights"]
    assert one.shape != other.shape or not np.array_equal(one, other)

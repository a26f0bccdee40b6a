"""Which place a neuron speaks for: the one to which it gave most spikes a presentation."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
import numpy.typing as npt
import pytest

from vprbench.methods.vprsnn.scoring import Learnt, labels


def one_module(
    sums: Sequence[Sequence[float]], shown: Sequence[int] | None = None, places: Sequence[int] | None = None
) -> Learnt:
    """Return a module of neurons that gave `sums` (n_neurons, n_labels) in five presentations of each label."""
    n_labels = len(sums[0])
    return Learnt(
        np.array([sums], np.float32),
        np.array([shown or [5] * n_labels]),
        np.array([places or range(n_labels)], np.int64),
    )


def label_by_label(
    sums: npt.NDArray[np.float32], shown: npt.NDArray[np.int64], places: npt.NDArray[np.int64]
) -> npt.NDArray[np.int64]:
    """Assign as the authors do: a neuron goes over to a label that has a higher mean than all before it."""
    found = np.full(sums.shape[:2], -1)
    for module, neuron in np.ndindex(found.shape):
        highest = Fraction(0)
        for label, place in enumerate(places[module].tolist()):
            presentations = int(shown[module, label])
            if place < 0 or not presentations:
                continue
            mean = Fraction(int(sums[module, neuron, label]), presentations)
            if mean > highest:
                highest, found[module, neuron] = mean, place
    return found


def test_a_neuron_speaks_for_the_place_that_drew_most_of_its_spikes() -> None:
    assert labels(one_module([[3, 9, 4], [7, 0, 1]])).tolist() == [[1, 0]]


def test_spikes_are_compared_by_presentation_not_by_sum() -> None:
    assert labels(one_module([[8, 6]], shown=[4, 2])).tolist() == [[1]]  # 2 and 3 a presentation


def test_of_equals_it_is_the_first_label() -> None:
    assert labels(one_module([[0, 6, 6, 2], [4, 1, 4, 4]])).tolist() == [[1, 0]]


def test_equal_means_of_different_sums_tie() -> None:
    assert labels(one_module([[1, 2, 7]], shown=[3, 6, 21])).tolist() == [[0]]


def test_of_equals_it_is_the_first_in_the_module_not_the_first_on_the_route() -> None:
    assert labels(one_module([[5, 5]], places=[17, 3])).tolist() == [[17]]


def test_a_neuron_that_never_fired_speaks_for_no_place() -> None:
    assert labels(one_module([[0, 0, 0], [0, 0, 1]])).tolist() == [[-1, 2]]


def test_a_label_that_was_not_shown_in_the_recorded_presentations_draws_no_neuron() -> None:
    assert labels(one_module([[0, 2], [0, 0]], shown=[0, 3])).tolist() == [[1, -1]]


def test_no_neuron_of_a_smaller_last_module_speaks_for_a_place_that_is_not_there() -> None:
    learnt = Learnt(
        np.array([[[1, 0, 8], [0, 4, 0]], [[2, 0, 0], [0, 0, 0]]], np.float32),
        np.array([[5, 5, 5], [5, 0, 0]]),
        np.array([[0, 1, 2], [3, -1, -1]]),
    )
    assert labels(learnt).tolist() == [[2, 1], [3, -1]]


def test_neurons_speak_for_places_of_the_map_whatever_order_the_modules_learn_them_in() -> None:
    learnt = Learnt(
        np.array([[[0, 3]], [[3, 0]], [[0, 9]]], np.float32), np.full((3, 2), 5), np.array([[4, 1], [5, 0], [2, 3]])
    )
    assert labels(learnt).tolist() == [[1], [5], [3]]


@pytest.mark.parametrize("seed", range(4))
def test_assignment_is_that_of_a_loop_over_neurons_and_labels(seed: int) -> None:
    random = np.random.default_rng(seed)
    shape = 4, 30, 6  # few values, so that ties and silent neurons are frequent
    sums = (random.integers(0, 5, shape) * (random.random(shape) < 0.5)).astype(np.float32)
    shown = random.integers(0, 4, (4, 6))
    places = random.permutation(24).reshape(4, 6)
    places[-1, 4:] = -1
    shown[places < 0] = 0
    sums *= shown[:, None] > 0
    found = labels(Learnt(sums, shown, places))
    assert found.dtype == np.int64
    assert np.array_equal(found, label_by_label(sums, shown, places))

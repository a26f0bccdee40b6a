"""Which places the modules of VPRSNN learn: along the route, or shuffled as its authors do."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt
import pytest

from vprbench.methods.vprsnn.training_sets import modules


def published_order(n_test: int, n_calibration: int, seed: int) -> tuple[list[int], list[int]]:
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


def flat(groups: list[npt.NDArray[np.int64]]) -> list[int]:
    return [place for group in groups for place in group.tolist()]


def test_contiguous_modules_take_places_along_the_route_and_the_last_takes_what_is_left() -> None:
    assert [group.tolist() for group in modules(7, 3, "contiguous", 5, 4)] == [[0, 1, 2], [3, 4, 5], [6]]


def test_a_route_that_modules_divide_evenly_ends_with_a_whole_module() -> None:
    assert [group.tolist() for group in modules(6, 3, "contiguous", 0, 0)] == [[0, 1, 2], [3, 4, 5]]


def test_fewer_places_than_a_module_holds_are_one_module() -> None:
    assert [group.tolist() for group in modules(4, 25, "contiguous", 0, 0)] == [[0, 1, 2, 3]]


@pytest.mark.parametrize("seed", [0, 40])
@pytest.mark.parametrize(("n_test", "n_calibration"), [(2700, 600), (375, 75), (360, 0), (53, 10)])
def test_shuffled_modules_hold_the_places_that_the_published_split_gives_them(
    seed: int, n_test: int, n_calibration: int
) -> None:
    rest, shuffled = published_order(n_test, n_calibration, seed)
    groups = modules(n_test, 25, "shuffled", seed, n_calibration)
    for module, group in enumerate(groups):
        assert [rest[place] for place in group] == shuffled[25 * module : 25 * module + 25]
    assert len(groups) == -(-n_test // 25)


def test_nordland_as_published_has_108_modules_of_25_places() -> None:
    assert [len(group) for group in modules(2700, 25, "shuffled", 0, 600)] == [25] * 108


@pytest.mark.parametrize("order", ["contiguous", "shuffled"])
def test_every_place_is_in_one_module(order: Literal["contiguous", "shuffled"]) -> None:
    assert sorted(flat(modules(103, 25, order, 3, 20))) == list(range(103))


def test_a_shuffled_module_is_no_stretch_of_the_route() -> None:
    for group in modules(100, 25, "shuffled", 0, 0):
        assert group.max() - group.min() >= 25


def test_the_shuffled_order_follows_the_seed_and_the_number_of_places_set_aside() -> None:
    given = flat(modules(100, 25, "shuffled", 0, 20))
    assert given == flat(modules(100, 25, "shuffled", 0, 20))
    assert given != flat(modules(100, 25, "shuffled", 10, 20))
    assert given != flat(modules(100, 25, "shuffled", 0, 40))

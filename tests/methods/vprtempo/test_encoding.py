"""Grey levels as input spikes: the plain scale and the public code's 8-bit step, by hand in float64."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from vprbench.methods.vprtempo.encoding import spikes_of

# Float32 near 1 has steps of 6e-8, and its rounding acts twice or three times.
ROUNDING = 2.5e-7
EITHER = pytest.mark.parametrize("fake_quantised", [False, True], ids=["plain", "8-bit step"])


def levels(rows: npt.ArrayLike) -> npt.NDArray[np.uint8]:
    return np.asarray(rows, np.uint8)


def test_without_the_8_bit_step_a_spike_is_the_level_over_255() -> None:
    every = np.arange(256).reshape(4, 64)
    assert spikes_of(levels(every), False) == pytest.approx(every / 255, abs=ROUNDING)


def test_with_a_maximum_of_255_the_8_bit_step_changes_nothing() -> None:
    every = np.arange(256)[None]
    assert spikes_of(levels(every), True) == pytest.approx(every / 255, abs=ROUNDING)


def test_below_255_a_spike_goes_to_the_nearest_255th_of_the_maximum() -> None:
    # Maximum 51 of 255 = 0.2, so a step of the grid is 0.2 / 255. Level 10 is 50 steps exactly, as a level is 5.
    # Maximum 201: level 100 is 100 * 255 / 201 = 126.87 steps, the 127th; level 50 is 63.43, the 63rd.
    found = spikes_of(levels([[51, 10, 0], [201, 100, 50]]), True)
    expected = [[0.2, 50 * 0.2 / 255, 0], [201 / 255, 127 * 201 / 255**2, 63 * 201 / 255**2]]
    assert found == pytest.approx(np.array(expected), abs=ROUNDING)


@pytest.mark.parametrize("most", range(1, 256, 14))
def test_the_grid_of_the_8_bit_step_ends_at_the_maximum(most: int) -> None:
    every = np.arange(most + 1)  # under an odd maximum no level lies halfway between two points
    expected = np.round(every * 255 / most) * most / 255 / 255
    assert spikes_of(levels(every[None]), True)[0] == pytest.approx(expected, abs=ROUNDING)


def test_every_image_has_a_grid_of_its_own() -> None:
    rows = np.array([[3, 1, 2], [255, 1, 2], [0, 0, 0], [201, 100, 50]])
    alone = [spikes_of(levels(row[None]), True) for row in rows]
    assert np.array_equal(spikes_of(levels(rows), True), np.concatenate(alone))


@EITHER
@pytest.mark.parametrize("count", [0, 1, 3])
def test_spikes_are_float32_a_row_for_each_image_and_0_where_it_is_black(fake_quantised: bool, count: int) -> None:
    found = spikes_of(np.zeros((count, 7), np.uint8), fake_quantised)
    assert (found.shape, found.dtype) == ((count, 7), np.float32)
    assert not found.any()


@EITHER
def test_levels_stay_as_they_were_and_may_be_unwritable_or_lie_apart_in_memory(fake_quantised: bool) -> None:
    rows = levels([[3, 1, 200], [0, 9, 255]])
    rows.flags.writeable = False
    found = spikes_of(rows, fake_quantised)
    assert found.max() == 1.0
    assert rows.tolist() == [[3, 1, 200], [0, 9, 255]]
    apart = np.repeat(np.repeat(rows, 2, axis=0), 3, axis=1)[::2, ::3]
    assert np.array_equal(spikes_of(apart, fake_quantised), found)

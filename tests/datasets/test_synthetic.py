"""The embedded journey: same pixels everywhere, and seasons that differ as seasons do."""

from functools import partial

import numpy as np
import pytest
from rendered_frames import frames_of_traverse, mean_difference, pixel_digest

from vprbench.datasets.synthetic import synthetic

SEASONS = ("spring", "summer", "fall", "winter")

season_frames = partial(frames_of_traverse, synthetic)


def test_the_same_seed_gives_the_same_pixels_on_every_machine():
    digest = pixel_digest(synthetic, SEASONS, [0, 1, 77, 805, 1827, 3299])
    assert digest == "ce95628f10b59f52e2c67a106b8e7467bdd780fc4761d25d7d9fcdb7f55aa642"


def test_snow_makes_the_ground_of_winter_brighter_than_that_of_the_other_seasons():
    ground = {season: season_frames(season, range(0, 600, 20))[:, 60:].mean() for season in SEASONS}
    assert ground["winter"] > 1.3 * max(ground["summer"], ground["fall"])


def test_summer_is_green_and_fall_is_red():
    def redness(season):
        red, green, _ = season_frames(season, range(0, 600, 20))[:, 60:].mean(axis=(0, 1, 2))
        return red / green

    assert redness("summer") < 1 < 1.1 < redness("fall")


@pytest.mark.parametrize("season", ["spring", "fall", "winter"])
def test_a_place_looks_different_in_another_season(season):
    places = range(0, 600, 20)
    assert mean_difference(season_frames("summer", places), season_frames(season, places)) > 15


def test_snow_lies_deeper_in_some_stretches_of_winter_than_in_others():
    # Beside the line, where summer has nothing but ground.
    verge = season_frames("winter", range(0, 900, 9))[:, 70:, 8:40].mean(axis=(1, 2, 3))
    assert np.quantile(verge, 0.9) > 1.3 * np.quantile(verge, 0.1)


def test_woods_stand_dark_against_the_sky_of_summer():
    frames = season_frames("summer", range(0, 900, 9)).mean(axis=3)
    assert (frames[:, 4:14, 60:100].mean(axis=(1, 2)) > 1.3 * frames[:, 28:40, :30].mean(axis=(1, 2))).mean() > 0.8

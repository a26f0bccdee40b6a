"""The embedded journey: same pixels everywhere, and seasons that differ as seasons do."""

from functools import partial

import pytest
from rendered_frames import frames_of_traverse, mean_difference, pixel_digest

from vprbench.datasets.synthetic import synthetic

SEASONS = ("spring", "summer", "fall", "winter")

season_frames = partial(frames_of_traverse, synthetic)


def test_the_same_seed_gives_the_same_pixels_on_every_machine():
    digest = pixel_digest(synthetic, SEASONS, [0, 1, 77, 805, 1827, 3299])
    assert digest == "2b57baec6551af586a49264f85d5feab3413aef6be3553b615ae9619ae95bacd"


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

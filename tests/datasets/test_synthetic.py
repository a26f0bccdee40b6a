"""The embedded journey: same pixels everywhere, and seasons that differ as seasons do."""

from functools import partial

from rendered_frames import frames_of_traverse, pixel_digest

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

"""The embedded street: same pixels everywhere, traverses that differ, places that can be told apart but barely."""

from functools import partial

import numpy as np
from rendered_frames import frames_of_traverse, pixel_digest

from vprbench.datasets.street import street
from vprbench.methods.sad import SAD

TRAVERSES = ("sun", "rain", "dusk")

frames_of = partial(frames_of_traverse, street)


def test_the_same_seed_gives_the_same_pixels_on_every_machine():
    digest = pixel_digest(street, TRAVERSES, [0, 1, 140, 268, 449, 26_990])
    assert digest == "6b3a6e4084d1e84513ebc4176b650a8d315c662ddec66d8bc3488ac986c0fd62"


def test_the_sun_is_brightest_and_the_most_contrasty_and_dusk_is_darkest():
    level, contrast = (
        {traverse: np.mean(measure(frames_of(traverse, range(0, 450, 15)))) for traverse in TRAVERSES}
        for measure in (np.mean, lambda frames: frames.std(axis=(1, 2, 3)))
    )
    assert level["sun"] > 1.2 * level["rain"] > 1.2 * 1.2 * level["dusk"]
    assert contrast["sun"] > 1.3 * contrast["rain"]


def test_every_place_can_be_found_again_in_the_frame_itself_and_few_across_weather():
    # What makes it a benchmark: the same frames match perfectly, dusk against sun and rain between 25 and 50 %.
    dataset = street()
    method = SAD().fit(dataset.references, dataset.places)
    best = method.query(dataset.queries).argmax(axis=1)
    hits = np.mean([found in right for found, right in zip(best, dataset.positives, strict=True)])
    assert 0.25 <= hits <= 0.5
    some = np.arange(0, 450, 9)
    same = method.query(dataset.references[some]).argmax(axis=1)
    assert np.array_equal(same, some)

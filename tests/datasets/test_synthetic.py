"""The rendered railway: frames follow from seed, season and place, and are about as hard as real ones."""

import hashlib

import cv2
import numpy as np
import pytest
from image_folders import answer

from vprbench.datasets.synthetic import synthetic

SEASONS = ("spring", "summer", "fall", "winter")


def test_the_same_seed_gives_the_same_pixels_on_every_machine():
    # All is drawn in integers: if this fails without a change to the renderer, a library draws differently here; after
    # a change, raise the renderer's version and pin the new digest.
    places, pixels = [0, 1, 77, 805, 1827, 3299], b""
    for season in SEASONS:
        references = synthetic(places=3309, references=[season], query=season).references
        pixels += b"".join(references[place].tobytes() for place in places)
    digest = "ce95628f10b59f52e2c67a106b8e7467bdd780fc4761d25d7d9fcdb7f55aa642"
    assert hashlib.sha256(pixels).hexdigest() == digest
    other = synthetic(places=10, references=[season], query=season, seed=1).references[0]
    assert (other.shape, other.dtype) == ((90, 160, 3), np.uint8)
    assert not np.array_equal(other, references[0])


def test_defaults_are_as_large_as_nordland_and_seasons_places_and_seed_are_chosen():
    default = synthetic()
    assert (len(default.references), default.n_places, len(default.queries)) == (6600, 3300, 2700)
    assert (default.queries.names[0], default.positives[0].tolist()) == ("summer/place-00600", [600])
    selected = synthetic("mine", 50, ["spring"], "winter", first_query_place=5, query_places=7, tolerance=1, seed=3)
    assert selected.name == "mine"
    assert dict(selected.protocol) == {
        **{"protocol": "vprtempo", "places": 50, "references": ["spring"], "query": "winter", "first_query_place": 5},
        **{"query_places": 7, "reference_places": 50, "held_out_places": 5, "tolerance_places": 1, "seed": 3},
        **{"width": 160, "height": 90, "renderer": 2},
    }


def shown(images):
    """Return the season and the place of each frame, by its name."""
    return [(name.split("/")[0], int(name[-5:])) for name in images.names]


def test_places_are_set_aside_and_damage_on_purpose_shifts_the_queries():
    # numpy's RandomState(42) draws of ten places first 8, then 1, then 5.
    dataset = synthetic(places=10, references=["fall", "spring"], first_query_place=3, protocol="vprsnn")
    kept = [0, 2, 3, 4, 6, 7, 9]
    assert shown(dataset.references) == [(season, place) for season in ("fall", "spring") for place in kept]
    assert shown(dataset.queries) == [("summer", place) for place in kept]
    assert dataset.places.tolist() == [*range(7), *range(7)]
    assert [right.tolist() for right in dataset.positives] == [[place] for place in range(7)]
    assert [place for _, place in shown(dataset.held_out.queries)] == [1, 5, 8]
    assert (dataset.held_out.places.tolist(), dataset.held_out.right.tolist()) == ([0, 1, 2] * 2, [0, 1, 2])
    assert (dataset.held_out.in_map, dataset.place_numbers.tolist()) == (False, kept)
    assert synthetic(places=10, first_query_place=0).held_out is None
    dataset = synthetic(places=11, query_shift=-2, unanswerable=2)
    assert [place for _, place in shown(dataset.queries)] == [*range(9), 113, 114]
    assert [right.tolist() for right in dataset.positives] == [*([place] for place in range(2, 11)), [], []]
    assert (dataset.protocol["query_shift"], dataset.protocol["unanswerable"]) == (-2, 2)
    plain = synthetic(places=11)
    assert np.array_equal(dataset.queries[2], plain.queries[0])


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"places": 9}, "dataset.places=9: the synthetic journey has 10 to 27000 places"),
        ({"places": 27_001}, "dataset.places=27001: the synthetic journey has 10 to 27000 places"),
        ({"references": ["fall", "tea"]}, "dataset.references=tea: the synthetic journey has spring"),
        ({"references": []}, "dataset.references=[]: name at least one season"),
        ({"references": "fall"}, "dataset.references='fall': name at least one season"),
        ({"places": 11, "query_places": 10}, "dataset.first_query_place=2 and dataset.query_places=10"),
        ({"tolerance": -1}, "dataset.tolerance=-1"),
        ({"seed": -1}, "dataset.seed=-1"),
        ({"unanswerable": -1}, "dataset.unanswerable=-1"),
        ({"places": 11, "query_shift": -3}, "dataset.query_shift=-3"),
    ],
)
def test_a_journey_that_cannot_be_shown_is_refused_by_its_option(options, named):
    assert named in answer(synthetic, **options)


def test_seqslams_differences_find_winter_again_in_summer_as_often_as_was_published_of_real_frames():
    def patches(season):
        """Patches of 8x8 pixels minus their mean, over their standard deviation, in 100 frames of 2761."""
        references = synthetic(places=2761, references=[season], query=season).references
        places = np.linspace(0, 2760, 100).astype(int).tolist()
        grey = [cv2.cvtColor(references[place], cv2.COLOR_RGB2GRAY) for place in places]
        frames = [cv2.resize(frame, (64, 32), interpolation=cv2.INTER_AREA) for frame in grey]
        levels = np.stack(frames).astype(np.float32).reshape(100, 4, 8, 8, 8)
        mean, spread = levels.mean((2, 4), keepdims=True), levels.std((2, 4), keepdims=True)
        return ((levels - mean) / np.where(spread > 0, spread, 1)).reshape(100, -1)

    winter, summer = patches("winter"), patches("summer")
    found = [np.abs(summer - query).mean(axis=1).argmin() for query in winter]
    assert np.mean(found == np.arange(100)) == pytest.approx(0.41, abs=0.08)

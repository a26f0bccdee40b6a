"""The embedded journey: same pixels everywhere, seasons that differ, neighbours that look alike."""

import hashlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from vprbench.datasets.synthetic import synthetic
from vprbench.interface import BadInput

SEASONS = ("spring", "summer", "fall", "winter")


def season_frames(season, places, seed=0):
    dataset = synthetic(places=max(places) + 10, references=[season], query="winter", seed=seed)
    return np.stack([dataset.references[place] for place in places])


def mean_difference(a, b):
    return np.abs(a.astype(int) - b.astype(int)).mean()


def test_the_same_seed_gives_the_same_pixels_on_every_machine():
    # Guards identity across machines and library versions: everything is drawn in integers. Where this fails
    # without a change to the renderer, a library draws differently here; after a change, raise the renderer's
    # version and put the new digest here.
    digest = hashlib.sha256()
    for season in SEASONS:
        digest.update(season_frames(season, [0, 1, 77, 805, 1827, 3299]).tobytes())
    assert digest.hexdigest() == "2b57baec6551af586a49264f85d5feab3413aef6be3553b615ae9619ae95bacd"


def test_frames_are_rgb_of_160_by_90():
    frame = season_frames("summer", [0])[0]
    assert frame.shape == (90, 160, 3)
    assert frame.dtype == np.uint8


def test_another_seed_is_another_journey():
    places = [0, 5, 9]
    assert mean_difference(season_frames("fall", places, seed=0), season_frames("fall", places, seed=1)) > 5


def test_a_frame_does_not_depend_on_what_was_rendered_before():
    in_order = season_frames("spring", range(12))
    order = [7, 3, 11, 0, 5]
    assert np.array_equal(season_frames("spring", order), in_order[order])


def test_threads_render_the_same_frames():
    dataset = synthetic(places=40)
    alone = [dataset.references[i] for i in range(80)]
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(dataset.references.__getitem__, range(80)))
    assert np.array_equal(alone, together)


def test_a_longer_journey_begins_like_a_shorter_one():
    short, long = synthetic(places=10), synthetic(places=27_000)
    assert np.array_equal(short.references[9], long.references[9])
    assert np.array_equal(short.references[10], long.references[27_000])


@pytest.mark.parametrize("season", SEASONS)
def test_neighbouring_places_look_more_alike_than_distant_ones(season):
    places = np.arange(0, 600, 12)
    here, next_to, far = (season_frames(season, places + offset) for offset in (0, 1, 300))
    assert mean_difference(here, next_to) < 0.8 * mean_difference(here, far)


@pytest.mark.parametrize("season", SEASONS)
def test_no_two_places_of_a_season_share_a_frame(season):
    frames = season_frames(season, range(100))
    assert len({frame.tobytes() for frame in frames}) == 100


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


def test_references_follow_one_another_season_after_season():
    dataset = synthetic(places=20, references=["winter", "spring"])
    assert dataset.references.names[0] == "winter/place-00000"
    assert dataset.references.names[20] == "spring/place-00000"
    assert dataset.places.tolist() == [*range(20), *range(20)]
    assert np.array_equal(dataset.references[23], season_frames("spring", [3])[0])


def test_the_defaults_are_as_large_as_the_paper():
    dataset = synthetic()
    assert (len(dataset.references), dataset.n_places, len(dataset.queries)) == (6600, 3300, 2700)
    assert dataset.queries.names[0] == "summer/place-00600"
    assert dataset.positives[0].tolist() == [600]


@pytest.mark.parametrize(("places", "first", "queries"), [(10, 2, 8), (11, 2, 9), (27_000, 4909, 22_091)])
def test_without_a_first_query_place_two_elevenths_of_the_places_are_skipped(places, first, queries):
    dataset = synthetic(places=places)
    assert dataset.n_places == places
    assert dataset.protocol["first_query_place"] == first
    assert dataset.protocol["query_places"] == len(dataset.queries) == queries


def test_the_tolerance_ends_where_the_journey_ends():
    dataset = synthetic(places=10, first_query_place=0, tolerance=2)
    assert dataset.positives[0].tolist() == [0, 1, 2]
    assert dataset.positives[5].tolist() == [3, 4, 5, 6, 7]
    assert dataset.positives[9].tolist() == [7, 8, 9]


def test_the_protocol_says_everything_that_was_selected():
    dataset = synthetic("mine", 50, ["fall"], "winter", first_query_place=5, query_places=7, tolerance=1, seed=3)
    assert dataset.name == "mine"
    assert dict(dataset.protocol) == {
        "places": 50,
        "references": ["fall"],
        "query": "winter",
        "first_query_place": 5,
        "query_places": 7,
        "tolerance_places": 1,
        "seed": 3,
        "width": 160,
        "height": 90,
        "renderer": 1,
    }


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"places": 9}, "dataset.places=9 came; the synthetic journey has 10 to 27000 places"),
        ({"places": 27_001}, "dataset.places=27001 came"),
        ({"references": []}, "wanted at least one of spring, summer, fall, winter"),
        (
            {"references": ["fall", "autumn"]},
            "dataset.references=autumn came; the seasons are spring, summer",
        ),
        ({"references": ["fall", "fall"]}, "name each season once"),
        ({"query": "autumn"}, "dataset.query=autumn came; the seasons are spring, summer, fall, winter"),
        (
            {"places": 20, "first_query_place": 20},
            "dataset.first_query_place=20 came, but the places run from 0 to 19",
        ),
        ({"first_query_place": -1}, "dataset.first_query_place=-1 came"),
        ({"query_places": 0}, "dataset.query_places=0 came"),
        ({"places": 20, "first_query_place": 15, "query_places": 6}, "there are 1 to 5 to query"),
        ({"tolerance": -1}, "dataset.tolerance=-1 came"),
        ({"seed": -1}, "dataset.seed=-1 came"),
    ],
)
def test_bad_input_is_answered_in_one_line_that_names_the_option(arguments, message):
    with pytest.raises(BadInput) as error:
        synthetic(**arguments)
    assert message in str(error.value)
    assert "\n" not in str(error.value)

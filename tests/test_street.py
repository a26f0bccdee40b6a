"""The embedded street: same pixels everywhere, traverses that differ, places that can be told apart but barely."""

import hashlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from vprbench.datasets.street import street
from vprbench.interface import BadInput
from vprbench.methods.sad import SAD

TRAVERSES = ("sun", "rain", "dusk")


def frames_of(traverse, places, seed=0):
    dataset = street(places=max(places) + 10, references=[traverse], query="sun", seed=seed)
    return np.stack([dataset.references[place] for place in places])


def mean_difference(a, b):
    return np.abs(a.astype(int) - b.astype(int)).mean()


def test_the_same_seed_gives_the_same_pixels_on_every_machine():
    # Guards identity across machines and library versions: everything is drawn in integers. Where this fails
    # without a change to the renderer, a library draws differently here; after a change, raise the renderer's
    # version and put the new digest here.
    digest = hashlib.sha256()
    for traverse in TRAVERSES:
        digest.update(frames_of(traverse, [0, 1, 140, 268, 449, 26_990]).tobytes())
    assert digest.hexdigest() == "6b3a6e4084d1e84513ebc4176b650a8d315c662ddec66d8bc3488ac986c0fd62"


def test_frames_are_rgb_of_160_by_90():
    frame = frames_of("sun", [0])[0]
    assert frame.shape == (90, 160, 3)
    assert frame.dtype == np.uint8


def test_another_seed_is_another_street():
    places = [0, 5, 9]
    assert mean_difference(frames_of("rain", places, seed=0), frames_of("rain", places, seed=1)) > 5


def test_a_frame_does_not_depend_on_what_was_rendered_before():
    in_order = frames_of("dusk", range(12))
    order = [7, 3, 11, 0, 5]
    assert np.array_equal(frames_of("dusk", order), in_order[order])


def test_threads_render_the_same_frames():
    dataset = street(places=40)
    alone = [dataset.references[i] for i in range(80)]
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(dataset.references.__getitem__, range(80)))
    assert np.array_equal(alone, together)


def test_a_longer_drive_begins_like_a_shorter_one():
    short, long = street(places=10), street(places=27_000)
    assert np.array_equal(short.references[9], long.references[9])
    assert np.array_equal(short.references[10], long.references[27_000])


@pytest.mark.parametrize("traverse", TRAVERSES)
def test_neighbouring_places_look_more_alike_than_distant_ones(traverse):
    places = np.arange(0, 600, 25)
    here, next_to, far = (frames_of(traverse, places + offset) for offset in (0, 1, 300))
    assert mean_difference(here, next_to) < 0.9 * mean_difference(here, far)


@pytest.mark.parametrize("traverse", TRAVERSES)
def test_no_two_places_of_a_traverse_share_a_frame(traverse):
    frames = frames_of(traverse, range(100))
    assert len({frame.tobytes() for frame in frames}) == 100


def test_the_sun_is_brightest_and_the_most_contrasty_and_dusk_is_darkest():
    level, contrast = (
        {traverse: np.mean(measure(frames_of(traverse, range(0, 450, 15)))) for traverse in TRAVERSES}
        for measure in (np.mean, lambda frames: frames.std(axis=(1, 2, 3)))
    )
    assert level["sun"] > 1.2 * level["rain"] > 1.2 * 1.2 * level["dusk"]
    assert contrast["sun"] > 1.3 * contrast["rain"]


def test_dusk_has_lights_that_outshine_its_sky():
    frames = frames_of("dusk", range(0, 450, 15))
    sky = frames[:, :12, 60:100].mean()
    assert np.median(frames.max(axis=(1, 2, 3))) > 2.5 * sky


def test_colours_are_greyer_in_the_rain_than_in_the_sun():
    def saturation(traverse):
        frames = frames_of(traverse, range(0, 450, 15)).astype(int)
        return (frames.max(axis=3) - frames.min(axis=3)).mean()

    assert saturation("rain") < 0.5 * saturation("sun")


@pytest.mark.parametrize("reference", ["sun", "rain"])
def test_a_place_looks_different_at_dusk(reference):
    places = range(0, 450, 15)
    assert mean_difference(frames_of("dusk", places), frames_of(reference, places)) > 25


def test_traverses_meet_other_vehicles():
    # Red of paint and lights on the road: where there is a bus or a red car in one traverse, another has none.
    def reds(traverse):
        road = frames_of(traverse, range(0, 450, 5))[:, 40:65, 30:130].astype(int)
        return ((road[..., 0] > 90) & (road[..., 0] > 2 * road[..., 1]) & (road[..., 0] > 2 * road[..., 2])).mean(
            (1, 2)
        )

    sun, rain = reds("sun") > 0.02, reds("rain") > 0.02
    assert (sun & ~rain).any()


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


def test_references_follow_one_another_traverse_after_traverse():
    dataset = street(places=20, references=["dusk", "sun"], query="rain")
    assert dataset.references.names[0] == "dusk/place-00000"
    assert dataset.references.names[20] == "sun/place-00000"
    assert dataset.places.tolist() == [*range(20), *range(20)]
    assert np.array_equal(dataset.references[23], frames_of("sun", [3])[0])


def test_the_defaults_are_as_large_as_oxford_in_the_paper():
    dataset = street()
    assert (len(dataset.references), dataset.n_places, len(dataset.queries)) == (900, 450, 360)
    assert dataset.queries.names[0] == "dusk/place-00090"
    assert dataset.positives[0].tolist() == [90]


@pytest.mark.parametrize(("places", "first", "queries"), [(10, 2, 8), (14, 3, 11), (27_000, 5400, 21_600)])
def test_without_a_first_query_place_a_fifth_of_the_places_is_skipped(places, first, queries):
    dataset = street(places=places)
    assert dataset.protocol["first_query_place"] == first
    assert dataset.protocol["query_places"] == len(dataset.queries) == queries


def test_the_protocol_says_everything_that_was_selected():
    dataset = street("mine", 50, ["rain"], "sun", first_query_place=5, query_places=7, tolerance=1, seed=3)
    assert dataset.name == "mine"
    assert dict(dataset.protocol) == {
        "places": 50,
        "references": ["rain"],
        "query": "sun",
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
        ({"places": 9}, "dataset.places=9 came; the city street has 10 to 27000 places"),
        ({"places": 27_001}, "dataset.places=27001 came"),
        ({"references": ["sun", "sun"]}, "name each traverse once"),
        ({"query": "night"}, "dataset.query=night came; the traverses are sun, rain, dusk"),
        ({"first_query_place": 450}, "dataset.first_query_place=450 came, but the places run from 0 to 449"),
        ({"seed": -1}, "dataset.seed=-1 came"),
    ],
)
def test_bad_input_is_answered_in_one_line_that_names_the_option(arguments, message):
    with pytest.raises(BadInput) as error:
        street(**arguments)
    assert message in str(error.value)
    assert "\n" not in str(error.value)

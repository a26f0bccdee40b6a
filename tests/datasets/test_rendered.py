"""What every rendered dataset promises: frames that follow from seed, traverse and place, and plain refusals."""

import hashlib
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from image_folders import answer

from vprbench.datasets.rendering.journey import Rendered, World
from vprbench.datasets.street import street
from vprbench.datasets.synthetic import synthetic

TRAVERSES = {street: ("sun", "rain", "dusk"), synthetic: ("spring", "summer", "fall", "winter")}

each_dataset = pytest.mark.parametrize("dataset", TRAVERSES)
each_traverse = pytest.mark.parametrize(
    ("dataset", "traverse"), [(dataset, traverse) for dataset, known in TRAVERSES.items() for traverse in known]
)


def frames_of(dataset, traverse, places, seed=0):
    """Return the frames of some places of one traverse, (places, height, width, 3)."""
    rendered = dataset(places=max(places) + 10, references=[traverse], query=traverse, seed=seed)
    return np.stack([rendered.references[place] for place in places])


def mean_difference(a, b):
    return np.abs(a.astype(int) - b.astype(int)).mean()


# The frames of each dataset


@pytest.mark.parametrize(
    ("dataset", "places", "digest"),
    [
        (street, [0, 1, 140, 268, 449, 26_990], "6b3a6e4084d1e84513ebc4176b650a8d315c662ddec66d8bc3488ac986c0fd62"),
        (synthetic, [0, 1, 77, 805, 1827, 3299], "ce95628f10b59f52e2c67a106b8e7467bdd780fc4761d25d7d9fcdb7f55aa642"),
    ],
)
def test_the_same_seed_gives_the_same_pixels_on_every_machine(dataset, places, digest):
    # All is drawn in integers: if this fails without a change to the renderer, a library draws differently here; after
    # a change, raise the renderer's version and pin the new digest.
    pixels = b"".join(frames_of(dataset, traverse, places).tobytes() for traverse in TRAVERSES[dataset])
    assert hashlib.sha256(pixels).hexdigest() == digest


@each_traverse
def test_a_frame_depends_on_its_place_and_seed_and_neighbours_look_more_alike_than_distant_places(dataset, traverse):
    in_order = frames_of(dataset, traverse, range(40))
    assert (in_order.shape, in_order.dtype) == ((40, 90, 160, 3), np.uint8)
    assert len({frame.tobytes() for frame in in_order}) == 40
    order = [7, 3, 11, 0, 5]
    assert np.array_equal(frames_of(dataset, traverse, order), in_order[order])
    assert mean_difference(in_order[order], frames_of(dataset, traverse, order, seed=1)) > 5
    step, share = {street: (50, 0.9), synthetic: (24, 0.8)}[dataset]
    places = np.arange(0, 600, step)
    here, next_to, far = (frames_of(dataset, traverse, places + offset) for offset in (0, 1, 300))
    assert mean_difference(here, next_to) < share * mean_difference(here, far)


@each_dataset
def test_threads_render_the_same_frames_and_a_longer_journey_begins_like_a_shorter_one(dataset):
    references = dataset(places=10).references
    alone = [references[i] for i in range(20)]
    with ThreadPoolExecutor(4) as threads:
        assert np.array_equal(alone, list(threads.map(dataset(places=10).references.__getitem__, range(20))))
    long = dataset(places=27_000)
    assert np.array_equal(alone[9], long.references[9])
    assert np.array_equal(alone[10], long.references[27_000])


def test_light_and_colours_differ_as_those_of_weather_and_seasons_do():
    drives = {traverse: frames_of(street, traverse, range(0, 450, 30)) for traverse in TRAVERSES[street]}
    level = {traverse: frames.mean() for traverse, frames in drives.items()}
    assert level["sun"] > 1.2 * level["rain"] > 1.2 * 1.2 * level["dusk"]
    contrast = {traverse: frames.std(axis=(1, 2, 3)).mean() for traverse, frames in drives.items()}
    assert contrast["sun"] > 1.3 * contrast["rain"]
    ground = {season: frames_of(synthetic, season, range(0, 600, 40))[:, 60:] for season in TRAVERSES[synthetic]}
    assert ground["winter"].mean() > 1.3 * max(ground["summer"].mean(), ground["fall"].mean())  # snow
    redness = {season: np.divide(*frames.mean(axis=(0, 1, 2))[:2]) for season, frames in ground.items()}
    assert redness["summer"] < 1 < 1.1 < redness["fall"]


# What the options of each dataset select


@pytest.mark.parametrize(
    ("dataset", "references", "places", "queries", "first"),
    [(street, 900, 450, 360, "dusk/place-00090"), (synthetic, 6600, 3300, 2700, "summer/place-00600")],
)
def test_the_defaults_are_as_large_as_oxford_and_nordland_and_the_protocol_says_what_was_selected(
    dataset, references, places, queries, first
):
    default = dataset()
    assert (len(default.references), default.n_places, len(default.queries)) == (references, places, queries)
    assert default.queries.names[0] == first
    assert default.positives[0].tolist() == [places - queries]
    reference, *_, query = TRAVERSES[dataset]
    selected = dataset("mine", 50, [reference], query, first_query_place=5, query_places=7, tolerance=1, seed=3)
    assert selected.name == "mine"
    assert dict(selected.protocol) == {
        **{"protocol": "vprtempo", "places": 50, "references": [reference], "query": query, "first_query_place": 5},
        **{"query_places": 7, "reference_places": 50, "held_out_places": 5, "tolerance_places": 1, "seed": 3},
        **{"width": 160, "height": 90, "renderer": {street: 1, synthetic: 2}[dataset]},
    }


# The rules themselves, on a journey of 3 to 20 places


class Slate:
    """Renders the seed and the place as a colour: what was asked for can be read off a frame."""

    def __init__(self, seed):
        self.seed = seed

    def render(self, traverse, place, ahead=0):
        return np.full((2, 3, 3), (self.seed, place, len(traverse)), np.uint8)


def little_journey(**asked):
    world = World("the little journey", "hour", ("dawn", "midday"), (1, 4), Slate, 7, fewest_places=3, most_places=20)
    little = type("Little", (Rendered,), {"world": world})
    return little(**{"name": "little", "places": 8, "references": ["dawn"], "query": "midday"} | asked).build()


def shown(images):
    """The places that the frames of the little journey say they are of."""
    return [int(frame[0, 0, 1]) for frame in images]


@pytest.mark.parametrize(
    ("asked", "expected"),
    [
        ({}, [2, 3, 4, 5, 6, 7]),
        ({"places": 3}, [1, 2]),  # a quarter, rounded
        ({"first_query_place": 0}, [0, 1, 2, 3, 4, 5, 6, 7]),
        ({"first_query_place": 7}, [7]),
        ({"query_places": 3}, [2, 3, 4]),
    ],
)
def test_first_query_place_and_number_of_queries_are_kept_when_given(asked, expected):
    assert shown(little_journey(**asked).queries) == expected


def test_frames_are_painted_by_the_seed_and_vprsnns_places_set_aside_are_neither_in_the_map_nor_queried():
    # numpy's RandomState(42) draws of eight places first 1, then 5, then 0.
    dataset = little_journey(references=["midday", "dawn"], first_query_place=3, protocol="vprsnn")
    assert shown(dataset.references) == [2, 3, 4, 6, 7, 2, 3, 4, 6, 7]
    assert (shown(dataset.queries), dataset.places.tolist()) == ([2, 3, 4, 6, 7], [*range(5), *range(5)])
    assert [right.tolist() for right in dataset.positives] == [[0], [1], [2], [3], [4]]
    assert (shown(dataset.held_out.references), shown(dataset.held_out.queries)) == ([0, 1, 5, 0, 1, 5], [0, 1, 5])
    assert not dataset.held_out.in_map
    painted = little_journey(references=["midday", "dawn"], query="dawn", seed=9)
    assert painted.references[5][0, 0].tolist() == [9, 5, len("midday")]
    assert painted.references[8 + 5][0, 0].tolist() == [9, 5, len("dawn")]
    assert painted.queries[1][0, 0].tolist() == [9, 3, len("dawn")]
    assert painted.protocol["renderer"] == 7


def test_damage_on_purpose_shifts_the_queries_and_adds_some_that_have_no_answer():
    dataset = little_journey(query_shift=-2, unanswerable=2)
    assert shown(dataset.queries) == [0, 1, 2, 3, 4, 5, 110, 111]
    assert [right.tolist() for right in dataset.positives] == [[2], [3], [4], [5], [6], [7], [], []]
    assert (dataset.protocol["query_shift"], dataset.protocol["unanswerable"]) == (-2, 2)


@pytest.mark.parametrize(
    ("make", "asked", "told"),
    [
        (street, {"places": 9}, "dataset.places=9: the city street has 10 to 27000 places"),
        (synthetic, {"places": 27_001}, "dataset.places=27001: the synthetic journey has 10 to 27000 places"),
        (street, {"query": "fog"}, "dataset.query=fog: the city street has sun, rain, dusk"),
        (synthetic, {"references": ["fall", "tea"]}, "dataset.references=tea: the synthetic journey has spring"),
        (synthetic, {"references": []}, "dataset.references=[]: name at least one season"),
        (little_journey, {"references": "dawn"}, "dataset.references='dawn': name at least one hour"),
        (little_journey, {"first_query_place": 8}, "dataset.first_query_place=8 and dataset.query_places=0"),
        (little_journey, {"query_places": 7}, "dataset.first_query_place=2 and dataset.query_places=7"),
        (little_journey, {"protocol": "sift"}, "dataset.protocol=sift: choose vprtempo or vprsnn"),
        (little_journey, {"tolerance": -1}, "dataset.tolerance=-1"),
        (little_journey, {"seed": -1}, "dataset.seed=-1"),
        (little_journey, {"unanswerable": -1}, "dataset.unanswerable=-1"),
        (little_journey, {"query_shift": -3}, "dataset.query_shift=-3"),
    ],
)
def test_what_a_journey_cannot_show_is_refused_by_its_option(make, asked, told):
    assert told in answer(make, **asked)

"""What every rendered dataset promises: frames that follow from seed, traverse and place, and plain refusals."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from image_folders import answer
from rendered_frames import frames_of_traverse, mean_difference

from vprbench.datasets.rendering.journey import Rendered, World
from vprbench.datasets.street import street
from vprbench.datasets.synthetic import synthetic

TRAVERSES = {street: ("sun", "rain", "dusk"), synthetic: ("spring", "summer", "fall", "winter")}

each_dataset = pytest.mark.parametrize("dataset", TRAVERSES)
each_traverse = pytest.mark.parametrize(
    ("dataset", "traverse"), [(dataset, traverse) for dataset, known in TRAVERSES.items() for traverse in known]
)


class Slate:
    """Renders the seed and the place as a colour: what was asked for can be read off a frame."""

    def __init__(self, seed):
        self.seed = seed

    def render(self, traverse, place, ahead=0):
        return np.full((2, 3, 3), (self.seed, place, len(traverse)), np.uint8)


def little_journey(skipped=(1, 4), **asked):
    world = World("the little journey", "hour", ("dawn", "midday"), skipped, Slate, 7, fewest_places=3)
    little = type("Little", (Rendered,), {"world": world})
    return little(**{"name": "little", "places": 8, "references": ["dawn"], "query": "midday"} | asked).build()


def queried(dataset):
    return dataset.protocol["first_query_place"], dataset.protocol["query_places"]


# The frames of each dataset


@each_traverse
def test_another_seed_is_another_journey(dataset, traverse):
    one, other = (frames_of_traverse(dataset, traverse, [0, 5, 9], seed) for seed in (0, 1))
    assert mean_difference(one, other) > 5


@each_traverse
def test_a_frame_does_not_depend_on_what_was_rendered_before(dataset, traverse):
    in_order = frames_of_traverse(dataset, traverse, range(12))
    order = [7, 3, 11, 0, 5]
    assert np.array_equal(frames_of_traverse(dataset, traverse, order), in_order[order])


@each_dataset
def test_threads_render_the_same_frames(dataset):
    references = dataset(places=40).references
    alone = [references[i] for i in range(80)]
    with ThreadPoolExecutor(4) as threads:
        together = list(threads.map(references.__getitem__, range(80)))
    assert np.array_equal(alone, together)


@each_dataset
def test_a_longer_journey_begins_like_a_shorter_one(dataset):
    short, long = dataset(places=10), dataset(places=27_000)
    assert np.array_equal(short.references[9], long.references[9])
    assert np.array_equal(short.references[10], long.references[27_000])


@each_traverse
def test_neighbouring_places_look_more_alike_than_distant_ones(dataset, traverse):
    step, share = {street: (25, 0.9), synthetic: (12, 0.8)}[dataset]
    places = np.arange(0, 600, step)
    here, next_to, far = (frames_of_traverse(dataset, traverse, places + offset) for offset in (0, 1, 300))
    assert mean_difference(here, next_to) < share * mean_difference(here, far)


@each_traverse
def test_no_two_places_of_a_traverse_share_a_frame(dataset, traverse):
    frames = frames_of_traverse(dataset, traverse, range(100))
    assert (frames.shape, frames.dtype) == ((100, 90, 160, 3), np.uint8)
    assert len({frame.tobytes() for frame in frames}) == 100


# What the options of each dataset select


@pytest.mark.parametrize(
    ("dataset", "references", "places", "queries", "first"),
    [(street, 900, 450, 360, "dusk/place-00090"), (synthetic, 6600, 3300, 2700, "summer/place-00600")],
)
def test_the_defaults_are_as_large_as_oxford_and_nordland_in_the_paper(dataset, references, places, queries, first):
    default = dataset()
    assert (len(default.references), default.n_places, len(default.queries)) == (references, places, queries)
    assert default.queries.names[0] == first
    assert default.positives[0].tolist() == [places - queries]


@pytest.mark.parametrize(
    ("dataset", "places", "expected"), [(street, 14, (3, 11)), (synthetic, 27_000, (4909, 22_091))]
)
def test_a_fifth_of_the_street_and_two_elevenths_of_the_journey_are_not_queried(dataset, places, expected):
    assert queried(dataset(places=places)) == expected


@each_dataset
def test_the_protocol_says_everything_that_was_selected(dataset):
    reference, *_, query = TRAVERSES[dataset]
    selected = dataset("mine", 50, [reference], query, first_query_place=5, query_places=7, tolerance=1, seed=3)
    assert selected.name == "mine"
    assert dict(selected.protocol) == {
        "protocol": "vprtempo",
        "places": 50,
        "references": [reference],
        "query": query,
        "first_query_place": 5,
        "query_places": 7,
        "reference_places": 50,
        "held_out_places": 5,
        "tolerance_places": 1,
        "seed": 3,
        "width": 160,
        "height": 90,
        "renderer": {street: 1, synthetic: 2}[dataset],
    }


# The rules themselves, on a journey of 3 to 20 places


@pytest.mark.parametrize(
    ("first", "count", "expected"), [(0, None, (0, 8)), (7, None, (7, 1)), (2, 6, (2, 6)), (None, 3, (2, 3))]
)
def test_first_query_place_and_number_of_queries_are_kept_when_given(first, count, expected):
    assert queried(little_journey(first_query_place=first, query_places=count)) == expected


def test_the_painter_of_the_seed_renders_each_query_and_reference():
    dataset = little_journey(references=["midday", "dawn"], query="dawn", seed=9)
    assert dataset.references[5][0, 0].tolist() == [9, 5, len("midday")]
    assert dataset.references[8 + 5][0, 0].tolist() == [9, 5, len("dawn")]
    assert dataset.queries[1][0, 0].tolist() == [9, 3, len("dawn")]
    assert dataset.protocol["renderer"] == 7


def shown(images):
    """The places that the frames of the little journey say they are of."""
    return [int(frame[0, 0, 1]) for frame in images]


# numpy's RandomState(42) draws of eight places first 1, then 5, then 0.


def test_as_vprsnns_authors_evaluate_the_places_set_aside_are_neither_in_the_map_nor_queried():
    dataset = little_journey(references=["midday", "dawn"], first_query_place=3, protocol="vprsnn")
    assert shown(dataset.references) == [2, 3, 4, 6, 7, 2, 3, 4, 6, 7]
    assert (shown(dataset.queries), dataset.places.tolist()) == ([2, 3, 4, 6, 7], [*range(5), *range(5)])
    assert [right.tolist() for right in dataset.positives] == [[0], [1], [2], [3], [4]]
    assert (shown(dataset.held_out.references), shown(dataset.held_out.queries)) == ([0, 1, 5, 0, 1, 5], [0, 1, 5])
    assert not dataset.held_out.in_map


@pytest.mark.parametrize(
    ("make", "asked", "told"),
    [
        (street, {"places": 9}, "dataset.places=9: the city street has 10 to 27000 places"),
        (synthetic, {"places": 27_001}, "dataset.places=27001: the synthetic journey has 10 to 27000 places"),
        (street, {"query": "fog"}, "dataset.query=fog: the city street has sun, rain, dusk"),
        (synthetic, {"references": ["fall", "tea"]}, "dataset.references=tea: the synthetic journey has spring"),
        (synthetic, {"references": []}, "dataset.references=[]: name at least one season"),
        (little_journey, {"references": "dawn"}, "dataset.references='dawn': name at least one hour"),
        (little_journey, {"references": ["dawn", "dawn"]}, "dataset.references=['dawn', 'dawn']"),
        (little_journey, {"first_query_place": 8}, "dataset.first_query_place=8 and dataset.query_places=0"),
        (little_journey, {"query_places": 7}, "dataset.first_query_place=2 and dataset.query_places=7"),
        (little_journey, {"query_places": 7, "protocol": "vprsnn"}, "need 9 places, and there are 8"),
        (little_journey, {"protocol": "sift"}, "dataset.protocol=sift: choose vprtempo or vprsnn"),
        (little_journey, {"tolerance": -1}, "dataset.tolerance=-1"),
        (little_journey, {"seed": -1}, "dataset.seed=-1"),
        (little_journey, {"unanswerable": -1}, "dataset.unanswerable=-1"),
        (little_journey, {"query_shift": -3}, "dataset.query_shift=-3"),
    ],
)
def test_what_a_journey_cannot_show_is_refused_by_its_option(make, asked, told):
    assert told in answer(make, **asked)

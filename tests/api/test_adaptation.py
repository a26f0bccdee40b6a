"""Codes adapted to the condition that they are seen in: every mean as plain loops take it, and runs of such codes."""

import gc
from dataclasses import dataclass, replace

import numpy as np
import pytest
from little import Prototypes, journey, numbers_in, pictures
from little_runs import asked_for, execute, quiet_surroundings
from published_networks import unit
from quick_runs import quick_runs

import vprbench
from vprbench.api import descriptor
from vprbench.api.adaptation import Adaptation, adapt_traverse
from vprbench.api.dataset import Dataset
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.methods.hog import HOG
from vprbench.plugins.rules import Journey
from vprbench.runs.stream import grow_map
from vprbench.runs.viewpoints import Viewpoint, render_view

N_PLACES, N_QUERIES, N_DIMENSIONS = 80, 150, 12
DRAW = np.random.default_rng(0)
PLACES = DRAW.normal(size=(N_PLACES, N_DIMENSIONS))
MORNING, EVENING = DRAW.normal(size=(2, N_DIMENSIONS))  # what all images of a condition have in common
SEEN = PLACES[np.arange(N_QUERIES) % N_PLACES] + 0.5 * DRAW.normal(size=(N_QUERIES, N_DIMENSIONS))
REFERENCES, QUERIES = (unit(codes).astype(np.float32) for codes in (PLACES + MORNING, SEEN + 2 * EVENING))
TABLE = np.concatenate([REFERENCES, QUERIES])
RIDE = replace(journey(N_QUERIES, N_PLACES), queries=pictures(range(N_PLACES, len(TABLE))))
ADAPTED = pytest.mark.parametrize("adapt", ["references", "running", "traverse"])


@dataclass(kw_only=True, eq=False)
class Table(DescriptorMethod):
    """Describes image number i by row i of the table."""

    def encode(self, images):
        return TABLE[np.array(numbers_in(images), int)]

    def keeps_descriptors(self):
        return False


@pytest.fixture(autouse=True)
def _quick(tmp_path, monkeypatch):
    quick_runs(monkeypatch)
    monkeypatch.chdir(tmp_path)


def run(method, data=RIDE, **options):
    return vprbench.run(method, data, **{"timing": "none", "threads": 1, "results": None, **options}).run


def slowly(adapt, references, queries):
    """Return the codes of references, (n, d), and queries, (n, d) or (n, views, d), without their means."""
    known = sum(reference.astype(np.float64) for reference in references) / len(references)
    queries = queries.astype(np.float64)
    whole = [query if query.ndim == 1 else sum(query) / len(query) for query in queries]
    found = []
    for at, query in enumerate(queries):
        if adapt == "references":
            mean = known
        elif adapt == "running":
            mean = (sum(whole[: at + 1]) + 20 * known) / (at + 1 + 20)
        else:
            mean = sum(whole) / len(whole)
        found.append(unit(query - mean))
    return np.stack([unit(reference - known) for reference in references]), np.stack(found)


def scores_of(adapt, references=REFERENCES, queries=QUERIES, places=None):
    """Return the scores of places, each that of its best reference from its best view."""
    places = np.arange(len(references)) if places is None else places
    known, asked = slowly(adapt, references, queries)
    similarity = asked @ known.T
    similarity = similarity if similarity.ndim == 2 else similarity.max(1)
    return np.stack([similarity[:, places == place].max(1) for place in range(places.max() + 1)], axis=1)


@ADAPTED
@pytest.mark.parametrize("n_views", [None, 3])
def test_codes_are_without_the_mean_that_plain_loops_take_and_the_views_of_a_query_count_as_one(adapt, n_views):
    method = Table(adapt=adapt).fit(RIDE.references, RIDE.places)
    codes = QUERIES if n_views is None else QUERIES.reshape(-1, n_views, N_DIMENSIONS)
    kept = codes.copy()
    known, asked = slowly(adapt, REFERENCES, codes)
    found = adapt_traverse(method, codes)
    assert (found.dtype, found.shape) == (np.float32, codes.shape)
    assert found == pytest.approx(asked, abs=1e-6)
    assert method.searched.references[:] == pytest.approx(known, abs=1e-6)
    assert method.reference_mean == pytest.approx(REFERENCES.mean(0), abs=1e-6)
    assert np.array_equal(codes, kept)


@ADAPTED
@pytest.mark.parametrize("n_views", [None, 3])
@pytest.mark.parametrize("sizes", [[1] * 150, [64, 0, 1, 63, 22], [149, 1], [7] * 21 + [3]], ids=len)
def test_batches_of_any_split_give_the_same_bits_as_all_queries_at_once(adapt, n_views, sizes):
    draw, shape = np.random.default_rng(1), (150, 1000) if n_views is None else (150, n_views, 1000)
    references, codes = (draw.normal(size=size).astype(np.float32) for size in ((20, 1000), shape))
    method = Table(adapt=adapt).fit_encoded(references, np.arange(20))
    adaptation, blocks = Adaptation(method), np.split(codes, np.cumsum(sizes)[:-1])
    for block in [] if adaptation.is_causal else blocks:
        adaptation.survey(block)
    found = np.concatenate([adaptation.apply(block) for block in blocks])
    assert np.array_equal(found, adapt_traverse(method, codes))


@ADAPTED
def test_a_run_answers_as_plain_loops_do_and_never_sees_what_is_right(adapt):
    found = run(Table(adapt=adapt))
    assert found.scores == pytest.approx(scores_of(adapt), abs=1e-5)
    order = np.random.default_rng(1).permutation(N_QUERIES)
    other = run(Table(adapt=adapt), replace(RIDE, positives=tuple(RIDE.positives[i] for i in order)))
    assert np.array_equal(other.scores, found.scores)
    assert np.array_equal(other.top_places, found.top_places)
    assert other.outcome.above.tolist() != found.outcome.above.tolist()


@ADAPTED
def test_descriptors_that_fill_the_memory_answer_from_a_file_as_from_an_array(adapt, tmp_path, monkeypatch):
    wanted = run(Table(adapt=adapt)).scores
    monkeypatch.setenv("VPRBENCH_SCRATCH", str(tmp_path / "scratch"))
    monkeypatch.setattr(descriptor, "_MEAN_ROWS", 32)
    monkeypatch.setattr(descriptor, "LARGE_BYTES", 1000)
    method = Table(adapt=adapt)
    with quiet_surroundings():
        found = execute(asked_for(method, RIDE))
    assert isinstance(method.searched.references.base, np.memmap)
    assert found.scores == pytest.approx(wanted, abs=1e-6)
    del method
    gc.collect()
    assert not [*(tmp_path / "scratch").rglob("*.npy")]


@dataclass
class Adamant(Prototypes):
    """Has the argument, and codes of which no mean is taken."""

    adapt: str = "none"


def unreadable(_):
    pytest.fail("an image was read")


@pytest.mark.parametrize(
    ("method", "named"),
    [
        (vprbench.method("hog", adapt="sideways"), r"method\.adapt=sideways.*'traverse'"),
        (Adamant(adapt="running"), r"method\.adapt=running.*Adamant"),
        (vprbench.method("patch_netvlad", adapt="running"), r"method\.adapt=running.*PatchNetVLAD"),
    ],
)
def test_what_knows_no_mean_is_refused_before_an_image_is_read(method, named):
    images = Images(unreadable, [f"{i}.png" for i in range(N_PLACES)])
    data = Dataset("unread", images, np.arange(N_PLACES), images, tuple(np.arange(N_PLACES)[:, None]), {})
    with pytest.raises(BadInput, match=named) as error:
        run(method, data)
    assert "\n" not in str(error.value)


# Beside other options

WORLD = Journey.draw(0)
SMALL = {"height": 32, "width": 40}
JOURNEY = Dataset(
    "world",
    Images.from_arrays(WORLD.references),
    WORLD.places,
    Images.from_arrays(WORLD.queries),
    tuple(WORLD.right[:, None]),
    {},
)


def described(images):
    return HOG(**SMALL).encode(images)


@ADAPTED
def test_a_place_has_the_score_of_the_view_that_shows_it_best_whose_query_loses_one_mean(adapt):
    shifts = [-0.1, 0, 0.1]
    views = np.stack(
        [described(Images.from_arrays([render_view(i, Viewpoint(shift)) for i in WORLD.queries])) for shift in shifts],
        1,
    )
    wanted = scores_of(adapt, described(JOURNEY.references), views, WORLD.places)
    assert run(HOG(**SMALL, adapt=adapt), JOURNEY, views=shifts).scores == pytest.approx(wanted, abs=1e-5)


@ADAPTED
def test_places_of_a_growing_map_lose_the_mean_of_its_first_ones(adapt):
    stops = grow_map(replace(asked_for(Table(adapt=adapt), RIDE), stream=30))
    first, mean = REFERENCES[:30], REFERENCES[:30].astype(np.float64).mean(0)
    _, asked = slowly(adapt, first, QUERIES)
    for stop in stops:
        known = unit(REFERENCES[: stop["places"]] - mean)
        right = np.arange(N_QUERIES) % N_PLACES
        hits = ((asked @ known.T).argmax(1) == right)[right < stop["places"]]
        assert (stop["queries"], stop["recall_at_1"]) == (len(hits), pytest.approx(hits.mean()))
    assert [stop["places"] for stop in stops] == [30, 60, 80]

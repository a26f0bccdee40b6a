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
from vprbench.api.adaptation import adapt_traverse
from vprbench.api.dataset import Dataset
from vprbench.api.descriptor import DescriptorMethod
from vprbench.api.images import Images
from vprbench.errors import BadInput

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

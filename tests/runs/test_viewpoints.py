"""Queries from several viewpoints: frames move as they say, the best view counts, an offset is earned by a test."""

from dataclasses import astuple, replace

import numpy as np
import pytest
from little import journey
from little_runs import asked_for

from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.config import make_request
from vprbench.errors import BadInput
from vprbench.methods.sad import SAD
from vprbench.paper.plan import PlannedColumn, Row
from vprbench.paper.selection import ResolvedColumn, groups
from vprbench.runs import runner
from vprbench.runs.offset import find_offset, told_along
from vprbench.runs.viewpoints import AS_IT_IS, Viewed, Viewpoint, Viewpoints, seen_from, view_of, viewpoints

pytestmark = pytest.mark.usefixtures("surroundings")

RANDOM = np.random.default_rng(0)
STEPS = np.arange(-24, 25)


def frames(count):
    """Return random frames of 16 x 64 pixels, in blocks of 4 x 4."""
    return [RANDOM.integers(0, 256, (4, 16, 3), np.uint8).repeat(4, axis=0).repeat(4, axis=1) for _ in range(count)]


@pytest.mark.parametrize(
    ("horizontal", "vertical"), [(0.25, 0.0), (-0.125, 0.0), (0.0, 0.25), (-0.25, -0.5), (0.0, 0.0)]
)
def test_a_view_looks_to_the_right_and_down_by_shares_of_the_frame_and_borders_are_reflected(horizontal, vertical):
    image = frames(1)[0]
    right, down = round(64 * horizontal), round(16 * vertical)
    wide = np.pad(image, ((15, 15), (63, 63), (0, 0)), "reflect")[15 + down :, 63 + right :][:16, :64]
    assert np.array_equal(view_of(image, Viewpoint(horizontal, vertical)), wide)


@pytest.mark.parametrize("zoom", [1.5, 2.0, 0.8])
def test_a_zoom_shows_the_middle_of_the_frame_enlarged(zoom):
    right, down = np.arange(64) - 31.5, np.arange(16) - 7.5
    planes = [100 + 2 * x + 0 * y for x, y in ((right, down[:, None]), (right / zoom, down[:, None]))]
    ramp, wanted = (np.repeat(plane[:, :, None], 3, axis=2) for plane in planes)
    found = view_of(ramp.astype(np.uint8), Viewpoint(zoom=zoom))
    inside = np.abs(right / zoom) < 31
    assert np.abs(found[:, inside] - wanted[:, inside]).max() <= 1


@pytest.mark.parametrize(
    ("option", "views", "told"),
    [
        ([-0.1, 0, 0.1], [(-0.1, 0, 1), (0, 0, 1), (0.1, 0, 1)], "-0.1+0+0.1"),
        ("[-0.1,0]", [(-0.1, 0, 1), (0, 0, 1)], "-0.1+0"),
        ({"horizontal": [0, 0.2], "vertical": [0.1]}, [(0, 0.1, 1), (0.2, 0.1, 1)], "0/0.1+0.2/0.1"),
        ("{vertical:[0.25],zoom:[1,1.1]}", [(0, 0.25, 1), (0, 0.25, 1.1)], "0/0.25+0/0.25 zoom 1.1"),
        ("auto", [(0, 0, 1)], "auto, by the first 1000 queries"),
        ({"auto": True, "queries": None}, [(0, 0, 1)], "auto, by all queries"),
    ],
    ids=str,
)
def test_an_option_is_a_list_of_shifts_a_mapping_or_auto(option, views, told):
    found = viewpoints(option)
    assert ([astuple(view) for view in found.all], found.protocol()) == (views, told)
    assert seen_from(journey(4, 2), found).protocol["views"] == told
    assert viewpoints(None) is None


@pytest.mark.parametrize(
    "option",
    [
        *([0.7], [float("nan")], [], [0.1, 0.1], ["a"], "sideways", 3),
        *({"zoom": [3]}, {"zoom": []}, {"tilt": [1]}, {"auto": True, "zoom": [1.1]}, {"auto": True, "queries": 0}),
    ],
    ids=str,
)
def test_what_is_no_viewpoint_is_refused_by_the_name_of_the_option(option):
    with pytest.raises(BadInput, match="views"):
        viewpoints(option)


@pytest.mark.parametrize("other", ["stream=true", "energy=true"])
def test_what_is_of_one_view_a_query_is_refused_beside_several(other):
    with pytest.raises(BadInput, match="views"):
        make_request(["views=[-0.1,0]", other])


def test_a_place_has_the_score_of_the_view_that_shows_it_best_whatever_the_batch():
    seen = Images.from_arrays(frames(6))
    method = SAD(height=16, width=64).fit(seen, np.arange(6))
    views = [Viewpoint(-0.25), AS_IT_IS, Viewpoint(0.25)]
    asked = Images.from_arrays([view_of(seen[i], view) for i, view in enumerate([*views, *views])])
    viewed = Viewed(method, views)
    scores = viewed.match(viewed.encode(asked))
    alone = [method.query(Images.from_arrays([view_of(image, view) for image in asked])) for view in views]
    assert np.array_equal(scores, np.max(alone, axis=0))
    assert np.array_equal(scores, np.concatenate([viewed.match(viewed.encode(asked[i : i + 1])) for i in range(6)]))


def evidence(offset, n=400, far=3.0, peak=5.0, noise=0.5, width=1.5):
    """Return z-scores (49, n) of shifts for frames whose camera looks `offset` (n,) steps elsewhere."""
    peaks = (peak - far) * np.exp(-(((STEPS[:, None] - offset) / width) ** 2))
    return far + peaks + noise * np.random.default_rng(1).standard_normal((49, n))


EITHER = np.where(np.random.default_rng(2).random(400) < 0.5, 8, -8)
SWINGING = np.random.default_rng(3).integers(4, 9, 400)
ODD = 0.8 * np.exp(-(((STEPS[:, None] + 5) / 8) ** 2))  # frames that look odd to a method: more evidence all around -5


@pytest.mark.parametrize(
    ("z", "steps"),
    [
        (evidence(np.zeros(400)), [0]),
        (evidence(np.full(400, -6)), [-6]),
        (evidence(np.full(400, 13)), [13]),
        (evidence(np.full(400, 13)) + ODD, [13]),
        (evidence(SWINGING), [4, 6, 8]),
        (evidence(EITHER), [-8, 8]),
        (ODD + evidence(np.full(400, 6), peak=3.0), [0]),
        (evidence(np.full(400, 6), peak=3.0), [0]),  # nothing but noise
        (evidence(np.zeros(400), noise=1.0, peak=3.2), [0]),
        (evidence(np.full(400, 6))[:, :12], [0]),  # too few queries
        (evidence(np.full(400, 30)) + 0.05 * np.abs(STEPS)[:, None], [0]),  # beyond the furthest shift
        (np.full((49, 50), 3.0), [0]),
    ],
    ids=(
        *("none", "left", "right", "beside odd frames", "swinging", "either way", "odd frames", "noise", "loud noise"),
        *("few", "out of range", "all alike"),
    ),
)
def test_an_offset_is_taken_if_a_test_says_so_to_one_side_to_both_or_swinging(z, steps):
    told = told_along(z)
    assert ([*told.steps], len(told.evidence["mean_evidence"])) == (steps, 49)
    assert (told.evidence["both_sides"] is None) == (told.gain == 0) == (steps == [0])
    assert len(told_along(z, most=1).steps) == 1


@pytest.mark.parametrize(
    ("camera", "wanted"),
    [
        (Viewpoint(), [(0, 0, 1)]),
        (Viewpoint(vertical=0.25), [(0, -0.25, 1)]),
        (Viewpoint(zoom=1.2), [(0, 0, 1.03**-6)]),
        (Viewpoint(-0.125, 0.25), [(0.125, -0.25, 1)]),  # where neither shift alone shows anything
    ],
    ids=str,
)
def test_an_offset_of_width_height_or_zoom_is_told_and_of_both_shifts_together(camera, wanted):
    blocks = np.random.default_rng(9).integers(0, 256, (200, 4, 16, 3), np.uint8)
    seen = [*blocks.repeat(8, axis=1).repeat(4, axis=2)]
    method = SAD(height=32, width=64).fit(Images.from_arrays(seen), np.arange(200))
    queries = Images.from_arrays([view_of(image, camera) for image in seen])
    found = find_offset(method, queries, Viewpoints(auto=True))
    shown = [(view.horizontal, round(32 * view.vertical) / 32, view.zoom) for view in found.views]  # of 32 rows
    assert shown == wanted
    assert set(found.evidence) == {"queries", "horizontal", "vertical", "zoom"}
    few = find_offset(method, queries[:199], Viewpoints(auto=True))
    assert (few.views, few.evidence) == ((AS_IT_IS,), {"queries": 199})


class Hub(Method):
    """Scores places at random, but for one that is like every query which looks 10 pixels to the right."""

    def fit(self, references, places):
        return self

    def encode(self, images):
        return np.array([image[0, 32, :2] for image in images], np.int64)  # the column that is shown there, the query

    def match(self, codes):
        scores = np.random.default_rng(4).normal(size=(200, 40))[codes[:, 1]]
        scores[codes[:, 0] == 42, 7] += 9
        return scores.astype(np.float32)


def test_a_place_that_is_like_all_queries_from_somewhere_tells_no_offset():
    queries = np.zeros((200, 8, 64, 3), np.uint8)
    queries[..., 0], queries[..., 1] = np.arange(64), np.arange(200)[:, None, None]
    found = find_offset(Hub(), Images.from_arrays([*queries]), Viewpoints(auto=True))
    assert found.views == (AS_IT_IS,)


@pytest.fixture(scope="module")
def moved():
    """A journey of 200 places whose queries look an eighth of the frame to the right."""
    dataset = journey(200, 200)
    seen = frames(200)
    queries = [view_of(image, Viewpoint(0.125)) for image in seen]
    return replace(dataset, references=Images.from_arrays(seen), queries=Images.from_arrays(queries))


def run_with(dataset, views):
    asked = Viewpoints(**views)
    experiment = asked_for(SAD(height=16, width=64), seen_from(dataset, asked), scores=True, views=views)
    return runner.run(experiment, "key")


def test_a_run_tells_its_offset_without_ground_truth_is_stored_with_it_and_finds_its_places(moved, store):
    run = run_with(moved, {"auto": True})
    assert run.viewpoints["views"] == [[-8 / 64, 0.0, 1.0]]
    assert np.mean(run.top_places[:, 0] == np.arange(200)) > 0.95
    assert run.protocol["views"] == "auto, by the first 1000 queries"
    assert "views" in {note.kind for note in run.notes}
    store.save(run)
    assert next(iter(store.runs())).viewpoints == run.viewpoints
    order = np.random.default_rng(0).permutation(200)
    other = run_with(replace(moved, positives=tuple(moved.positives[i] for i in order)), {"auto": True})
    assert all(other.viewpoints[name] == run.viewpoints[name] for name in ("views", "evidence"))
    assert np.array_equal(other.top_places, run.top_places)


def test_runs_from_other_viewpoints_stand_in_no_column_of_plain_ones(moved):
    plain = runner.run(asked_for(SAD(height=16, width=64), moved), "plain")
    seen = run_with(moved, {"horizontal": (0.0, 0.125)})
    row = Row(plain.method, plain.method)
    for views, wanted in ((None, plain), ([0.0, 0.125], seen)):
        column = ResolvedColumn(PlannedColumn("c", "C", ()), plain.config["dataset"], views=views)
        assert [run.key for group in groups([plain, seen], [], [column], [row]) for run in group.runs] == [wanted.key]

"""Queries from several viewpoints: frames move as the views say, and the best view counts."""

from dataclasses import astuple, replace

import numpy as np
import pytest
from little import journey
from little_runs import asked_for, execute

from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.methods.sad import SAD
from vprbench.runs.scorers import choose_scorer
from vprbench.runs.viewpoints import Viewpoint, Viewpoints, parse_viewpoints, record_viewpoints, render_view

pytestmark = pytest.mark.usefixtures("surroundings")

RANDOM = np.random.default_rng(0)


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
    assert np.array_equal(render_view(image, Viewpoint(horizontal, vertical)), wide)


@pytest.mark.parametrize("zoom", [1.5, 2.0, 0.8])
def test_a_zoom_shows_the_middle_of_the_frame_enlarged(zoom):
    right, down = np.arange(64) - 31.5, np.arange(16) - 7.5
    planes = [100 + 2 * x + 0 * y for x, y in ((right, down[:, None]), (right / zoom, down[:, None]))]
    ramp, wanted = (np.repeat(plane[:, :, None], 3, axis=2) for plane in planes)
    found = render_view(ramp.astype(np.uint8), Viewpoint(zoom=zoom))
    inside = np.abs(right / zoom) < 31
    assert np.abs(found[:, inside] - wanted[:, inside]).max() <= 1


@pytest.mark.parametrize(
    ("option", "views", "told"),
    [
        ([-0.1, 0], [(-0.1, 0, 1), (0, 0, 1)], "-0.1+0"),
        ({"horizontal": [0, 0.2], "vertical": [0.1]}, [(0, 0.1, 1), (0.2, 0.1, 1)], "0/0.1+0.2/0.1"),
        ({"vertical": [0.25], "zoom": [1, 1.1]}, [(0, 0.25, 1), (0, 0.25, 1.1)], "0/0.25+0/0.25 zoom 1.1"),
    ],
    ids=str,
)
def test_an_option_is_a_list_of_shifts_or_a_mapping(option, views, told):
    found = parse_viewpoints(option)
    assert ([astuple(view) for view in found.all], found.protocol()) == (views, told)
    assert record_viewpoints(journey(4, 2), found).protocol["views"] == told
    assert parse_viewpoints(None) is None


@pytest.mark.parametrize(
    "option",
    [
        *([0.7], [float("nan")], [], [0.1, 0.1], "sideways", {"zoom": [3]}, {"tilt": [1]}),
    ],
    ids=str,
)
def test_what_is_no_viewpoint_is_refused_by_the_name_of_the_option(option):
    with pytest.raises(BadInput, match="views"):
        parse_viewpoints(option)


def test_a_place_has_the_score_of_the_view_that_shows_it_best_whatever_the_batch():
    seen = Images.from_arrays(frames(6))
    method = SAD(height=16, width=64).fit(seen, np.arange(6))
    views = [Viewpoint(-0.25), Viewpoint(), Viewpoint(0.25)]
    asked = Images.from_arrays([render_view(seen[i], view) for i, view in enumerate([*views, *views])])
    viewed = choose_scorer(method, 6, 6, views=views)
    scores = viewed.match(viewed.encode(asked))
    alone = [method.query(Images.from_arrays([render_view(image, view) for image in asked])) for view in views]
    assert np.array_equal(scores, np.max(alone, axis=0))
    assert np.array_equal(scores, np.concatenate([viewed.match(viewed.encode(asked[i : i + 1])) for i in range(6)]))


@pytest.fixture(scope="module")
def moved():
    """A journey of 200 places whose queries look an eighth of the frame to the right."""
    dataset = journey(200, 200)
    seen = frames(200)
    queries = [render_view(image, Viewpoint(0.125)) for image in seen]
    return replace(dataset, references=Images.from_arrays(seen), queries=Images.from_arrays(queries))


def run_with(dataset, views):
    asked = Viewpoints(**views)
    experiment = asked_for(SAD(height=16, width=64), record_viewpoints(dataset, asked), scores=True, views=views)
    return execute(experiment)


def test_a_run_from_shifted_views_finds_the_places_of_a_shifted_camera_and_says_from_where_it_looked(moved, store):
    plain = execute(asked_for(SAD(height=16, width=64), moved))
    run = run_with(moved, {"horizontal": (-0.125, 0.0)})
    right = [np.mean(each.top_places[:, 0] == np.arange(200)) for each in (plain, run)]
    assert right[0] < 0.1 < 0.95 < right[1]
    assert (run.config["views"], run.protocol["views"]) == ({"horizontal": (-0.125, 0.0)}, "-0.125+0")
    store.save(run)
    assert [back.protocol["views"] for back in store.runs()] == ["-0.125+0"]

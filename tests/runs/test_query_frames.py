"""Corruptions and viewpoints do to query frames what their words say, and the protocol tells."""

import hashlib
from dataclasses import astuple, replace

import numpy as np
import pytest
from little import journey
from little_runs import asked_for, execute

from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.methods.sad import SAD
from vprbench.runs import corruption
from vprbench.runs.corruption import Corruption, corrupt_queries, parse_corruption, parse_corruptions
from vprbench.runs.identity import compute_fingerprint
from vprbench.runs.scorers import choose_scorer
from vprbench.runs.viewpoints import Viewpoint, Viewpoints, parse_viewpoints, record_viewpoints, render_view

pytestmark = pytest.mark.usefixtures("surroundings")

FRAMES = [f"frame {i}" for i in range(12)]
RANDOM = np.random.default_rng(0).integers(0, 256, (40, 60, 3), np.uint8)
GENERATOR = np.random.default_rng(0)


def under(name, image, frame="frame"):
    return corruption.corrupt_frame(image, parse_corruption(name), frame).astype(float)


def grey(level, height=120, width=200):
    return np.full((height, width, 3), level, np.uint8)


@pytest.mark.parametrize(("strength", "pixels", "degrees"), [(1, 1, 2), (2, 4, 5), (3, 8, 10)])
def test_a_shift_moves_pixels_left_or_right_and_a_rotation_turns_about_the_middle(strength, pixels, degrees):
    wide = np.pad(RANDOM, ((0, 0), (pixels, pixels), (0, 0)), "edge")  # the border is repeated
    left, right = wide[:, 2 * pixels :], wide[:, : -2 * pixels]
    shifted = [under(f"shift-{strength}", RANDOM, frame) for frame in FRAMES]
    assert {((one == left).all(), (one == right).all()) for one in shifted} == {(True, False), (False, True)}
    image = grey(0)
    image[58:62, 178:182] = 200  # its middle lies 80 pixels to the right of the frame's
    found = set()
    for frame in FRAMES:
        light = under(f"rotation-{strength}", image, frame)[:, :, 0]
        rows, columns = np.indices(light.shape)
        y, x = (float((axis * light).sum() / light.sum()) for axis in (rows - 59.5, columns - 99.5))
        assert np.hypot(x, y) == pytest.approx(80, abs=0.1)
        found.add(round(float(np.degrees(np.arctan2(y, x))), 0))
    assert found == {-degrees, degrees}


@pytest.mark.parametrize(("strength", "stops", "deviation", "noise"), [(1, 0.5, 2, 5), (2, 1, 4, 10), (3, 2, 8, 20)])
def test_brightness_multiplies_levels_blur_spreads_a_line_and_noise_has_its_deviation_and_no_mean(
    strength, stops, deviation, noise
):
    for level in (50, 180):  # ends at white
        levels = {float(under(f"brightness-{strength}", grey(level), frame).mean()) for frame in FRAMES}
        assert levels == {round(level / 2**stops), min(255, round(level * 2**stops))}
    image = grey(0)
    image[:, 92:108] = 255
    profile = under(f"blur-{strength}", image)[60, :, 0]
    variance = (profile * (np.arange(200) - 99.5) ** 2).sum() / profile.sum()
    assert variance == pytest.approx((16**2 - 1) / 12 + deviation**2, rel=0.02)  # a share of the 200 pixels
    one, other = (under(f"noise-{strength}", grey(128), frame) - 128 for frame in FRAMES[:2])
    assert one.std() == pytest.approx(noise, rel=0.02)
    assert abs(one.mean()) < 4 * noise / one.size**0.5 + 0.1
    assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.02
    assert abs(np.corrcoef(one[:, :, 0].ravel(), one[:, :, 1].ravel())[0, 1]) < 0.03


@pytest.mark.parametrize(("strength", "share", "factor"), [(1, 0.10, 2), (2, 0.25, 4), (3, 0.50, 8)])
def test_occlusion_hides_a_grey_rectangle_of_its_share_and_resolution_keeps_means_of_areas_and_nothing_finer(
    strength, share, factor
):
    corners = set()
    for frame in FRAMES:
        hidden = under(f"occlusion-{strength}", grey(7), frame)[:, :, 0]
        rows, columns = np.nonzero(hidden != 7)
        assert len(rows) / hidden.size == pytest.approx(share, rel=0.02)
        assert len(rows) == (np.ptp(rows) + 1) * (np.ptp(columns) + 1)
        assert {*hidden[rows, columns]} == {128.0}
        corners.add((int(rows.min()), int(columns.min())))
    assert len(corners) > 6
    blocks = RANDOM[:40, :56].reshape(40 // factor, factor, 56 // factor, factor, 3).mean((1, 3)).round()
    coarse = under(f"resolution-{strength}", np.ascontiguousarray(RANDOM[:, :56]))
    line = np.minimum(np.maximum((np.arange(56) + 0.5) / factor - 0.5, 0), 56 // factor - 1)
    first = np.interp(line, np.arange(56 // factor), blocks[0, :, 0])  # above the middles of the first blocks
    np.testing.assert_allclose(coarse[0, :, 0], first, atol=1.01)


@pytest.mark.parametrize("kind", corruption.KINDS)
def test_queries_are_corrupted_alike_in_any_order_and_view(kind):
    queries = corrupt_queries(journey(6, 4), f"{kind}-2").queries
    one_by_one = {i: queries[i] for i in (4, 1, 5, 0, 3, 2)}
    views = [queries, queries.unnamed(), [*queries[:3], *queries[3:]], queries.in_memory()]
    assert all(np.array_equal(image, one_by_one[i]) for view in views for i, image in enumerate(view))
    some = queries.unnamed()[np.array([5, 2])]
    assert all(np.array_equal(image, one_by_one[i]) for i, image in zip((5, 2), some, strict=True))


def test_each_process_draws_the_same_and_another_seed_or_frame_does_not():
    one = under("noise-2", RANDOM, "a")
    assert hashlib.sha256(one.astype(np.uint8).tobytes()).hexdigest()[:16] == "ba22f6247d3ebfc8"
    assert not np.array_equal(one, under("noise-2-7", RANDOM, "a"))
    assert not np.array_equal(one, under("noise-2", RANDOM, "b"))


def test_the_protocol_says_what_was_done_to_queries_and_nothing_else_is_touched():
    clean = journey(6, 4)
    spoilt = corrupt_queries(clean, "shift-2")
    assert corrupt_queries(clean, None) is clean
    assert spoilt.protocol.keys() - clean.protocol.keys() == {"corruption"}
    assert all(word in spoilt.protocol["corruption"] for word in ("shift-2", "4 px", "left or right", "seed 0"))
    assert spoilt.references is clean.references
    assert (spoilt.positives, spoilt.queries.names) == (clean.positives, clean.queries.names)
    kinds = (None, "shift-2", "shift-1", "shift-2-1")
    assert len({compute_fingerprint(corrupt_queries(clean, kind)) for kind in kinds}) == 4
    assert compute_fingerprint(corrupt_queries(journey(6, 4), "shift-2")) == compute_fingerprint(spoilt)


def test_names_ask_for_kinds_and_strengths_and_all_of_them():
    assert len(parse_corruptions(["all"])) == 21
    assert parse_corruptions(["blur-2", "shift"]) == (*parse_corruptions(["shift"]), Corruption("blur", 2))
    assert parse_corruptions(["shift"]) == tuple(Corruption("shift", n) for n in (1, 2, 3))
    assert [parse_corruption(name).name for name in ("noise-2", "noise-2-7")] == ["noise-2", "noise-2-7"]
    for wrong, told in (("shfit-1", "shift"), ("shift-4", "1 to 3")):
        with pytest.raises(BadInput, match=told):
            parse_corruption(wrong)


# Queries from several viewpoints: the best view counts.


def drawn(count):
    """Return random frames of 16 x 64 pixels, in blocks of 4 x 4."""
    return [GENERATOR.integers(0, 256, (4, 16, 3), np.uint8).repeat(4, axis=0).repeat(4, axis=1) for _ in range(count)]


@pytest.mark.parametrize(
    ("horizontal", "vertical"), [(0.25, 0.0), (-0.125, 0.0), (0.0, 0.25), (-0.25, -0.5), (0.0, 0.0)]
)
def test_a_view_looks_to_the_right_and_down_by_shares_of_the_frame_and_borders_are_reflected(horizontal, vertical):
    image = drawn(1)[0]
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


def test_an_option_is_a_list_of_shifts_or_a_mapping():
    for option, views, told in (
        ([-0.1, 0], [(-0.1, 0, 1), (0, 0, 1)], "-0.1+0"),
        ({"horizontal": [0, 0.2], "vertical": [0.1]}, [(0, 0.1, 1), (0.2, 0.1, 1)], "0/0.1+0.2/0.1"),
        ({"vertical": [0.25], "zoom": [1, 1.1]}, [(0, 0.25, 1), (0, 0.25, 1.1)], "0/0.25+0/0.25 zoom 1.1"),
    ):
        found = parse_viewpoints(option)
        assert ([astuple(view) for view in found.all], found.protocol()) == (views, told)
        assert record_viewpoints(journey(4, 2), found).protocol["views"] == told
    assert parse_viewpoints(None) is None


def test_what_is_no_viewpoint_is_refused_by_the_name_of_the_option():
    for option in ([0.7], [float("nan")], [], [0.1, 0.1], "sideways", {"zoom": [3]}, {"tilt": [1]}):
        with pytest.raises(BadInput, match="views"):
            parse_viewpoints(option)


def test_a_place_has_the_score_of_the_view_that_shows_it_best_whatever_the_batch():
    seen = Images.from_arrays(drawn(6))
    method = SAD(height=16, width=64).fit(seen, np.arange(6))
    views = [Viewpoint(-0.25), Viewpoint(), Viewpoint(0.25)]
    asked = Images.from_arrays([render_view(seen[i], view) for i, view in enumerate([*views, *views])])
    viewed = choose_scorer(method, 6, 6, views=views)
    scores = viewed.match(viewed.encode(asked))
    alone = [method.query(Images.from_arrays([render_view(image, view) for image in asked])) for view in views]
    assert np.array_equal(scores, np.max(alone, axis=0))
    assert np.array_equal(scores, np.concatenate([viewed.match(viewed.encode(asked[i : i + 1])) for i in range(6)]))


def test_a_run_from_shifted_views_finds_the_places_of_a_shifted_camera_and_says_from_where_it_looked(store):
    seen, views = drawn(200), {"horizontal": (-0.125, 0.0)}
    queries = [render_view(image, Viewpoint(0.125)) for image in seen]  # which look an eighth of the frame to the right
    moved = replace(journey(200, 200), references=Images.from_arrays(seen), queries=Images.from_arrays(queries))
    plain = execute(asked_for(SAD(height=16, width=64), moved))
    viewed = record_viewpoints(moved, Viewpoints(**views))
    run = execute(asked_for(SAD(height=16, width=64), viewed, scores=True, views=views))
    right = [np.mean(each.top_places[:, 0] == np.arange(200)) for each in (plain, run)]
    assert right[0] < 0.1 < 0.95 < right[1]
    assert (run.config["views"], run.protocol["views"]) == (views, "-0.125+0")
    store.save(run)
    assert [back.protocol["views"] for back in store.runs()] == ["-0.125+0"]

"""Ground truth by position: the radius is included, zones never mix, degrees become metres."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from image_folders import answer

from vprbench.datasets.readers.positions import by_names, by_radius, earth_centred, position_in
from vprbench.errors import BadInput

EASTING, NORTHING = 54_325_696, 417_890_670  # centimetres, a corner of San Francisco
AROUND = st.tuples(st.integers(-6000, 6000), st.integers(-6000, 6000))
EDGE = st.sampled_from([(700, 2400), (-1500, 2000), (2500, 0), (2400, 701), (2401, 700), (0, 2501)])  # 7-24-25


def named(centimetres, grid="@10@S"):
    east, north = centimetres
    return Path(f"@{(EASTING + east) / 100:.2f}@{(NORTHING + north) / 100:.2f}{grid}@.jpg")


@settings(derandomize=True, deadline=None, database=None, max_examples=60)
@given(st.lists(st.tuples(AROUND | EDGE, st.integers(31, 32)), min_size=1, max_size=20), st.integers(31, 33))
@example([((700, 2400), 31), ((701, 2400), 31), ((0, 0), 32)], 31)
def test_right_is_what_whole_centimetres_say_is_within_25_metres_the_edge_included_and_in_the_zone(references, zone):
    files = [named(at, f"@{own}@V") for at, own in references]
    truth = by_names(files, [named((0, 0), f"@{zone}@V")], 25.0, "apart")
    near = [i for i, ((x, y), own) in enumerate(references) if x * x + y * y <= 2500**2 and own == zone]
    assert truth.positives[0].tolist() == near
    assert truth.places.tolist() == [*range(len(references))]


@pytest.mark.parametrize(
    ("first", "second", "zones", "told"),
    [
        ("@10@S", "@10@t", "error", ""),
        ("@10@S", "@33@U", "error", "10 north.*33 north"),
        ("@23@M", "@23@N", "error", "23 south.*23 north"),
        ("@10@S", "", "error", ""),
        ("@10@S", "@61@S", "error", ""),
        ("@10@S", "@60@S", "error", "10 north.*60 north"),
        ("@10@S", "", "apart", "10 north.*no zone"),
    ],
)
def test_metres_of_several_zones_or_sides_of_the_equator_do_not_compare(first, second, zones, told):
    names = [named((0, 0), first)], [named((0, 0), second)]
    if told:
        assert re.search(told, answer(by_names, *names, 25.0, zones))
    else:
        assert len(by_names(*names, 25.0, zones).positives[0]) == 1


def test_a_position_may_be_negative_and_zone_and_letter_may_be_left_out():
    assert position_in(Path("a@b/@-0012.50@0000003.25@@@@@.jpg")) == (-12.5, 3.25, "")
    assert "a@b/1.jpg" in answer(position_in, Path("a@b/1.jpg"))


@pytest.mark.parametrize("radius", [0, float("nan"), 1.01e8])
def test_a_radius_that_is_no_length_is_refused(radius):
    with pytest.raises(BadInput, match=r"dataset\.radius_metres="):
        by_radius(np.zeros((1, 2)), np.zeros((1, 2)), radius)


# Lengths of one degree on the WGS 84 ellipsoid as the tables of the US National Geospatial-Intelligence Agency have
# them (whole metres); a thousandth of a degree, so that chord and arc do not differ.
@pytest.mark.parametrize(
    ("latitude", "north", "east"), [(0, 110.574, 111.320), (60, 111.412, 55.800), (-30, 110.852, 96.486)]
)
def test_a_thousandth_of_a_degree_is_as_long_as_the_tables_say(latitude, north, east):
    points = earth_centred(np.array([latitude, latitude + 1e-3, latitude]), np.array([10.0, 10.0, 10.001]))
    lengths = np.linalg.norm(points[1:] - points[0], axis=1)
    assert lengths == pytest.approx([north, east], rel=1e-4)

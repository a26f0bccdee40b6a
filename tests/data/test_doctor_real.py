"""The doctor on real frames: Nordland, the Corridor of VPR-Bench, and a few of Gardens Point."""

import re

import numpy as np
import pytest
from checkout import SHARED
from doctored import notes, wrong

from vprbench.api.dataset import Dataset, FrameFolder
from vprbench.api.images import Images
from vprbench.data.doctor import examine

DATA = SHARED / "data"
NORDLAND = DATA / "nordland_64x32"

pytestmark = pytest.mark.real_frames


def ride(references, queries, tolerance=0, folders=()):
    """Return what is found where query i shows place i, give or take the tolerance."""
    n = len(references)
    return examine(
        Dataset(
            name="ride",
            references=Images.from_files(references),
            places=np.arange(n),
            queries=Images.from_files(queries),
            positives=tuple(np.arange(max(0, i - tolerance), min(n, i + tolerance + 1)) for i in range(len(queries))),
            protocol={"references": ["winter"], "query": "summer", "tolerance_places": tolerance},
            folders=folders,
        )
    )


def clean(season):
    """Return the frames of a season that stand in the published list, in order."""
    return [NORDLAND / season / name for name in (NORDLAND / "frames_clean_qvpr.txt").read_text().split()]


def test_nordland_is_aligned_as_a_whole_and_in_part_and_its_tunnels_are_among_what_is_not_used():
    winter, summer = clean("winter"), clean("summer")
    names = tuple(path.name for path in winter)
    found = ride(winter, summer, folders=tuple(FrameFolder(NORDLAND / s, names) for s in ("winter", "summer")))
    assert not wrong(found)
    assert notes(found, "alignment")[0].startswith("summer and winter are aligned")
    for text in notes(found, "unused"):
        assert re.findall(r"[\d,]+\d", text)[:3] == ["3,576", "2,761", "815"]
        black = int(text.partition("of these ")[2].split()[0])
        assert 150 <= black <= 250  # "about 200" says who published the frames
    for first in range(0, 2700, 900):
        assert not wrong(ride(winter[first : first + 60], summer[first : first + 60]))


def test_a_season_of_nordland_shifted_by_3_or_without_a_frame_is_found_by_its_frames():
    winter, summer = clean("winter"), clean("summer")
    for one, other, told in ((winter[3:400], summer[:397], "earlier"), (winter[:397], summer[3:400], "later")):
        alignment, names = wrong(ride(one, other))
        assert (names[:2], alignment[:2]) == (("warning", "names"), ("error", "alignment"))
        assert f"all of it shows what winter shows 3 places {told}" in alignment[2]
    queries = summer[:400] + summer[401:600]
    alignment, names = wrong(ride(winter[:600], queries))
    found = re.search(r": about (\S+) to (\S+) \(.* queries\) show what winter shows 1 place later", alignment[2])
    assert found is not None
    listed = [path.name for path in queries]
    assert found[2] == listed[-1]
    assert abs(listed.index(found[1]) - 400) <= 5
    assert names[2].endswith(f"the first is {listed[400]}, matched with {winter[400].name}")


def test_the_corridor_is_aligned_and_ten_frames_of_gardens_point_are_healthy_but_too_few_to_compare():
    found = ride(*(sorted((DATA / "corridor" / part).glob("*.jpg")) for part in ("ref", "query")), tolerance=2)
    assert not wrong(found)
    assert notes(found, "alignment")[0].startswith("summer and winter are aligned")
    folder = DATA / "gardens_point_sample10"
    found = ride(*(sorted((folder / part).glob("*.jpg")) for part in ("day_left", "night_right")), tolerance=2)
    assert not wrong(found)
    assert notes(found, "alignment") == ["not checked: a traverse has 10 frames to compare, and 20 are needed"]
    assert notes(found, "size") == ["traverses differ in the size of their frames: winter 960x540, summer 640x360"]
    assert notes(found, "colour") == ["some frames are grey, others in colour: winter in colour, summer grey"]

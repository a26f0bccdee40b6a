"""The doctor on real frames: Nordland, the Corridor of VPR-Bench, and a few of Gardens Point."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from checkout import SHARED
from doctored import notes, wrong

from vprbench.api.dataset import Dataset, FrameFolder
from vprbench.api.images import Images
from vprbench.data.doctor import Finding, examine

DATA = SHARED / "data"

pytestmark = pytest.mark.skipif(not DATA.is_dir(), reason=f"{DATA} holds the real frames and is not there")


def ride(
    references: list[Path], queries: list[Path], tolerance: int = 0, folders: tuple[FrameFolder, ...] = ()
) -> tuple[Finding, ...]:
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


def clean(season: str) -> list[Path]:
    """Return the frames of a season that stand in the published list, in order."""
    folder = DATA / "nordland_64x32"
    return [folder / season / name for name in (folder / "frames_clean_qvpr.txt").read_text().split()]


def test_nordland_is_aligned_and_its_tunnels_are_among_what_is_not_used() -> None:
    names = tuple(path.name for path in clean("winter"))
    folders = tuple(FrameFolder(DATA / "nordland_64x32" / season, names) for season in ("winter", "summer"))
    found = ride(clean("winter"), clean("summer"), folders=folders)
    assert not wrong(found)
    (aligned,) = notes(found, "alignment")
    assert aligned.startswith("summer and winter are aligned")
    for season, text in zip(("winter", "summer"), notes(found, "unused"), strict=True):
        assert text.startswith(
            f"{season} holds 3,576 images, of which the dataset uses 2,761 and leaves 815 out; of these "
        )
        black = int(text.partition("of these ")[2].split()[0])
        assert 150 <= black <= 250  # "about 200" says who published the frames


@pytest.mark.parametrize(
    ("references", "queries", "told"),
    [
        (slice(3, 400), slice(0, 397), "3 places earlier"),
        (slice(0, 397), slice(3, 400), "3 places later"),
    ],
    ids=["winter", "summer"],
)
def test_a_season_of_nordland_shifted_by_3_is_found_by_its_frames(references: slice, queries: slice, told: str) -> None:
    alignment, names = wrong(ride(clean("winter")[references], clean("summer")[queries]))
    assert names[:2] == ("warning", "names")
    assert alignment[:2] == ("error", "alignment")
    assert f"all of it shows what winter shows {told}" in alignment[2]


def test_a_frame_of_nordland_that_is_missing_is_found_within_a_few_places() -> None:
    queries = clean("summer")[:600]
    del queries[400]
    alignment, names = wrong(ride(clean("winter")[:600], queries))
    found = re.search(r": about (\S+) to (\S+) \(.* queries\) show what winter shows 1 place later", alignment[2])
    assert found is not None
    listed = [path.name for path in queries]
    assert found[2] == listed[-1]
    assert abs(listed.index(found[1]) - 400) <= 5
    assert names[2].endswith(f"the first is {listed[400]}, matched with {clean('winter')[400].name}")


@pytest.mark.parametrize("first", range(0, 2700, 300))
def test_no_stretch_of_nordland_is_called_shifted(first: int) -> None:
    found = ride(clean("winter")[first : first + 60], clean("summer")[first : first + 60])
    assert not wrong(found)


def test_the_corridor_is_aligned() -> None:
    references, queries = (sorted((DATA / "corridor" / part).glob("*.jpg")) for part in ("ref", "query"))
    found = ride(references, queries, tolerance=2)
    assert not wrong(found)
    assert notes(found, "alignment")[0].startswith("summer and winter are aligned")


def test_ten_frames_of_gardens_point_by_day_and_night_are_healthy_but_too_few_to_compare() -> None:
    folder = DATA / "gardens_point_sample10"
    references, queries = (sorted((folder / part).glob("*.jpg")) for part in ("day_left", "night_right"))
    found = ride(references, queries, tolerance=2)
    assert not wrong(found)
    assert notes(found, "alignment") == ["not checked: a traverse has 10 frames to compare, and 20 are needed"]
    assert notes(found, "size") == ["traverses differ in the size of their frames: winter 960x540, summer 640x360"]
    assert notes(found, "colour") == ["some frames are grey, others in colour: winter in colour, summer grey"]

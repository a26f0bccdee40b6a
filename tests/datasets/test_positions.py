"""Positions that are none, degrees in place of metres, and places by their numbers, for every reader that has them."""

from pathlib import Path

import numpy as np
import pytest
from image_folders import answer, fill, listed, numbered, reds, rights

from vprbench.datasets.folders import folders
from vprbench.datasets.image_list import image_list
from vprbench.datasets.utm_folders import utm_folders

N = 40
DRIVE = [(545000 + 30 * k, 4184000) for k in range(N)]
NOTHING = (float("nan"), float("nan"))


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def named(positions):
    return [f"@{east}@{north}@10@S@@@{number:02}@.jpg" for number, (east, north) in enumerate(positions)]


def match_names(references, queries, **options):
    fill(Path("database"), named(references))
    fill(Path("queries"), named(queries))
    return utm_folders(root=".", **options)


def by_table(references, queries, columns="east,north", **options):
    def table(rows):
        cells = [",".join(map(str, row)) for row in rows]
        return "\n".join([f"image,{columns}", *(f"{number}.jpg,{row}" for number, row in enumerate(cells))])

    return listed(table(references), table(queries), **options)


def by_degrees(references, queries, **options):
    """Return the dataset of the drive in degrees, 33 m for 30 m; what is no position stays as it is."""
    parts = [
        [(-27.5 + 1e-5 * (at[0] - DRIVE[0][0]), 153.02) if at[0] >= DRIVE[0][0] else at for at in positions]
        for positions in (references, queries)
    ]
    return by_table(*parts, "lat,lon", **options)


def by_arrays(references, queries, turned=False, **options):
    fill(Path("a"), numbered(len(references)))
    fill(Path("b"), numbered(len(queries)))
    mapped, asked = (np.array(positions, float) for positions in (references, queries))
    np.savez("truth.npz", utmDb=mapped.T if turned else mapped, utmQ=asked, posDistThr=10.0)
    return folders(references=["a"], queries="b", ground_truth="truth.npz", **options)


READERS = [match_names, by_table, by_degrees, by_arrays]


def but(numbers, at, drive=DRIVE):
    """Return a drive in which some images have another position."""
    return [at if number in numbers else position for number, position in enumerate(drive)]


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    ("at", "mapped", "asked"),
    [
        pytest.param((0, 0), {3, 4, 30}, {5, 6}, id="zeros"),
        pytest.param((-1, -1), {3}, {3}, id="minus ones"),
        pytest.param(NOTHING, {0, 20}, {1}, id="no numbers"),
        pytest.param(DRIVE[10], {*range(11, 26)}, set(), id="a fix that stands still in the map"),
        pytest.param(DRIVE[0], set(), {*range(1, 20)}, id="a fix that comes late"),
    ],
)
def test_images_without_a_position_are_refused_or_left_out_and_counted(reader, at, mapped, asked):
    drives = but(mapped, at), but(asked, at)
    assert "dataset.without_position=drop" in answer(reader, *drives)
    counts = {"references_without_position": len(mapped), "queries_without_position": len(asked)}
    left = reader(*drives, without_position="drop", unmatched="drop")
    assert {**left.protocol, **counts, "without_position": "drop"} == left.protocol
    shown = reds(left.references)
    assert sorted(shown) == [number for number in range(N) if number not in mapped]
    right = [[shown[place] for place in places] for places in rights(left)]
    assert dict(zip(reds(left.queries), right, strict=True)) == {k: [k] for k in range(N) if k not in mapped | asked}
    if at is not NOTHING:
        kept = reader(*drives, without_position="keep", unmatched="keep")
        assert (len(kept.references), len(kept.queries)) == (N, N)
        assert {**kept.protocol, **counts, "without_position": "keep"} == kept.protocol


FAR = [(east + 5000 * (k >= 20), north) for k, (east, north) in enumerate(DRIVE)]  # 5 km from image 19 to image 20


@pytest.mark.parametrize(
    ("second", "drive", "seen_by"),
    [("one", FAR, "positions"), ("two", DRIVE, "folders"), ("two", FAR, "folders and positions"), ("one", DRIVE, None)],
)
def test_drives_are_counted_among_the_images_that_have_a_position(second, drive, seen_by):
    fill(Path(), names := [f"{second if k >= 20 else 'one'}/{k:02}.jpg" for k in range(N)])
    for file, nowhere in (("map.csv", 3), ("asked.csv", 5)):
        rows = zip(names, but({nowhere}, (0, 0), drive), strict=True)
        Path(file).write_text("\n".join(["image,east,north", *(f"{name},{at[0]},{at[1]}" for name, at in rows)]))
    options = {"without_position": "drop", "unmatched": "drop"}  # query 3 has no right reference
    made = image_list(references=["map.csv"], queries="asked.csv", **options)
    assert made.protocol.get("breaks") == seen_by
    assert made.place_breaks.tolist() == [3, *[19] * (seen_by is not None)]
    assert made.query_breaks.tolist() == [3, 4, *[18] * (seen_by is not None)]


@pytest.mark.parametrize(
    "drive",
    [
        pytest.param([(30 * k, k % 3) for k in range(N)], id="a grid that begins at 0, 0"),
        pytest.param([(30 * k, 30 * k) for k in range(N)], id="as far north as east"),
        pytest.param([*DRIVE[:10], *[DRIVE[10]] * 20, *DRIVE[11:21]], id="a camera that waits and goes on"),
        pytest.param([DRIVE[k // 10] for k in range(N)], id="a fix for every tenth image"),
        pytest.param([DRIVE[30 * (k // 20)] for k in range(N)], id="panoramas of twenty views"),
        pytest.param([(90 * np.cos(k / 8), 90 * np.sin(k / 8)) for k in range(N)], id="metres within 180"),
    ],
)
def test_strange_positions_of_real_drives_are_taken(drive):
    made = by_table(drive, drive)
    assert "without_position" not in made.protocol
    assert all(query in right for query, right in enumerate(rights(made)))


BRISBANE = [(-27.5 + 0.0003 * k, 153.02 + 0.0001 * k) for k in range(N)]


@pytest.mark.parametrize(
    ("reader", "drive", "told"),
    [
        *((reader, BRISBANE, "degrees") for reader in READERS if reader is not by_degrees),
        (match_names, but({3, 4}, (0, 0), BRISBANE), "degrees"),
        (by_table, BRISBANE[:3], "degrees"),
        (by_table, [(153.02, -27.5)] * N, "degrees"),
        (by_table, [(-27.5 + 40 * (k % 2), 153.02 + 1e-4 * k) for k in range(N)], "degrees"),  # two cities
        (by_table, [(k % 5, k // 5) for k in range(N)], "radius below 8.06"),  # 4 by 7 metres
    ],
)
def test_degrees_in_place_of_metres_and_extents_below_the_radius_are_refused(reader, drive, told):
    assert told in answer(reader, drive, drive)


@pytest.mark.parametrize("latitudes", [[-27], [-27, -28], [-27.5, -27.4], [-27.51, -27.52]])
def test_degrees_that_are_rounded_to_more_than_the_radius_are_refused(latitudes):
    drive = [(latitudes[k % len(latitudes)], 153) for k in range(N)]
    assert "decimals" in answer(by_table, drive, drive, "lat,lon")


@pytest.mark.parametrize("turned", [False, True])
def test_positions_in_a_file_of_truth_are_rows_or_columns_and_another_radius_than_its_own_is_noted(turned):
    made = by_arrays(DRIVE, DRIVE[:20], turned, radius_metres=30)
    assert rights(made) == [[k - 1, k, k + 1] if k else [0, 1] for k in range(20)]
    assert (made.protocol["ground_truth"], made.protocol["radius_metres"]) == ("truth.npz", 30)
    assert "10 m" in made.notes[0]
    assert not by_arrays(DRIVE, DRIVE, turned, radius_metres=10).notes
    fill(Path("c"), numbered(39))
    assert "utmQ in truth.npz" in answer(folders, references=["a"], queries="c", ground_truth="truth.npz")


@pytest.mark.parametrize(
    ("references", "queries", "options", "right", "numbers"),
    [
        ([0, 8, 16, 24], [8, 12], {"tolerance": 8}, [[0, 1, 2], [1, 2]], [0, 8, 16, 24]),
        ([5, 3, 4], [5, 3], {"tolerance": 1}, [[1, 2], [0, 1]], [3, 4, 5]),
        ([-7, -3, -9], [-20], {"tolerance": 12}, [[0]], [-9, -7, -3]),
        ([0, 1, 2], [4], {"tolerance": 2}, [[2]], None),  # beyond the map
        ([0, 1, 2], [1], {"tolerance": 1}, [[0, 1, 2]], None),
        (["b", 8, 9], [8], {"tolerance": 1}, [[0, 1, 2]], None),
    ],
)
def test_places_that_are_whole_numbers_count_as_themselves(references, queries, options, right, numbers):
    made = by_table(*([(place,) for place in drive] for drive in (references, queries)), "place", **options)
    assert rights(made) == right
    assert (None if made.place_numbers is None else made.place_numbers.tolist()) == numbers
    assert not len(made.place_breaks)

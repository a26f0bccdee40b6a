"""What each dataset of files makes of names, orders, columns, radii and queries without a right place."""

import csv
from pathlib import Path

import numpy as np
import pytest
import yaml
from image_folders import REAL, fill, lists, needs_real_frames, numbered, reds, rights, used
from mat_cells import cells
from scipy.io import savemat

from vprbench.datasets.dbstruct import dbstruct
from vprbench.datasets.image_list import image_list
from vprbench.datasets.utm_folders import utm_folders
from vprbench.datasets.vpr_bench import in_range, vpr_bench
from vprbench.datasets.vpr_tutorial import gardens_point, with_matrix
from vprbench.errors import BadInput
from vprbench.plugins import registry


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def configured(name, **changes):
    config = yaml.safe_load(registry.entries("dataset")[name].path.read_text(encoding="utf-8"))
    return registry.make_dataset({**config, **changes})


def at(*positions):
    return [f"@{east}@{north}@10@S@@@{i}@.jpg" for i, (east, north) in enumerate(positions)]


# Lists in CSV files


def listed(references, queries, **options):
    """Return the dataset of two tables beside the images 0.jpg to 9.jpg."""
    fill(Path(), numbered(10))
    Path("map.csv").write_text(references, encoding="utf-8")
    Path("asked.csv").write_text(queries, encoding="utf-8")
    return image_list(references=["map.csv"], queries="asked.csv", **options)


@pytest.mark.parametrize(
    ("references", "queries", "options", "right"),
    [
        ("Image name,index\n0.jpg,0\n1.jpg,1\n", "Image name,index\n5.jpg,1\n6.jpg,0\n", {}, [[1], [0]]),  # VPRTempo's
        ("\ufeffImage, Place\n0.jpg, a\n", "IMAGE,PLACE\n1.jpg,a \n", {}, [[0]]),
        ("image,place\n3.jpg,0\n3.jpg,1\n", "image,place\n3.jpg,1\n", {}, [[1]]),
        # the first kind of ground truth that both tables have
        ("image,lat,lon,east,north\n0.jpg,1,2,0,0\n", "image,east,north,place\n1.jpg,25,0,a\n", {}, [[0]]),
        ("image,lat,lon,east,north\n0.jpg,1,2,0,0\n", "image,lat,lon,place\n1.jpg,1,2,a\n", {}, [[0]]),
        ("image,east,north\n0.jpg,3,4\n1.jpg,4,4\n", "image,east,north\n0.jpg,0,0\n", {"radius_metres": 5}, [[0]]),
    ],
)
def test_columns_of_a_list_are_found_by_their_names(references, queries, options, right):
    assert rights(listed(references, queries, **options)) == right
    fill(Path("frames"), numbered(7))
    for image in Path().glob("*.jpg"):  # paths may start from another folder
        image.unlink()
    assert rights(image_list(references=["map.csv"], queries="asked.csv", root="frames", **options)) == right


def test_queries_without_a_right_place_are_dropped_on_request_and_no_others():
    found = listed("image,place\n0.jpg,a\n", "image,place\n0.jpg,x\n1.jpg,a\n", unmatched="drop")
    assert (rights(found), found.queries.names) == ([[0]], ("1.jpg",))


# A thousandth of a degree near Brisbane (27.5 degrees south): 110.80 m north, 98.83 m east (tables of WGS 84).
@pytest.mark.parametrize(("moved", "metres"), [("-27.499,153.0", 110.80), ("-27.5,153.001", 98.83)])
def test_positions_in_degrees_are_right_within_the_radius(moved, metres):
    references, query = "image,lat,lon\n0.jpg,-27.5,153.0\n", f"image,lat,lon\n0.jpg,{moved}\n"
    near = listed(references, query, radius_metres=metres + 0.05)
    assert (rights(near), near.protocol["ground_truth"]) == ([[0]], "lat_lon")
    assert rights(listed(references, query, radius_metres=metres - 0.05, unmatched="keep")) == [[]]


# Folders whose names hold positions


@pytest.mark.parametrize("way", ["images/val", "val", "."])
def test_both_folders_are_found_in_each_of_the_three_layouts(way):
    fill(Path(way) / "database", at((0, 0)))
    fill(Path(way) / "queries", at((1, 1)))
    dataset = utm_folders(root=".", split="val")
    assert (rights(dataset), dataset.protocol["split"]) == ([[0]], None if way == "." else "val")
    if way == "val":  # the split comes before folders of the root
        fill(Path("database"), at((0, 0), (1, 1)))
        fill(Path("queries"), at((0, 0)))
        assert len(utm_folders(root=".", split="val").references) == 1


def test_images_come_in_the_order_of_their_whole_paths_and_queries_without_a_right_place_are_left_out_where_asked():
    fill(Path("me@7@8/gallery"), ["b/@1@0@.jpg", "a/@9@0@.jpg", "@5@0@.jpg", "a/@10@0@.jpg"])
    fill(Path("me@7@8/queries"), at((-900, 0), (3, 4), (30, 0)))
    dataset = utm_folders(root="me@7@8", database="gallery", radius_metres=5, unmatched="drop")
    assert dataset.references.names == ("@5@0@.jpg", "@10@0@.jpg", "@9@0@.jpg", "@1@0@.jpg")
    assert (reds(dataset.queries), rights(dataset), len(used(dataset))) == ([1], [[0, 3]], 7)
    assert "2 of 3" in dataset.notes[0]


def test_a_list_beside_the_folder_says_which_images_and_in_which_order(monkeypatch):
    names = at((0, 0), (20, 0), (40, 0))
    fill(Path("town/database"), names)
    fill(Path("town/queries"), at((0, 5)))
    Path("town/database_images_paths.txt").write_text(f"\ufeff{names[2]}\n\n{names[0]}\n", "utf-8")
    monkeypatch.setenv("VPRBENCH_DATA", ".")
    dataset = utm_folders(name="town")  # which lies where downloads lie
    assert (reds(dataset.references), rights(dataset)) == ([2, 0], [[1]])
    assert dataset.protocol["lists"] == ["database_images_paths.txt"]


# dbStruct


def test_fields_of_dbstruct_are_taken_by_position_padded_names_are_read_and_suffixes_replaced():
    fill(Path(), ["a.png", "b.png", "q1.jpg", "q2.jpg"])
    fields = ["test", cells(["a.jpg", "b.jpg"]), np.array([[0, 30], [0, 0]]), np.array(["q1.jpg    ", "q2.jpg    "])]
    savemat("set.mat", {"dbStruct": dict(zip("abcde", [*fields, np.array([[25.0, 56.0], [0, 0]])], strict=True))})
    dataset = dbstruct(root=".", mat="set.mat", database_suffix=".png")
    assert (dataset.references.names, dataset.queries.names) == (("a.png", "b.png"), ("q1.jpg", "q2.jpg"))
    assert rights(dataset) == [[0, 1], []]


# VPR-Bench


def test_the_pickle_comes_before_a_csv_that_says_the_same_and_queries_without_references_are_noted():
    for part in ("query", "ref"):
        fill(Path(part), numbered(11))
    np.save("ground_truth_new.npy", lists(*([query, 0] for query in range(11))), allow_pickle=True)
    rows = "".join(f"{query},{query} {query - 1}\n" for query in range(1, 11))
    Path("ground_truth.csv").write_text(f"query,matching_refs\n0,\n{rows}")
    assert rights(vpr_bench(root="."))[10] == [0, 10]
    Path("ground_truth_new.npy").unlink()
    from_csv = vpr_bench(root=".")
    assert rights(from_csv) == [[], *([query - 1, query] for query in range(1, 11))]
    assert from_csv.protocol["ground_truth"] == "ground_truth.csv"
    assert "1 of 11 queries have no right reference in ground_truth.csv" in from_csv.notes[0]


def test_clipped_numbers_are_left_out_and_counted():
    for part in ("query", "ref"):
        fill(Path(part), numbered(3))
    np.save("ground_truth_new.npy", lists([-1, 0, 1], [1, 0, 1], [1, 2, 3]), allow_pickle=True)
    dataset = vpr_bench(root=".", out_of_range="clip")
    assert rights(dataset) == [[0, 1], [0, 1], [1, 2]]
    assert (dataset.protocol["out_of_range"], dataset.protocol["out_of_range_queries"]) == ("clip", 2)
    assert "in 2 of 3 rows (first: query 0)" in dataset.notes[0]


def test_rows_are_taken_by_their_query_and_never_by_their_place():
    rows = [(1, [1]), (7, [0]), (0, [0]), (2, [5, 6])]
    assert in_range("it", rows, 3, 6, "clip") == ([[0], [1], [5]], [7, 2])
    with pytest.raises(BadInput, match="for query 2, "):
        in_range("it", [row for row in rows if row[0] != 7], 3, 6, "error")
    with pytest.raises(BadInput, match="two rows for query 0"):
        in_range("it", [*rows, (0, [1])], 3, 6, "clip")


@needs_real_frames
def test_the_matches_that_vpr_bench_stored_of_corridor_give_the_recalls_that_it_published():
    corridor = configured("corridor")
    assert rights(corridor) == [[n for n in range(query - 2, query + 3) if 0 <= n < 111] for query in range(111)]
    assert corridor.queries.names[7] == corridor.references.names[7] == "0000007.jpg"
    with (REAL / "corridor" / "vprbench_r1.csv").open(newline="") as file:
        published = {row["technique"]: float(row["recall_at_1"]) for row in csv.DictReader(file)}
    assert len(published) == 10
    with np.load(REAL / "corridor" / "vprbench_precomputed.npz", allow_pickle=False) as answers:
        for technique, recall in published.items():
            matched = answers[f"{technique}__match"]
            right = [best in right for best, right in zip(matched, corridor.positives, strict=True)]
            assert np.mean(right) == pytest.approx(recall, abs=1e-6)


# VPR_Tutorial


def test_gardens_point_is_right_by_number_within_eight_or_within_a_tolerance():
    for folder in ("day_left", "day_right", "night_right"):
        fill(Path(folder), numbered(20))
    right = rights(gardens_point(root=".", images=19, ground_truth="soft"))  # of the first 19
    assert (right[0], right[9], right[18]) == ([*range(9)], [*range(1, 18)], [*range(10, 19)])
    dataset = gardens_point(root=".", references=["day_left", "day_right"], images=20, ground_truth="soft", tolerance=1)
    assert rights(dataset)[:2] == [[0, 1], [0, 1, 2]]
    assert (dataset.places.tolist(), reds(dataset.references)) == ([*range(20)] * 2, [*range(20)] * 2)
    assert (dataset.protocol["ground_truth"], dataset.protocol["tolerance_places"]) == ("tolerance", 1)


HARD = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], bool)  # of four queries, the last has no place
SOFT = np.array([[1, 1, 0, 0], [1, 1, 1, 0], [0, 1, 1, 0]], bool)


@pytest.mark.parametrize("kind", [bool, np.uint8, float])
def test_columns_of_a_matrix_of_zeros_and_ones_are_queries_and_images_stand_in_the_order_of_their_paths(kind):
    fill(Path("dry"), ["image10.jpg", "image11.jpg", "image9.jpg"])
    fill(Path("jan"), numbered(4))
    np.savez("GT.npz", GThard=HARD.astype(kind), GTsoft=SOFT.astype(kind))
    dataset = with_matrix("sfu", ".", "dry", "jan", ground_truth="soft", unmatched="keep")
    assert rights(dataset) == [[0, 1], [0, 1, 2], [1, 2], []]
    assert dataset.references.names == ("image10.jpg", "image11.jpg", "image9.jpg")


@pytest.mark.parametrize(
    ("name", "reference", "query"), [("st_lucia", "100909_0845", "180809_1545"), ("sfu_mountain", "dry", "jan")]
)
def test_the_folders_of_the_tutorial_are_set(name, reference, query):
    fill(Path(reference), numbered(3))
    fill(Path(query), numbered(4))
    np.savez("GT.npz", GThard=HARD)
    protocol = configured(name, root=".").protocol
    assert (protocol["reference"], protocol["query"]) == (reference, query)
    assert (protocol["ground_truth"], protocol["unmatched"]) == ("hard", "drop")


@needs_real_frames
def test_the_ten_real_frames_of_gardens_point_are_read_grey_night_and_all():
    root = str(REAL / "gardens_point_sample10")
    dataset = configured("gardens_point", root=root, references=["day_left"], images=10, tolerance=2)
    night = dataset.queries[9]
    assert (dataset.references[9].shape, night.shape) == ((540, 960, 3), (360, 640, 3))
    assert (night[..., 0] == night[..., 2]).all()
    assert rights(dataset)[0] == [0, 1, 2]

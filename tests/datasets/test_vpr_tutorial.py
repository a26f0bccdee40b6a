"""Gardens Point, St Lucia and SFU Mountain of VPR_Tutorial: hard and soft ground truth, and what is missing."""

import re

import numpy as np
import pytest
import yaml
from image_folders import REAL, answer, fill, needs_real_frames, numbered, reds, rights

from vprbench.datasets.vpr_tutorial import gardens_point, with_matrix
from vprbench.errors import BadInput, NotThere
from vprbench.plugins import registry


@pytest.fixture
def gardens(tmp_path):
    for folder in ("day_left", "day_right", "night_right"):
        fill(tmp_path / folder, numbered(20))
    return tmp_path


def test_the_same_number_is_right_by_the_hard_ground_truth(gardens):
    dataset = gardens_point(root=str(gardens), images=20)
    assert rights(dataset) == [[number] for number in range(20)]
    assert reds(dataset.references) == reds(dataset.queries) == [*range(20)]


def test_seventeen_rows_are_right_by_the_soft_ground_truth(gardens):
    right = rights(gardens_point(root=str(gardens), images=20, ground_truth="soft"))
    assert right[10] == [*range(2, 19)]
    assert (right[0], right[19]) == ([*range(9)], [*range(11, 20)])


def test_a_tolerance_stands_in_for_both(gardens):
    dataset = gardens_point(root=str(gardens), images=20, ground_truth="soft", tolerance=1)
    assert rights(dataset)[:2] == [[0, 1], [0, 1, 2]]
    assert (dataset.protocol["ground_truth"], dataset.protocol["tolerance_places"]) == ("tolerance", 1)


def test_missing_images_are_counted_with_what_to_do(gardens):
    message = answer(gardens_point, root=str(gardens), kind=NotThere)
    assert "holds 20 of 200 images" in message
    assert "dataset.images=20" in message


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"references": []}, "dataset.references=[]"),
        ({"references": ["day_left", "day_left"]}, "each once"),
        ({"images": 0}, "dataset.images=0"),
        ({"tolerance": -1}, "dataset.tolerance=-1"),
    ],
)
def test_a_bad_option_is_named(gardens, options, told):
    assert told in answer(gardens_point, root=str(gardens), **options)


# Three references, four queries: the last query shows no place of the map.
HARD = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], dtype=bool)
SOFT = np.array([[1, 1, 0, 0], [1, 1, 1, 0], [0, 1, 1, 0]], dtype=bool)


@pytest.fixture
def drives(tmp_path):
    fill(tmp_path / "dry", [f"{number:02d}.jpg" for number in range(3)])
    fill(tmp_path / "jan", [f"{number:02d}.jpg" for number in range(4)])
    np.savez_compressed(tmp_path / "GT.npz", GThard=HARD, GTsoft=SOFT)
    return tmp_path


def read(root, **options):
    return with_matrix("sfu", str(root), "dry", "jan", **options)


@pytest.mark.parametrize(("strictness", "right"), [("hard", [[0], [1], [2]]), ("soft", [[0, 1], [0, 1, 2], [1, 2]])])
def test_columns_of_the_matrix_are_queries_and_one_without_a_place_is_left_out(drives, strictness, right):
    dataset = read(drives, ground_truth=strictness)
    assert rights(dataset) == right
    assert reds(dataset.queries) == [0, 1, 2]
    assert "1 of 4 queries have no right reference" in dataset.notes[0]
    assert rights(read(drives, ground_truth=strictness, unmatched="keep")) == [*right, []]


def test_a_matrix_of_zeros_and_ones_is_one_of_yes_and_no(drives):
    np.savez(drives / "GT.npz", GThard=HARD.astype(np.uint8), GTsoft=SOFT.astype(float))
    assert rights(read(drives)) == [[0], [1], [2]]
    assert rights(read(drives, ground_truth="soft"))[0] == [0, 1]


@pytest.mark.parametrize(
    ("matrices", "told"),
    [
        ({"GThard": HARD.T}, "has the shape (4, 3) (it is transposed); wanted is (3, 4)"),
        ({"GThard": HARD.astype(object)}, "cannot be read"),  # nor unpickled
        *(({"GThard": values}, "other than 0 and 1") for values in (HARD * 2, HARD * 0.5, HARD.astype(str))),
        ({"GThard": np.zeros((1000, 1000), bool)}, "unpacks to 1000128 bytes"),
        ({"GTsoft": HARD}, "holds no GThard"),
        (0, "cannot be read"),
        (200, "cannot be read"),
        (None, "get it from there"),
    ],
)
def test_a_file_without_such_a_matrix_is_refused(drives, matrices, told):
    file = drives / "GT.npz"
    if matrices is None:
        file.unlink()
    elif isinstance(matrices, int):
        file.write_bytes(file.read_bytes()[:matrices])
    else:
        np.savez_compressed(file, **matrices)
    message = answer(read, drives, source="get it from there", kind=NotThere if matrices is None else BadInput)
    assert str(file) in message
    assert told in message


@pytest.mark.parametrize(("field", "value"), [(6, 1), (6, 0x40), (8, 97), (8, 14)])
def test_a_file_that_is_encrypted_or_compressed_in_an_unknown_way_is_refused(drives, field, value):
    file = drives / "GT.npz"
    content = bytearray(file.read_bytes())
    for signature, shift in ((b"PK\3\4", 0), (b"PK\1\2", 2)):  # a member's own header, and that of the directory
        for start in (found.start() for found in re.finditer(re.escape(signature), content)):
            content[start + field + shift] = value
    file.write_bytes(content)
    assert f"{file} cannot be read" in answer(read, drives)


def test_images_stand_in_the_order_of_their_paths_as_the_matrix_wants(tmp_path):
    fill(tmp_path / "dry", ["image10.jpg", "image9.jpg"])
    fill(tmp_path / "jan", ["image1.jpg", "image2.jpg"])
    np.savez(tmp_path / "GT.npz", GThard=np.eye(2, dtype=bool))
    assert read(tmp_path).references.names == ("image10.jpg", "image9.jpg")


def configured(name, **changes):
    path = registry.entries("dataset")[name].path
    return registry.make_dataset({**yaml.safe_load(path.read_text(encoding="utf-8")), **changes})


@pytest.mark.parametrize(
    ("name", "reference", "query"), [("st_lucia", "100909_0845", "180809_1545"), ("sfu_mountain", "dry", "jan")]
)
def test_the_folders_of_the_tutorial_are_set(tmp_path, name, reference, query):
    fill(tmp_path / reference, numbered(3))
    fill(tmp_path / query, numbered(4))
    np.savez(tmp_path / "GT.npz", GThard=HARD)
    dataset = configured(name, root=str(tmp_path))
    assert dict(dataset.protocol) == {
        "protocol": "vpr_tutorial",
        "reference": reference,
        "query": query,
        "ground_truth": "hard",
        "unmatched": "drop",
    }


def test_the_protocol_of_gardens_point_says_everything_that_was_selected(gardens):
    assert dict(configured("gardens_point", root=str(gardens), images=4).protocol) == {
        "protocol": "vpr_tutorial",
        "references": ["day_right"],
        "query": "night_right",
        "images": 4,
        "ground_truth": "hard",
        "tolerance_places": 0,
        "unmatched": "error",
    }


@needs_real_frames
def test_the_ten_real_frames_of_gardens_point_are_read_grey_night_and_all():
    dataset = configured(
        "gardens_point", root=str(REAL / "gardens_point_sample10"), references=["day_left"], images=10, tolerance=2
    )
    assert dataset.references[9].shape == (540, 960, 3)
    night = dataset.queries[9]
    assert night.shape == (360, 640, 3)
    assert (night[..., 0] == night[..., 2]).all()
    assert rights(dataset)[0] == [0, 1, 2]

"""dbStruct .mat files: names and positions by field, images that are missing, and files that are none."""

import numpy as np
import pytest
from image_folders import answer, fill, reds, rights
from mat_cells import cells
from scipy.io import savemat

from vprbench.datasets.dbstruct import dbstruct
from vprbench.errors import NotThere
from vprbench.storage import mat_files

DATABASE = ["000/a.jpg", "000/b.jpg", "001/c.jpg"]
QUERIES = ["q1.jpg", "q2.jpg"]
METRES = [[585000.0, 585020.0, 585100.0], [4477000.0, 4477000.0, 4477000.0]]
QUERY_METRES = [[585007.0, 585060.0], [4477024.0, 4477000.0]]  # 7-24-25 from the first; 40 m from second and third


def structure(**changes):
    """Return the fields of dbStruct in the order in which Relja/netvlad writes them."""
    return {
        "whichSet": "test",
        "dbImageFns": cells(DATABASE),
        "utmDb": np.array(METRES),
        "qImageFns": cells(QUERIES),
        "utmQ": np.array(QUERY_METRES),
        "numImages": 3.0,
        "numQueries": 2.0,
        "posDistThr": 25.0,
        **changes,
    }


@pytest.fixture
def root(tmp_path):
    fill(tmp_path, DATABASE)
    fill(tmp_path / "queries_real", QUERIES)
    savemat(tmp_path / "set.mat", {"dbStruct": structure()})
    return tmp_path


def read(root, **options):
    return dbstruct(root=str(root), **{"mat": "set.mat", "query_folder": "queries_real", **options})


def test_right_is_what_lies_within_the_radius_the_edge_included(root):
    dataset = read(root)
    assert rights(dataset) == [[0], []]
    assert (reds(dataset.references), reds(dataset.queries)) == ([0, 1, 2], [0, 1])
    assert "1 of 2 queries have no reference within 25 m" in dataset.notes[0]


@pytest.mark.parametrize("content", [{"other": 1.0}, {"dbStruct": 5.0}, {"dbStruct": {"one": 1.0}}])
def test_a_file_without_the_structure_is_answered_with_what_it_holds(root, content):
    savemat(root / "set.mat", content)
    assert f"holds {next(iter(content))}, but no dbStruct" in answer(read, root)


def test_fields_are_taken_by_their_position_whatever_their_names(root):
    renamed = dict(zip("abcdefgh", structure().values(), strict=True))
    savemat(root / "set.mat", {"dbStruct": renamed})
    assert rights(read(root)) == [[0], []]


def test_names_padded_to_one_length_are_read(root):
    savemat(root / "set.mat", {"dbStruct": structure(qImageFns=np.array(["q1.jpg    ", "q2.jpg    "]))})
    assert read(root).queries.names == ("q1.jpg", "q2.jpg")


def test_the_suffix_of_database_names_can_be_replaced(root):
    for name in DATABASE:
        (root / name).rename((root / name).with_suffix(".png"))
    assert read(root, database_suffix=".png").references.names == ("a.png", "b.png", "c.png")


@pytest.mark.parametrize(
    ("name", "told"), [("001/c.jpg", "the database of"), ("queries_real/q2.jpg", "the queries of")]
)
def test_a_missing_image_is_named_and_counted(root, name, told):
    (root / name).unlink()
    message = answer(read, root, kind=NotThere)
    assert str(root / name) in message
    assert f"(1 of {3 if 'c' in name else 2} images in {told} set.mat are missing)" in message


@pytest.mark.parametrize(
    "damage",
    [
        {"utmDb": np.array(METRES).T},
        {"utmQ": np.array(METRES)},
        {"utmDb": np.array(METRES) * np.nan},
        {"utmDb": np.array(METRES) * 1e300},
        {"dbImageFns": np.zeros((3, 1))},
        {"qImageFns": cells([1.0, 2.0])},
        {"qImageFns": cells([])},
    ],
    ids=["transposed", "too many", "no numbers", "no metres", "no names", "numbers for names", "no queries"],
)
def test_fields_that_hold_something_else_are_numbered(root, damage):
    savemat(root / "set.mat", {"dbStruct": structure(**damage)})
    number = [*structure()].index(next(iter(damage))) + 1
    assert f"field {number} of dbStruct" in answer(read, root)


def test_a_file_of_version_7_3_is_answered_with_how_to_save_it(root):
    (root / "set.mat").write_bytes(
        b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + b"\x89HDF\r\n\x1a\n" + bytes(600)
    )
    assert "-v7" in answer(read, root)


@pytest.mark.parametrize("keep", [0, 100, 300])
def test_a_damaged_file_is_refused(root, keep):
    (root / "set.mat").write_bytes((root / "set.mat").read_bytes()[:keep])
    assert "cannot be read as a .mat file" in answer(read, root)


@pytest.mark.parametrize("bit", [2432, 2702, 3362, 3937, 5252])  # scipy 1.17 crashes on each
def test_a_file_with_one_wrong_bit_that_crashes_its_reader_is_refused(root, bit):
    content = bytearray((root / "set.mat").read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    (root / "set.mat").write_bytes(content)
    assert f"{root / 'set.mat'} cannot be read as a .mat file" in answer(read, root)


def test_a_small_file_that_unpacks_to_a_large_one_is_refused(root, monkeypatch):
    monkeypatch.setattr(mat_files, "_LEAST_BYTES", 1 << 24)
    savemat(root / "set.mat", {"dbStruct": structure(), "zeros": np.zeros(1 << 26, np.uint8)}, do_compression=True)
    assert "more than 16 MB of memory" in answer(read, root)


@pytest.mark.parametrize("mat", [None, "nowhere.mat"])
def test_a_file_that_is_not_there_is_answered_with_the_option_and_the_source(root, mat):
    message = answer(read, root, mat=mat, kind=NotThere)
    assert "dataset.mat" in message
    assert "netvlad_v100_datasets.tar.gz" in message


def test_the_protocol_says_everything_that_was_selected(root):
    asked = {"database_folder": "", "query_folder": "queries_real", "database_suffix": ".jpg"}
    assert dict(read(root, **asked).protocol) == {
        "protocol": "dbstruct",
        "mat": "set.mat",
        **asked,
        "radius_metres": 25.0,
        "unmatched": "keep",
    }

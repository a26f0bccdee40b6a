"""Every dataset of files gives what was written, and refuses missing, damaged and hostile files by name."""

import csv
from collections import namedtuple
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from image_folders import REAL, answer, fill, listed, lists, needs_real_frames, numbered, reds, rights, used
from mat_cells import cells
from scipy.io import savemat

from vprbench.datasets.brisbane_events_7x7 import brisbane_events_7x7
from vprbench.datasets.dbstruct import dbstruct
from vprbench.datasets.folders import folders
from vprbench.datasets.image_list import image_list
from vprbench.datasets.utm_folders import utm_folders
from vprbench.datasets.vpr_bench import vpr_bench
from vprbench.datasets.vpr_tutorial import gardens_point, with_matrix
from vprbench.errors import BadInput, MissingData
from vprbench.plugins import registry

WRITERS = {
    ".mat": savemat,
    ".npy": partial(np.save, allow_pickle=True),
    ".npz": lambda file, arrays: np.savez_compressed(file, **arrays),
}


def put(path, content):
    """Write images into a folder, or a text or arrays into a file; None takes away what is there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if content is None:
        path.rename(path.with_name("away"))
    elif isinstance(content, list):
        fill(path, content)
    elif isinstance(content, str | bytes):
        path.write_bytes(content.encode() if isinstance(content, str) else content)
    elif callable(content):
        path.write_bytes(content(path.read_bytes()))
    else:
        WRITERS[path.suffix](path, content)


def table(header, *rows):
    """Return a CSV of the images 0.jpg, 1.jpg and so on."""
    return "\n".join([f"image,{header}", *(f"{number}.jpg,{row}" for number, row in enumerate(rows))]) + "\n"


def structure(**changes):
    """Return the fields of dbStruct in the order in which Relja/netvlad writes them."""
    return {
        "whichSet": "test",
        "dbImageFns": cells(["000/a.jpg", "000/b.jpg", "001/c.jpg"]),
        "utmDb": np.array([[585000.0, 585020.0, 585100.0], [4477000.0] * 3]),
        "qImageFns": cells(["q1.jpg", "q2.jpg"]),
        "utmQ": np.array([[585007.0, 585060.0], [4477024.0, 4477000.0]]),  # 7-24-25 from the first; 40 m from others
        "numImages": 3.0,
        "numQueries": 2.0,
        "posDistThr": 25.0,
        **changes,
    }


RIGHT = np.array([[1, 0, 0], [0, 1, 1], [0, 0, 0], [1, 0, 1]], bool)  # of four queries, the third has no place
HARD = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], bool)  # of four queries, the last has none
AT = ["@0@0@10@S@.jpg", "@20@0@10@S@.jpg", "@40@0@10@S@.jpg"]


# A dataset, what lies on the disk for it, how it is called, and what it holds.
Source = namedtuple("Source", "make files options rights protocol note", defaults=[""])


TWO = {"references": ["a", "b"], "queries": "c"}
SOURCES = {
    "index": Source(
        folders,
        {"a": numbered(3), "b": numbered(3), "c": numbered(3)},
        {**TWO, "tolerance": 1},
        [[0, 1], [0, 1, 2], [1, 2]],
        "protocol=folders references=a+b queries=c ground_truth=index tolerance_places=1 unmatched=error",
    ),
    "utm": Source(
        folders,
        {"a": AT, "c": ["@45@0@10@S@.jpg"]},
        {"references": ["a"], "queries": "c", "ground_truth": "utm"},
        [[1, 2]],
        "protocol=folders references=a queries=c ground_truth=utm radius_metres=25.0 unmatched=error",
    ),
    "matrix": Source(
        folders,
        {"a": numbered(2), "b": numbered(1), "c": numbered(4), "truth.npz": {"positives": RIGHT.astype(np.float32)}},
        {**TWO, "ground_truth": "truth.npz", "unmatched": "keep"},
        [[0], [1, 2], [], [0, 2]],
        "protocol=folders references=a+b queries=c ground_truth=truth.npz unmatched=keep breaks=folders",
        "1 of 4 queries have no right reference in truth.npz; they count as misses (dataset.unmatched=keep)",
    ),
    "lens": Source(
        brisbane_events_7x7,
        {"sunset2": numbered(4), "sunset1": numbered(3), "ground_truth.npz": {"positives": np.eye(3, 4, dtype=bool)}},
        {"root": "."},
        [[0], [1], [2]],
        "protocol=lens_frames references=sunset2 queries=sunset1 ground_truth=ground_truth.npz unmatched=keep",
        "sequences of 2",
    ),
    "database": Source(
        utm_folders,
        {"images/test/database": AT, "images/test/queries": ["@0@5@@.jpg", "@30@0@@.jpg", "@900@0@@.jpg"]},
        {"root": "."},
        [[0, 1], [1, 2], []],
        "protocol=utm_folders split=test database=database queries=queries radius_metres=25.0 zones=error "
        "unmatched=keep",
        "1 of 3 queries have no reference within 25 m; they count as misses (dataset.unmatched=keep)",
    ),
    "list": Source(
        image_list,
        {
            ".": numbered(5),
            "map0.csv": table("place", "yard", "hall", "yard", "7", "stairs"),
            "map1.csv": "place,image\nhall,4.jpg\nattic,0.jpg\n",
            "asked.csv": table("place", "stairs", "yard", "007"),
        },
        {"references": ["map0.csv", "map1.csv"], "queries": "asked.csv", "tolerance": 1},
        [[2, 3, 4], [0, 1], [1, 2, 3]],
        "protocol=image_list references=map0.csv+map1.csv queries=asked.csv ground_truth=place tolerance_places=1 "
        "unmatched=error",
    ),
    "dbstruct": Source(
        dbstruct,
        {
            ".": ["000/a.jpg", "000/b.jpg", "001/c.jpg"],
            "asked": ["q1.jpg", "q2.jpg"],
            "set.mat": {"dbStruct": structure()},
        },
        {"root": ".", "mat": "set.mat", "query_folder": "asked"},
        [[0], []],
        "protocol=dbstruct mat=set.mat database_folder= query_folder=asked database_suffix=None radius_metres=25.0 "
        "unmatched=keep",
        "1 of 2 queries have no reference within 25 m",
    ),
    "numbers": Source(
        vpr_bench,
        {"query": numbered(11), "ref": numbered(11), "ground_truth_new.npy": lists(*([n] for n in range(11)))},
        {"root": "."},
        [[n] for n in range(11)],
        "protocol=vpr_bench references=ref queries=query ground_truth=ground_truth_new.npy out_of_range=error "
        "out_of_range_queries=0 unmatched=keep",
    ),
    "gardens": Source(
        gardens_point,
        {"day_right": numbered(20), "night_right": numbered(20)},
        {"root": ".", "images": 20},
        [[n] for n in range(20)],
        "protocol=vpr_tutorial references=day_right query=night_right images=20 ground_truth=hard tolerance_places=0 "
        "unmatched=error",
    ),
    "tutorial": Source(
        with_matrix,
        {"dry": numbered(3), "jan": numbered(4), "GT.npz": {"GThard": HARD, "GTsoft": HARD}},
        {"root": ".", "reference": "dry", "query": "jan", "source": "get it from there"},
        [[0], [1], [2]],
        "protocol=vpr_tutorial reference=dry query=jan ground_truth=hard unmatched=drop",
        "1 of 4 queries have no right reference in GThard; they are left out (dataset.unmatched=drop)",
    ),
}


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def written(source, **changed):
    """Write the files of a source; returns the dataset's function and its options, some of them changed."""
    make, files, options, *_ = SOURCES[source]
    for path, content in files.items():
        put(Path(path), content)
    return make, {"name": "mine", **options, **changed}


@pytest.mark.parametrize("source", SOURCES)
def test_what_was_written_is_read(source):
    expected, (make, options) = SOURCES[source], written(source)
    dataset = make(**options)
    assert dataset.name == "mine"
    assert rights(dataset) == expected.rights
    told = {key: "+".join(value) if isinstance(value, list) else value for key, value in dataset.protocol.items()}
    assert sorted(f"{key}={value}" for key, value in told.items()) == sorted(expected.protocol.split(" "))
    assert [expected.note in note for note in dataset.notes] == [True] * bool(expected.note)
    assert len(used(dataset)) == sum(len(names) for names in expected.files.values() if isinstance(names, list))
    assert reds(dataset.queries) == [*range(len(expected.rights))]
    if source == "list":
        assert dataset.places.tolist() == [0, 1, 0, 2, 3, 1, 4]
        assert reds(dataset.references) == [0, 1, 2, 3, 4, 4, 0]
    elif source == "index":
        assert dataset.places.tolist() == [0, 1, 2] * 2
    elif source == "matrix":
        assert reds(dataset.references) == [0, 1, 0]
    else:
        assert dataset.places.tolist() == reds(dataset.references) == [*range(dataset.n_places)]


def both(content):
    return {"map0.csv": content, "map1.csv": content, "asked.csv": content}


PLACES, ASKED = "image,place\n0.jpg,7\n1.jpg,8\n2.jpg,9\n", "image,place\n5.jpg,9\n6.jpg,7\n"
GRID = "image;east;north\n0.jpg;0,5;-1,25\n1.jpg;60;0,0\n2.jpg;120,75;0\n"
OWN = [[query] for query in range(11)]
HDF5 = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + b"\x89HDF\r\n\x1a\n" + bytes(600)
METRES = structure()["utmDb"]

# What is changed on the disk, which options, and what the message names, parts of it between three points.
REFUSED = {
    "index": [
        ({"b": ["3.jpg"]}, {}, "hold different numbers of images (a 3, b 4, c 3)"),
        ({}, {"tolerance": -1}, "dataset.tolerance=-1"),
        ({}, {"ground_truth": "idx"}, "dataset.ground_truth=idx"),
    ],
    "utm": [
        *(({"c": [name]}, {}, f"c/{name}") for name in ("@east@north@.png", "@12.png", "@nan@4@.png", "@1@-1e9@.png")),
        ({"c": ["@45@0@11@S@.jpg"]}, {}, "2 UTM zones"),
    ],
    "matrix": [
        ({"truth.npz": {"truth": RIGHT}}, {}, "truth.npz holds no positives, but truth: "),
        ({"truth.npz": {"utmQ": METRES.T, "gt": RIGHT}}, {}, "utmQ and utmDb"),
    ],
    "database": [
        ({}, {"unmatched": "error"}, "1 of 3 queries have no reference within 25 m (first: images/test/queries/@900@"),
        ({}, {"radius_metres": 1, "unmatched": "drop"}, "leaves none"),
        *(({}, {"radius_metres": radius}, "dataset.radius_metres=") for radius in (0, float("nan"), 1.01e8)),
        ({"images/test/queries_images_paths.txt": b"\xff\xfe@\x00\n"}, {}, "queries_images_paths.txt is no text"),
    ],
    "list": [
        ({"asked.csv": table("place", "yard", "x")}, {}, "1 of 2 queries have a place that no reference shows"),
        ({"asked.csv": table("lat,lon", "1,2")}, {}, "map1.csv has place, image; asked.csv has image, lat, lon"),
        *(
            (both(content), {}, told)
            for content, told in (
                ("", "cannot be read as a CSV"),
                ("image,place,Image name\n0.jpg,1,2\n", "each once"),
                ("image;place\n", "lists no image"),
                ('image,place\n"0.jpg,1\n', "cannot be read as a CSV"),
                ("image,place\n0.jpg,1\n0.jpg,\n", "row 2 of map0.csv"),
                ("image,place\n0.jpg,1\n0.jpg,1,5\n", "in line 3, saw 3"),
                ("image,place\n0.jpg\n", "row 1 of map0.csv has no place"),
                ("image,east,north\n0.jpg,0,0\n1.jpg,inf,1\n", "east inf in row 2 of"),
                ("image,lat,lon\n0.jpg,90.1,1\n", "lat 90.1 in row 1 of"),
                # what may be meant in two ways
                (PLACES.replace("8", "8,5"), "map0.csv ... line 3 ... point"),
                (PLACES.replace("7", "\xe9").encode("latin-1"), "map0.csv ... UTF-8"),
                ('image,lat,lon\n0.jpg,"51,5",7\n', "lat 51,5 in row 1 of map0.csv ... point"),
                ("image;east;north\n0.jpg;545,012;7\n", "east 545,012 in row 1 of map0.csv ... point"),  # of thousands?
            )
        ),
    ],
    "dbstruct": [
        ({"set.mat": {"other": 1.0}}, {}, "holds other, but no dbStruct"),
        *(
            ({"set.mat": {"dbStruct": structure(**{field: value})}}, {}, f"field {number} of dbStruct")
            for number, field, value in (
                (2, "dbImageFns", np.zeros((3, 1))),
                (3, "utmDb", METRES[:, :2]),
                (4, "qImageFns", cells([1.0, 2.0])),
            )
        ),
        ({"set.mat": lambda content: content[:300]}, {}, "cannot be read as a .mat file"),
        ({"set.mat": HDF5}, {}, "-v7"),
    ],
    "numbers": [
        *(
            ({"ground_truth_new.npy": lists(*rows)}, {}, f"ground_truth_new.npy {told}")
            for rows, told in (
                ([*OWN[:10], [10, 11]], "names reference 11 for query 10, but query/ holds 11 and ref/ 11 images"),
                ([*OWN[:10], [-1]], "names reference -1 for query 10"),
                ([*OWN, [0]], "names reference 0 for query 11, but query/ holds 11"),
                (OWN[:9], "has no row for 2 of 11 queries (first: query 9)"),
                *(([*OWN[:10], bad], "is no [query, [references]]") for bad in (5, [0.5], [True])),
            )
        ),
        *(
            ({"ground_truth.csv": content}, {"ground_truth": "ground_truth.csv"}, told)
            for content, told in (
                (b"query,refs\n0,0\n", "has the columns query, refs"),
                (b"query,matching_refs\n0,0\n1,a b", "row 2 of"),
                (b"query,matching_refs\n0,0\n0,1\n", "has two rows for query 0"),
                (b"query,matching_refs\n0,\xe9\n", "cannot be read as a CSV"),
            )
        ),
    ],
    "gardens": [({}, {"references": ["day_right", "day_right"]}, "each once"), ({}, {"images": 0}, "dataset.images=0")],
    "tutorial": [
        ({"GT.npz": {"GThard": HARD.T}}, {}, "GT.npz has the shape (4, 3) (it is transposed); wanted is (3, 4)"),
        *(
            ({"GT.npz": {"GThard": values}}, {}, "GT.npz holds " + told)
            for values, told in ((HARD * 2, "int64 values"), (HARD * 0.5, "float64"), (HARD.astype(str), "<U5"))
        ),
        ({"GT.npz": {"hard": HARD}}, {}, "GT.npz holds no GThard, but hard: wanted is a matrix GThard"),
        ({"GT.npz": {"GThard": np.zeros((1000, 1000), bool)}}, {}, "unpacks to 1000128 bytes"),
        ({"GT.npz": {"GThard": HARD.astype(object)}}, {}, "GT.npz cannot be read"),  # nor unpickled
        ({"GT.npz": lambda content: content[:200]}, {}, "GT.npz cannot be read"),
    ],
}
MISSING = {
    "index": [
        *(({}, {option: None}, "dataset.references and dataset.queries") for option in ("references", "queries")),
        ({}, {"queries": "gone"}, "dataset.queries: gone is no folder"),
        ({}, {"queries": ""}, "dataset.queries: nothing is no folder"),
        ({"d/notes.txt": "no image"}, {"references": ["a", "d"]}, "dataset.references: d holds no images"),
    ],
    "matrix": [({}, {"ground_truth": "gone.npz"}, "gone.npz is no file")],
    "lens": [({"sunset2": None}, {}, "sunset2 is no folder")],
    "database": [
        ({"images/test/queries_images_paths.txt": "\n"}, {}, "queries_images_paths.txt names no image"),
        ({"images/test/queries_images_paths.txt": "@7@.jpg\n"}, {}, "queries/@7@.jpg does not exist (1 of 1 images in"),
        ({}, {"root": None, "name": "pitts30k"}, "dataset.root is not set: pitts30k"),
    ],
    "list": [
        ({}, {"references": ["gone.csv"]}, "gone.csv is no file"),
        ({"3.jpg": None}, {}, "3.jpg does not exist (1 of 5 images in map0.csv are missing)"),
        (both(PLACES.replace("1.jpg", "1.jpeg")), {}, "1.jpeg does not exist ... row 2 ... 1.jpg"),
        (both(PLACES.replace("1.jpg", "sub\\11.jpg")), {}, "11.jpg does not exist ... row 2 ... dataset.root"),
        ({"3.jpg": None, "3.JpG": "", "3.jPG": "", "map0.csv": "image,place\n3.JPG,1"}, {}, "3.jPG or 3.JpG"),
    ],
    "dbstruct": [
        ({"001/c.jpg": None}, {}, "001/c.jpg does not exist (1 of 3 images in the database of set.mat are missing)"),
        ({"asked/q2.jpg": None}, {}, "asked/q2.jpg does not exist (1 of 2 images in the queries of set.mat"),
        ({}, {"mat": None}, "dataset.mat"),
        ({}, {"mat": "gone.mat"}, "dataset.mat: gone.mat"),
    ],
    "numbers": [
        *(({part: None}, {}, f"{part} is no folder") for part in ("query", "ref")),
        ({"ground_truth_new.npy": None}, {}, "holds no ground_truth_new.npy and no ground_truth.csv"),
    ],
    "gardens": [({}, {"images": 21}, "day_right holds 20 of 21 images: restore the others, or pass dataset.images=20")],
    "tutorial": [({"GT.npz": None}, {}, "GT.npz is no file: get it from there")],
}


@pytest.mark.parametrize(
    ("source", "files", "options", "told", "kind"),
    [
        pytest.param(source, *case, kind, id=f"{source} {case[2]}")
        for kind, refused in ((BadInput, REFUSED), (MissingData, MISSING))
        for source, cases in refused.items()
        for case in cases
    ],
)
def test_what_is_missing_does_not_fit_or_is_damaged_is_refused(source, files, options, told, kind):
    make, given = written(source, **options)
    for path, content in files.items():
        put(Path(path), content)
    message = answer(make, kind=kind, **given)
    assert [part for part in told.split(" ... ") if part not in message] == []


def at(*positions):
    return [f"@{east}@{north}@10@S@@@{i}@.jpg" for i, (east, north) in enumerate(positions)]


@pytest.mark.parametrize(
    ("references", "queries", "options", "right"),
    [
        ("Image name,index\n0.jpg,0\n1.jpg,1\n", "Image name,index\n5.jpg,1\n6.jpg,0\n", {}, [[1], [0]]),  # VPRTempo's
        ("\ufeffImage, Place\n0.jpg, a\n", "IMAGE,PLACE\n1.jpg,a \n", {}, [[0]]),
        ("image,place\n3.jpg,0\n3.jpg,1\n", "image,place\n3.jpg,1\n4.jpg,2\n", {"unmatched": "drop"}, [[1]]),
        # the first kind of ground truth that both tables have
        ("image,lat,lon,east,north\n0.jpg,1,2,0,0\n", "image,east,north,place\n1.jpg,25,0,a\n", {}, [[0]]),
        ("image,lat,lon,east,north\n0.jpg,1,2,0,0\n", "image,lat,lon,place\n1.jpg,1,2,a\n", {}, [[0]]),
        ("image,east,north\n0.jpg,3,4\n1.jpg,4,4\n", "image,east,north\n0.jpg,0,0\n", {"radius_metres": 5}, [[0]]),
        ("image,place\n40.jpg,1\n", "image,place\n40.jpg,1\n", {"root": "sub"}, [[0]]),
        # as Windows, Excel and pandas write them
        *(
            (references, queries, {}, [[2], [0]])
            for references, queries in (
                *((PLACES.encode(encoding), ASKED) for encoding in ("utf-16", "utf-8-sig")),
                (b"\xfe\xff" + PLACES.encode("utf-16-be"), ASKED.replace("\n", "\r\n")),
                (f"sep=;\n{PLACES}".replace(",", ";"), ASKED.replace(",", "\t")),
                (PLACES.replace(",", "|").join(["sep=|\n", ""]), ASKED.replace(",", ";")),
                (PLACES.replace("7", "7.0").replace("9", "009"), ASKED.replace("7", "7.000")),
                (PLACES.replace(",", ";").replace("7", "7,0"), ASKED),
                (GRID, "image;east;north\n5.jpg;100,0;0,25\n6.jpg;1,1;0\n"),
                (GRID.replace(",", ".").replace(";", ","), "image\teast\tnorth\n5.jpg\t100,0\t0,25\n6.jpg\t1,1\t0\n"),
                (PLACES.replace("0.jpg", "0.JPG"), ASKED.replace("5.jpg", "5.Jpg")),
                (PLACES.replace("0.jpg", "sub\\0.jpg"), ASKED.replace("5.jpg", ".\\sub\\5.JPG")),
            )
        ),
    ],
)
def test_lists_are_read_as_people_and_programs_write_them(references, queries, options, right):
    fill(Path("sub"), numbered(41))
    dataset = listed(references, queries, **options)
    assert rights(dataset) == right
    if right == [[2], [0]]:
        assert (reds(dataset.references), reds(dataset.queries)) == ([0, 1, 2], [5, 6])


def fingerprint(dataset):
    return dataset.references.fingerprint(), dataset.queries.fingerprint(), rights(dataset), dict(dataset.protocol)


@pytest.mark.parametrize("way", ["in one folder", "in capitals", "deeper"])
def test_folders_are_found_in_one_folder_as_a_zip_is_unpacked_in_other_capitals_and_one_folder_deeper(way):
    make, options = written("numbers")
    before = fingerprint(make(**options))
    Path("outer").mkdir()
    for path in [path for path in Path().iterdir() if path.name != "outer"]:
        if way == "in one folder":
            path.rename(Path("outer") / path)
        elif path.is_dir() and way == "in capitals":
            path.rename(path.name.upper())
        elif path.is_dir():
            path.rename(f"{path} of it")
            path.mkdir()
            Path(f"{path} of it").rename(path / path.name)
    if way != "in one folder":
        Path("outer").rmdir()
    assert fingerprint(make(**options)) == before


def test_the_nearest_folder_is_named():
    fill(Path("london/test/database"), at((0, 0)))
    for given in ("london/databases", "london/test/DATABASE"):
        told = answer(folders, kind=MissingData, references=[given], queries="x")
        assert "did you mean london/test/database?" in told


# A thousandth of a degree near Brisbane (27.5 degrees south): 110.80 m north, 98.83 m east (tables of WGS 84).
@pytest.mark.parametrize(("moved", "metres"), [("-27.499,153.0", 110.80), ("-27.5,153.001", 98.83)])
def test_positions_in_degrees_are_right_within_the_radius(moved, metres):
    references, query = "image,lat,lon\n0.jpg,-27.5,153.0\n", f"image,lat,lon\n0.jpg,{moved}\n"
    near = listed(references, query, radius_metres=metres + 0.05)
    assert (rights(near), near.protocol["ground_truth"]) == ([[0]], "lat_lon")
    assert rights(listed(references, query, radius_metres=metres - 0.05, unmatched="keep")) == [[]]


def test_images_come_in_the_order_of_their_whole_paths_or_of_the_list_beside_their_folder(monkeypatch):
    fill(Path("me@7@8/gallery"), ["b/@1@0@.jpg", "a/@9@0@.jpg", "@5@0@.jpg", "a/@10@0@.jpg"])
    fill(Path("me@7@8/queries"), at((-900, 0), (3, 4), (30, 0)))
    dataset = utm_folders(root="me@7@8", database="gallery", radius_metres=5, unmatched="drop")
    assert dataset.references.names == ("@5@0@.jpg", "@10@0@.jpg", "@9@0@.jpg", "@1@0@.jpg")
    assert (reds(dataset.queries), rights(dataset), len(used(dataset))) == ([1], [[0, 3]], 7)
    assert "2 of 3" in dataset.notes[0]
    names = at((0, 0), (20, 0), (40, 0))
    fill(Path("town/database"), names)
    fill(Path("town/queries"), at((0, 5)))
    Path("town/database_images_paths.txt").write_text(f"\ufeff{names[2]}\n\n{names[0]}\n", "utf-8")
    monkeypatch.setenv("VPRBENCH_DATA", ".")
    dataset = utm_folders(name="town")  # which lies where downloads lie
    assert (reds(dataset.references), rights(dataset)) == ([2, 0], [[1]])
    assert dataset.protocol["lists"] == ["database_images_paths.txt"]


def test_fields_of_dbstruct_are_taken_by_position_and_gardens_point_is_right_by_number():
    fill(Path(), ["a.png", "b.png", "q1.jpg", "q2.jpg"])
    fields = ["test", cells(["a.jpg", "b.jpg"]), np.array([[0, 30], [0, 0]]), np.array(["q1.jpg    ", "q2.jpg    "])]
    savemat("set.mat", {"dbStruct": dict(zip("abcde", [*fields, np.array([[25.0, 56.0], [0, 0]])], strict=True))})
    dataset = dbstruct(root=".", mat="set.mat", database_suffix=".png")
    assert (dataset.references.names, dataset.queries.names) == (("a.png", "b.png"), ("q1.jpg", "q2.jpg"))
    assert rights(dataset) == [[0, 1], []]
    for folder in ("day_left", "day_right", "night_right"):
        fill(Path(folder), numbered(20))
    right = rights(gardens_point(root=".", images=19, ground_truth="soft"))  # of the first 19
    assert (right[0], right[9], right[18]) == ([*range(9)], [*range(1, 18)], [*range(10, 19)])
    dataset = gardens_point(root=".", references=["day_left", "day_right"], images=20, ground_truth="soft", tolerance=1)
    assert rights(dataset)[:2] == [[0, 1], [0, 1, 2]]
    assert (dataset.places.tolist(), reds(dataset.references)) == ([*range(20)] * 2, [*range(20)] * 2)
    assert (dataset.protocol["ground_truth"], dataset.protocol["tolerance_places"]) == ("tolerance", 1)


def test_the_pickle_comes_before_a_csv_that_says_the_same_and_queries_without_references_are_noted():
    written("numbers")
    put(Path("ground_truth_new.npy"), lists(*([query, 0] for query in range(11))))
    rows = "".join(f"{query},{query} {query - 1}\n" for query in range(1, 11))
    Path("ground_truth.csv").write_text(f"query,matching_refs\n0,\n{rows}")
    assert rights(vpr_bench(root="."))[10] == [0, 10]
    Path("ground_truth_new.npy").unlink()
    from_csv = vpr_bench(root=".")
    assert rights(from_csv) == [[], *([query - 1, query] for query in range(1, 11))]
    assert from_csv.protocol["ground_truth"] == "ground_truth.csv"
    assert "1 of 11 queries have no right reference in ground_truth.csv" in from_csv.notes[0]


def test_clipped_numbers_are_left_out_and_counted_and_rows_are_taken_by_their_query():
    for part in ("query", "ref"):
        fill(Path(part), numbered(3))
    rows = lists([-1, 0, 1], [1, 0, 1], [1, 2, 3], [0])  # the last is of a query without an image
    np.save("ground_truth_new.npy", rows[[1, 3, 0, 2]], allow_pickle=True)
    dataset = vpr_bench(root=".", out_of_range="clip")
    assert rights(dataset) == [[0, 1], [0, 1], [1, 2]]
    assert dataset.protocol["out_of_range_queries"] == 3
    assert "in 3 of 4 rows (first: query 3)" in dataset.notes[0]


@needs_real_frames
def test_the_matches_that_vpr_bench_stored_of_corridor_give_the_recalls_that_it_published():
    corridor = registry.make_dataset(
        yaml.safe_load(registry.find_entries("dataset")["corridor"].path.read_text("utf-8"))
    )
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

"""Images listed in CSV files: places by any name, positions in metres and degrees, and tables that do not fit."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from image_folders import answer, brute_force, fill, numbered, reds, rights, used

from vprbench.datasets.image_list import image_list
from vprbench.errors import NotThere

quiet = settings(derandomize=True, deadline=None, database=None, max_examples=40)


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    """A folder with thirty images, 0.jpg to 29.jpg."""
    return fill(tmp_path_factory.mktemp("frames"), numbered(30))


@pytest.fixture
def listed(frames):
    """A function that writes CSV files beside the images and returns their dataset."""

    def listed(references, queries, **options):
        return image_list(**paths(references, queries), **options)

    def paths(references, queries):
        tables = [references] if isinstance(references, str) else references
        files = [frames / f"references{number}.csv" for number in range(len(tables))]
        for file, table in zip([*files, frames / "queries.csv"], [*tables, queries], strict=True):
            file.write_text(table, encoding="utf-8")
        return {"references": [str(file) for file in files], "queries": str(frames / "queries.csv")}

    listed.refused = lambda references, queries, **options: answer(image_list, **paths(references, queries), **options)
    return listed


def table(header, *rows):
    """Return a CSV of the images 0.jpg, 1.jpg and so on."""
    return "\n".join([f"image,{header}", *(f"{number}.jpg,{row}" for number, row in enumerate(rows))]) + "\n"


def test_places_are_numbered_in_the_order_in_which_references_first_name_them(listed):
    dataset = listed(table("place", "yard", "hall", "yard", "7", "stairs"), table("place", "stairs", "yard", "007"))
    assert dataset.places.tolist() == [0, 1, 0, 2, 3]
    assert rights(dataset) == [[3], [0], [2]]


def test_several_tables_are_traverses_and_queries_of_unknown_places_are_an_error_or_left_out(listed):
    tables = [table("place", "a", "b"), table("place", "b", "c", "a")], table("place", "c", "x")
    message = listed.refused(*tables)
    assert "1 of 2 queries have a place that no reference shows" in message
    assert "1.jpg" in message
    dataset = listed(*tables, tolerance=1, unmatched="drop")
    assert (dataset.places.tolist(), reds(dataset.queries)) == ([0, 1, 1, 2, 0], [0])
    assert rights(dataset) == [[1, 2]]


def test_the_tolerance_counts_places_in_that_numbering(listed):
    dataset = listed(table("place", "30", "10", "20", "40"), table("place", "30", "20"), tolerance=1)
    assert rights(dataset) == [[0, 1], [1, 2, 3]]


def test_images_come_in_the_order_of_the_rows(listed):
    dataset = listed("place,image\n5,10.jpg\n4,9.jpg\n", "place,image\n4,2.jpg\n5,11.jpg\n")
    assert (reds(dataset.references), reds(dataset.queries)) == ([10, 9], [2, 11])
    assert rights(dataset) == [[1], [0]]


def test_an_image_may_stand_in_several_rows(listed):
    dataset = listed("image,place\n3.jpg,0\n3.jpg,1\n", "image,place\n3.jpg,1\n")
    assert (reds(dataset.references), rights(dataset)) == ([3, 3], [[1]])
    assert len(used(dataset)) == 1


def test_the_lists_of_vprtempo_are_read(listed):
    dataset = listed("Image name,index\n0.jpg,0\n1.jpg,1\n2.jpg,2\n", "Image name,index\n5.jpg,2\n6.jpg,0\n")
    assert rights(dataset) == [[2], [0]]


def test_a_byte_order_mark_spaces_and_capitals_in_the_header_do_not_matter(listed):
    assert rights(listed("\ufeffImage, Place\n0.jpg, a\n", "IMAGE,PLACE\n1.jpg,a \n")) == [[0]]


@quiet
@given(
    st.lists(st.tuples(st.integers(0, 60), st.integers(0, 60)), min_size=1, max_size=20),
    st.lists(st.tuples(st.integers(0, 60), st.integers(0, 60)), min_size=1, max_size=6),
    st.integers(1, 30),
)
def test_positions_in_metres_are_right_within_the_radius_the_edge_included(frames, references, queries, radius):
    for name, positions in (("metres", references), ("asked", queries)):
        (frames / f"{name}.csv").write_text(table("east,north", *(f"{x + 500000},{y + 4e6}" for x, y in positions)))
    dataset = image_list(
        references=[str(frames / "metres.csv")],
        queries=str(frames / "asked.csv"),
        radius_metres=float(radius),
        unmatched="keep",
    )
    assert rights(dataset) == brute_force(references, queries, radius)


# A thousandth of a degree near Brisbane (27.5 degrees south): 110.80 m north, 98.83 m east (tables of WGS 84).
@pytest.mark.parametrize(("moved", "metres"), [("-27.499,153.0", 110.80), ("-27.5,153.001", 98.83)])
def test_positions_in_degrees_are_right_within_the_radius(listed, moved, metres):
    references, query = table("lat,lon", "-27.5,153.0"), table("lat,lon", moved)
    assert rights(listed(references, query, radius_metres=metres + 0.05)) == [[0]]
    assert rights(listed(references, query, radius_metres=metres - 0.05, unmatched="keep")) == [[]]


def test_of_several_kinds_of_ground_truth_the_first_that_all_tables_have_is_taken(listed):
    both = table("lat,lon,east,north", "10,20,0,0", "10,20,500,0")
    dataset = listed(both, table("east,north,place", "499,0,a"))
    assert (dataset.protocol["ground_truth"], rights(dataset)) == ("east_north", [[1]])


def test_paths_may_start_from_another_folder(frames, tmp_path):
    (tmp_path / "list.csv").write_text(table("place", "a"))
    file = str(tmp_path / "list.csv")
    assert len(image_list(references=[file], queries=file, root=str(frames)).queries) == 1
    message = answer(image_list, references=[file], queries=file, kind=NotThere)
    assert str(tmp_path / "0.jpg") in message
    assert "dataset.root" in message


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("a,b\n1,2\n", "has the columns a, b"),
        ("image,place,Image name\n0.jpg,1,2\n", "each once"),
        ("image\n0.jpg\n", "image, and place or east,north or lat,lon"),
        ("image,place\n", "lists no image"),
        ("", "has the columns none"),
        ('image,place\n"0.jpg,1\n', "cannot be read as a CSV"),
        ("image,place" + ",x" * 200_000 + "\n0.jpg,1\n", "has 200002 columns"),
        ("image,place\n0.jpg,\n", "row 1 of"),
        ("image,place\n0.jpg,1\n,2\n", "row 2 of"),
        ("image,place\n0.jpg,1,5\n", "more cells than its header"),
        ("image,place\n0.jpg,1\n0.jpg,1,5\n", "line 3 of"),
        ("image,east,north\n0.jpg,1,x\n", "north x in row 1 of"),
        ("image,east,north\n0.jpg,inf,1\n", "east inf in row 1 of"),
        ("image,east,north\n0.jpg,0,0\n1.jpg,1,1e308\n", "north 1e308 in row 2 of"),
        ("image,lat,lon\n0.jpg,91,1\n", "lat 91 in row 1 of"),
        ("image,lat,lon\n0.jpg,1,2\n0.jpg,1,-181\n", "lon -181 in row 2 of"),
    ],
)
def test_a_table_that_does_not_fit_is_answered_with_what_is_wrong(listed, content, told):
    assert told in listed.refused(content, content)


def test_tables_that_are_missing_or_of_different_kinds_are_named(listed, tmp_path):
    message = listed.refused(table("place", "a"), table("lat,lon", "1,2"))
    assert "references0.csv has image, place; queries.csv has image, lat, lon" in message
    file = str(tmp_path / "none.csv")
    assert file in answer(image_list, references=[file], queries=file, kind=NotThere)
    assert "dataset.references and dataset.queries" in answer(image_list, kind=NotThere)


def test_the_protocol_says_everything_that_was_selected(listed):
    assert dict(listed([table("place", "a"), table("place", "a")], table("place", "a"), tolerance=2).protocol) == {
        "protocol": "image_list",
        "references": ["references0.csv", "references1.csv"],
        "queries": "queries.csv",
        "ground_truth": "place",
        "tolerance_places": 2,
        "unmatched": "error",
    }

"""Folders of VPR-Bench: natural order, numbers that fit the images, and Corridor with the published recalls."""

import csv

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from image_folders import REAL, answer, fill, lists, needs_real_frames, numbered, reds, rights, used

from vprbench.datasets.vpr_bench import in_range, vpr_bench
from vprbench.errors import BadInput, NotThere
from vprbench.plugins import registry

quiet = settings(derandomize=True, deadline=None, database=None, max_examples=150)


def stored(folder, rows):
    np.save(folder / "ground_truth_new.npy", rows, allow_pickle=True)


@pytest.fixture
def root(tmp_path):
    """Eleven queries and as many references; right is the same number and the one after."""
    for part in ("query", "ref"):
        fill(tmp_path / part, numbered(11))
    stored(tmp_path, lists(*([query, min(query + 1, 10)] for query in range(11))))
    return tmp_path


def test_images_are_numbered_in_natural_order(root):
    dataset = vpr_bench(root=str(root))
    assert reds(dataset.queries) == reds(dataset.references) == [*range(11)]
    assert dataset.references.names[2] == "2.jpg"
    assert rights(dataset) == [[0, 1], [1, 2], [2, 3], [3, 4], [4, 5], [5, 6], [6, 7], [7, 8], [8, 9], [9, 10], [10]]


def test_a_csv_says_the_same(root):
    rows = "".join(f"{query},{query} {min(query + 1, 10)}\n" for query in range(10))
    (root / "ground_truth.csv").write_text(f"query,matching_refs\n{rows}10,\n")
    from_pickle = vpr_bench(root=str(root))
    (root / "ground_truth_new.npy").unlink()
    from_csv = vpr_bench(root=str(root))
    assert rights(from_csv) == [*rights(from_pickle)[:10], []]
    assert from_csv.protocol["ground_truth"] == "ground_truth.csv"
    assert "1 of 11 queries have no right reference in ground_truth.csv" in from_csv.notes[0]


OWN = [[query] for query in range(11)]


@pytest.mark.parametrize(
    ("rights_of", "told"),
    [
        ([*OWN[:10], [10, 11]], "names reference 11 for query 10, but ref/ holds 11 images"),
        ([*OWN, [0]], "names query 11, but query/ holds 11 images"),
        (OWN[:9], "no row for 2 of 11 queries (first: query 9)"),
        *(([*OWN[:10], bad], "row 10 of ") for bad in (5, [0.5], [True])),
        *(([*OWN[:10], bad], "a number") for bad in ([[1]], "1")),
    ],
)
def test_numbers_that_do_not_fit_the_images_are_named(root, rights_of, told):
    stored(root, lists(*rights_of))
    message = answer(vpr_bench, root=str(root))
    assert "ground_truth_new.npy" in message
    assert told in message


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "has the columns none"),
        (b"\xef\xbb\xbf", "has the columns none"),
        (b"query,matching_refs" + b",x" * 200_000 + b"\n0,0\n", "has 200002 columns"),
        (b"query,matching_refs\n0,0,1\n", "line 2 of"),
        *((b"query,matching_refs\n0,0\n" + line, "line 3 of") for line in (b"x,1", b"1,a b", b"1", b"1,2.5")),
        (b"query,matching_refs\n0,0\n0,1\n", "two rows for query 0"),
        ("query,matching_refs\n0,1\n".encode("utf-16"), "cannot be read as a CSV"),
        (b"query,matching_refs\n0," + b"1 " * 70_000, "cannot be read as a CSV"),
    ],
)
def test_a_csv_that_is_no_table_of_queries_is_named(root, content, told):
    (root / "ground_truth.csv").write_bytes(content)
    message = answer(vpr_bench, root=str(root), ground_truth="ground_truth.csv")
    assert "ground_truth.csv" in message
    assert told in message


@pytest.mark.parametrize("gone", ["query", "ref", "ground_truth_new.npy"])
def test_what_is_missing_is_answered_with_what_the_root_should_hold(root, gone):
    (root / gone).rename(root / "away")
    message = answer(vpr_bench, root=str(root), kind=NotThere)
    assert gone in message
    assert "set dataset.root to a folder with query/, ref/ and ground_truth_new.npy" in message


def test_clipped_numbers_are_left_out_and_counted(root):
    stored(root, lists(*([query - 1, query, query + 1] for query in range(11))))
    dataset = vpr_bench(root=str(root), out_of_range="clip")
    assert (rights(dataset)[0], rights(dataset)[10]) == ([0, 1], [9, 10])
    assert dataset.protocol["out_of_range_queries"] == 2
    assert "in 2 of 11 rows (first: query 0)" in dataset.notes[0]


def test_the_protocol_says_everything_that_was_selected(root):
    dataset = vpr_bench(root=str(root))
    assert dict(dataset.protocol) == {
        "protocol": "vpr_bench",
        "references": "ref",
        "queries": "query",
        "ground_truth": "ground_truth_new.npy",
        "out_of_range": "error",
        "out_of_range_queries": 0,
        "unmatched": "keep",
    }
    assert (dataset.notes, len(used(dataset))) == ((), 22)


ROWS = st.lists(st.lists(st.integers(-3, 9), max_size=5), min_size=1, max_size=6)


@quiet
@given(ROWS, st.integers(1, 8))
def test_no_number_out_of_range_passes_and_none_in_range_is_lost(rights_of, n_references):
    rows = [*enumerate(rights_of)]
    beyond = [query for query, right in rows if any(not 0 <= number < n_references for number in right)]
    clipped, corrected = in_range("it", rows, len(rows), n_references, "clip")
    assert clipped == [[n for n in range(n_references) if n in right] for right in rights_of]
    assert corrected == beyond
    if beyond:
        with pytest.raises(BadInput, match=f"for query {beyond[0]}, "):
            in_range("it", rows, len(rows), n_references, "error")
    else:
        assert in_range("it", rows, len(rows), n_references, "error") == (clipped, [])


@quiet
@given(st.permutations(range(6)), st.integers(0, 7), st.integers(1, 6))
def test_rows_are_taken_by_their_query_and_never_by_their_place(order, extra, n_queries):
    rows = [(query, [query]) for query in order] + [(6 + number, [0]) for number in range(extra)]
    clipped, corrected = in_range("it", rows, n_queries, 6, "clip")
    assert clipped == [[query] for query in range(n_queries)]
    assert sorted(corrected) == [*range(n_queries, 6 + extra)]


@pytest.fixture(scope="module")
def corridor():
    return registry.make_dataset(
        yaml.safe_load(registry.entries("dataset")["corridor"].path.read_text(encoding="utf-8"))
    )


@needs_real_frames
def test_the_ground_truth_of_corridor_is_two_places_to_either_side(corridor):
    assert rights(corridor) == [[n for n in range(query - 2, query + 3) if 0 <= n < 111] for query in range(111)]
    assert corridor.queries.names[7] == corridor.references.names[7] == "0000007.jpg"


@needs_real_frames
def test_the_matches_that_vpr_bench_stored_of_corridor_give_the_recalls_that_it_published(corridor):
    with (REAL / "corridor" / "vprbench_r1.csv").open(newline="") as file:
        published = {row["technique"]: float(row["recall_at_1"]) for row in csv.DictReader(file)}
    assert len(published) == 10
    with np.load(REAL / "corridor" / "vprbench_precomputed.npz", allow_pickle=False) as answers:
        for technique, recall in published.items():
            matched = answers[f"{technique}__match"]
            right = [best in right for best, right in zip(matched, corridor.positives, strict=True)]
            assert np.mean(right) == pytest.approx(recall, abs=1e-6)

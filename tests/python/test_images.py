"""A dataset of images in hand: folders, lists of files and arrays, and which of their places are right."""

import numpy as np
import pytest
from little import number_in, picture
from pandas import DataFrame
from PIL import Image as PillowImage
from scipy.sparse import bsr_array, coo_matrix, csr_array

import vprbench
from vprbench.api import BadInput, MissingData


def stack(*numbers):
    return np.stack([picture(number) for number in numbers])


def shown(dataset):
    return [number_in(image) for image in dataset.references], [number_in(image) for image in dataset.queries]


def test_a_traverse_is_a_folder_a_list_of_files_or_arrays_grey_ones_too_and_any_changed_pixel_is_another(tmp_path):
    for number in range(4):
        PillowImage.fromarray(picture(number)).save(tmp_path / f"{number}.png")
    files = sorted(tmp_path.iterdir())
    arrays = [stack(0, 1, 2, 3), list(stack(0, 1, 2, 3)), tuple(stack(0, 1, 2, 3))]
    for traverse in (tmp_path, str(tmp_path), files, list(map(str, files)), *arrays):
        one = vprbench.dataset_of(references=traverse, queries=stack(5, 6, 7, 8))
        assert shown(one) == ([0, 1, 2, 3], [5, 6, 7, 8])
        assert [right.tolist() for right in one.positives] == [[0], [1], [2], [3]]
        other = vprbench.dataset_of(references=[traverse, stack(9, 10, 11, 12)], queries=traverse)
        assert shown(other) == ([0, 1, 2, 3, 9, 10, 11, 12], [0, 1, 2, 3])
        assert other.places.tolist() == [0, 1, 2, 3, 0, 1, 2, 3]
    (tmp_path / "empty").mkdir()
    with pytest.raises(MissingData, match="queries"):
        vprbench.dataset_of(references=stack(0), queries=tmp_path / "empty")
    grey = np.arange(2 * 5 * 6, dtype=np.uint8).reshape(2, 5, 6)
    for given in (grey, list(grey)):
        made = vprbench.dataset_of(references=given, queries=given)
        assert [image.shape for image in made.references] == [(5, 6, 3)] * 2
    frames = np.zeros((40, 6, 6), np.uint8)
    changed = frames.copy()
    changed[11, 3, 3] = 1
    hashes = {vprbench.dataset_of(each, frames).references.fingerprint() for each in (frames, changed)}
    assert len(hashes) == 2
    text = repr(vprbench.dataset_of(frames, frames, name="n" * 300))
    assert (text.count("\n"), len(text)) == (0, 100)
    assert "20 places, 40 images, 20 queries" in repr(vprbench.dataset_of([frames[:20], frames[20:]], frames[:20]))


@pytest.mark.parametrize(
    ("queries", "given", "right"),
    [
        ((0, 1, 2), {"tolerance": 1}, [[0, 1], [0, 1, 2], [1, 2]]),
        ((0, 1, 2), {"positives": [2, 1, 0]}, [[2], [1], [0]]),
        ((0, 1), {"positives": [[2, 0], []]}, [[0, 2], []]),
        ((0,), {"positives": np.array([[True, False, True]])}, [[0, 2]]),
        *(
            ((0, 1, 2), {"positives": kind(np.eye(3)[::-1])}, [[2], [1], [0]])
            for kind in (np.array, np.uint8, np.int64, bsr_array, coo_matrix, DataFrame, np.matrix)
        ),
        ((0, 1), {"positives": [[1, 0, 1], [0, 0, 0]]}, [[0, 2], []]),
        ((0, 1), {"positives": np.array([[0, 1, 1], [1, 0, 0]])}, [[1, 2], [0]]),
        ((0, 1), {"positives": csr_array(([1, 1, 0], [2, 0, 1], [0, 2, 3]), (2, 3))}, [[0, 2], []]),
        ((0, 1), {"positives": np.array([[0, 1], [1, 0]])}, [[0, 1], [0, 1]]),  # narrower than the three places
        ((0, 1), {"positives": DataFrame([[0], [1]])}, [[0], [1]]),
        ((0, 1, 2), {"positives": [1, 0, 1]}, [[1], [0], [1]]),
        ((0, 1), {"positives": [[], []]}, [[], []]),
    ],
)
def test_right_places_are_those_within_the_tolerance_or_those_that_are_given(queries, given, right):
    made = vprbench.dataset_of(stack(0, 1, 2), stack(*queries), **given)
    assert [places.tolist() for places in made.positives] == right


@pytest.mark.parametrize(
    ("given", "wrong"),
    [
        ({"references": stack(0).astype(np.float32) / 255}, "float32"),
        ({"references": [picture(0), np.zeros((4, 4, 7), np.uint8)]}, "image 1"),
        ({"references": picture(0)}, "one image"),
        ({"references": 7}, "int"),
        *(({part: empty}, f"{part} .*no image") for part in ("references", "queries") for empty in ([], stack(0)[:0])),
        ({"references": [stack(0), []]}, "references .*no image"),
        ({"references": [stack(0, 1), stack(0)], "queries": stack(0, 1)}, r"2, .* 1, queries 2"),
        ({"queries": stack(0, 1, 2, 3)}, "3, queries 4"),
        ({"positives": [0, 1]}, "2 queries"),
        ({"positives": [0, 1, 5]}, "place 5"),
        ({"positives": [0, 1, "two"]}, "query 2"),
        ({"positives": np.ones((3, 2), bool)}, r"\(3, 2\)"),
        *(
            ({"queries": stack(0, 1), "positives": kind(np.eye(3, 2))}, r"\(3, 2\).*transposed.*\(2, 3\)")
            for kind in (np.array, np.int64, np.bool, csr_array)
        ),
        ({"positives": np.ones((3, 4), int)}, r"\(3, 4\)"),
        ({"positives": csr_array(2 * np.eye(3))}, "other than 0 and 1"),
        ({"positives": np.eye(3) / 2}, "query 0"),
        ({"positives": {0: [0], 1: [1], 2: [2]}}, "list"),
        *(
            (
                {"references": stack(*range(n)), "queries": stack(0, 1), "positives": either},
                r"bool\).*ones\(\(2, .\), bool",
            )
            for n, either in ((2, [[0, 1], [1, 0]]), (2, np.eye(2, dtype=int)), (1, [[0], [0]]))
        ),
        ({"tolerance": -1}, "tolerance=-1"),
        ({"numbers": "binary"}, "numbers=binary"),
        ({"breaks": "some"}, "breaks=some"),
    ],
)
def test_what_is_no_image_and_what_does_not_fit_is_named(given, wrong):
    with pytest.raises(BadInput, match=wrong):
        vprbench.dataset_of(**{"references": stack(0, 1, 2), "queries": stack(0, 1, 2), **given})

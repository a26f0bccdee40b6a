"""Small pictures of a dataset: the right frame for the right place, small, written once and never half."""

import errno
import io
import logging
from dataclasses import replace

import numpy as np
import pytest
from little import Lookup, journey
from little_runs import QUICK, asked_for, table
from PIL import Image as PillowImage

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.runs import thumbnails
from vprbench.runs.get_or_run import get_or_run

FINGERPRINT = "0123456789abcdef" * 4


def plain(level, size=(20, 40)):
    """Return an image of one grey level; size is height and width."""
    return np.full((*size, 3), level, np.uint8)


def world(references, places, queries, right):
    def named(kind, arrays):
        arrays = list(arrays)
        return Images.from_arrays(arrays, [f"{kind}{i}.png" for i in range(len(arrays))])

    right = tuple(np.array(row, np.int64) for row in right)
    return Dataset("world", named("r", references), np.array(places), named("q", queries), right, {})


def two_traverses():
    """Return three places, each seen twice: at levels 10, 20, 30 and, in another order, at 110, 120, 130."""
    return world(map(plain, (20, 10, 30, 130, 110, 120)), [1, 0, 2, 2, 0, 1], map(plain, (35, 15)), [[2], [0]])


def kept(root, dataset):
    root.mkdir(exist_ok=True)
    thumbnails.save_thumbnails(root, FINGERPRINT, dataset)
    return thumbnails.load_thumbnails(root, FINGERPRINT)


def decoded(webp):
    with PillowImage.open(io.BytesIO(webp)) as picture:
        assert picture.format == "WEBP"
        return np.asarray(picture.convert("RGB"))


def path(root):
    return root / "frames" / f"{FINGERPRINT}.zip"


def test_a_place_is_shown_by_its_first_reference_image_and_queries_are_kept_in_their_order(tmp_path):
    found = kept(tmp_path, two_traverses())
    assert [decoded(frame).mean() for frame in found.references] == pytest.approx([10, 20, 30], abs=2)
    assert [decoded(frame).mean() for frame in found.queries] == pytest.approx([35, 15], abs=2)
    assert (found.reference_names, found.query_names) == (("r1.png", "r0.png", "r2.png"), ("q0.png", "q1.png"))


@pytest.mark.parametrize(("size", "small"), [((360, 640), (54, 96)), ((640, 360), (96, 54)), ((20, 40), (20, 40))])
def test_the_longest_side_has_at_most_96_pixels_and_none_is_enlarged(tmp_path, size, small):
    red = plain(0, size)
    red[..., 0] = 200
    found = kept(tmp_path, world([red], [0], [red], [[0]]))
    assert decoded(found.queries[0]).shape[:2] == decoded(found.references[0]).shape[:2] == small
    assert decoded(found.queries[0]).mean((0, 1)) == pytest.approx([200, 0, 0], abs=8)


def test_of_a_large_dataset_the_frames_are_kept_that_a_run_shows_first_and_a_few_of_each_further_one(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(thumbnails, "_MOST", 8)
    monkeypatch.setattr(thumbnails, "_OF_FURTHER_RUN", 3)
    large = world(map(plain, range(30)), range(30), [plain(9)] * 20, [[i] for i in range(20)])
    shown = [(7, {1, 2}), (3, {2, 5}), (4, {1}), (0, {8, 9}), (1, {1})]
    thumbnails.save_thumbnails(tmp_path, FINGERPRINT, large, shown)
    thumbnails.save_thumbnails(tmp_path, FINGERPRINT, large, [(8, {1, 20}), (9, {21})])
    found = thumbnails.load_thumbnails(tmp_path, FINGERPRINT)
    assert (len(found.query_names), len(found.reference_names)) == (20, 30)
    kept = tuple([i for i, frame in enumerate(frames) if frame] for frames in (found.queries, found.references))
    assert kept == ([3, 4, 7, 8], [1, 2, 5, 20])
    assert decoded(found.references[5]).mean() == pytest.approx(5, abs=2)


def test_four_queries_that_have_a_right_place_are_examples_beside_it_exactly_and_no_larger_than_640_pixels(tmp_path):
    random = np.random.default_rng(0)
    one, other, unseen, query = random.integers(0, 256, (4, 30, 50, 3), dtype=np.uint8)
    (example,) = kept(tmp_path, world([one, other], [1, 0], [unseen, query], [[], [0]])).examples
    assert (example.query, example.place) == (1, 0)
    assert np.array_equal(example.query_image, query)
    assert np.array_equal(example.reference_image, other)
    (large,) = kept(tmp_path / "large", world([plain(1, (400, 1280))], [0], [plain(2)], [[0]])).examples
    assert large.reference_image.shape == (200, 640, 3)
    right = [[], *([i] for i in range(1, 8)), [], []]
    found = kept(tmp_path / "many", world([plain(1)] * 10, range(10), [plain(2)] * 10, right))
    assert [(one.query, one.place) for one in found.examples] == [(1, 1), (3, 3), (5, 5), (7, 7)]


def test_what_is_kept_already_is_not_read_again(tmp_path):
    thumbnails.save_thumbnails(tmp_path, FINGERPRINT, two_traverses(), iter([(1, {0})]))
    found = thumbnails.load_thumbnails(tmp_path, FINGERPRINT)
    assert all([*found.queries, *found.references])  # a small dataset is kept whole
    assert [*(tmp_path / "frames").iterdir()] == [path(tmp_path)]
    unread = Images(lambda _: pytest.fail("an image was read"), ["a", "b"])
    thumbnails.save_thumbnails(
        tmp_path, FINGERPRINT, Dataset("world", unread, np.arange(2), unread, (np.array([0]),) * 2, {})
    )


@pytest.mark.parametrize(
    "spoil",
    [
        lambda whole: whole[: len(whole) // 2],
        lambda whole: whole[: (n := whole.index(b"queries/0") + 60)] + bytes([whole[n] ^ 4]) + whole[n + 1 :],
    ],
    ids=["cut", "another bit"],
)
def test_a_damaged_file_is_none_and_named_and_made_anew(tmp_path, spoil, caplog):
    assert (thumbnails.load_thumbnails(tmp_path, FINGERPRINT), caplog.records) == (None, [])
    kept(tmp_path, two_traverses())
    path(tmp_path).write_bytes(spoil(path(tmp_path).read_bytes()))
    assert thumbnails.load_thumbnails(tmp_path, FINGERPRINT) is None
    (record,) = caplog.records
    assert (record.levelno, str(path(tmp_path)) in record.getMessage()) == (logging.WARNING, True)
    assert kept(tmp_path, two_traverses()).query_names == ("q0.png", "q1.png")


@pytest.mark.usefixtures("surroundings")
def test_a_run_makes_the_frames_that_are_missing_and_asked_for_and_is_not_lost_where_the_disk_refuses_them(
    store, monkeypatch, caplog
):
    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    def frames(seed=0, **settings):
        asked = {"seed": seed, "frames": True, **settings}
        get_or_run(asked_for(Lookup(table(6, 4)), journey(6, 4), replace(QUICK, rates=False), **asked), store)
        return list((store.root / "frames").glob("*.zip"))

    (first,) = frames()
    first.unlink()
    assert frames(frames=False) == []
    assert frames() == [first]
    monkeypatch.setattr(thumbnails, "save_thumbnails", refuse)
    frames(seed=1)
    assert "(No space left on device)" in caplog.text
    assert len([*store.runs()]) == 2

"""Images are read when looked at, in order, a bounded number ahead, and a bad file is named."""

import tempfile
import threading
from concurrent import futures
from pathlib import Path

import numpy as np
import pytest
from described_images import image
from PIL import Image as PillowImage
from stopped_clock import Clock, ReadersThatWait

from vprbench.api import images
from vprbench.api.images import Images
from vprbench.errors import BadInput

PATIENCE = 120  # seconds for what takes none unless something is broken


class Reader:
    """Counts what is read; image i is a 2 x 3 frame of level i, for which `reading(i)` is done first."""

    def __init__(self, reading=lambda i: None):
        self.reading = reading
        self.read = []
        self.threads = set()

    def __call__(self, i):
        self.read.append(i)
        self.threads.add(threading.get_ident())
        self.reading(i)
        return np.full((2, 3, 3), i % 256, np.uint8)

    def images(self, n):
        return Images(self, [f"frame {i}" for i in range(n)])


def levels(images):
    return [int(each[0, 0, 0]) for each in images]


def save(path, pixels, **options):
    PillowImage.fromarray(pixels).save(path, **options)
    return path


def test_a_view_holds_the_chosen_images_under_their_names_reads_nothing_yet_and_an_index_reads_one_image():
    reader = Reader()
    whole = reader.images(20)
    for index, chosen in (
        (slice(3, 6), [3, 4, 5]),
        (slice(None, None, -7), [19, 12, 5]),
        (slice(18, 40), [18, 19]),
        (slice(5, 5), []),
        (np.array([4, 2, 4]), [4, 2, 4]),
        (np.array([-1, 0]), [19, 0]),
        (np.arange(20) > 17, [18, 19]),
    ):
        reader.read.clear()
        view = whole[index]
        backwards = view[::-1]
        assert reader.read == []
        assert levels(view) == levels(backwards)[::-1] == chosen
        assert view.names == tuple(f"frame {i}" for i in chosen)
    reader.read.clear()
    assert [whole[index][0, 0, 0] for index in (-1, -20, np.int64(3), np.int64(-2))] == [19, 0, 3, 18]
    assert reader.read == [19, 0, 3, 18]
    for index in (20, -21, np.int64(20)):
        with pytest.raises(IndexError, match=f"{index} of 20"):
            whole[index]


@pytest.mark.parametrize("n", [0, 1, 2, 137])
def test_each_iteration_reads_every_image_once_in_other_threads(n):
    reader = Reader()
    images = reader.images(n)
    for turn in (1, 2):
        assert levels(images) == list(range(n))
        assert sorted(reader.read) == sorted([*range(n)] * turn)
    assert n < 2 or threading.get_ident() not in reader.threads  # a single image is read by the caller


@pytest.mark.parametrize("looked_at", [1, 500])
def test_a_bounded_number_is_read_ahead_and_leaving_early_ends_the_reading(looked_at, monkeypatch):
    class Watched(futures.ThreadPoolExecutor):
        def submit(self, *arguments):
            chunks.append(super().submit(*arguments))
            return chunks[-1]

    monkeypatch.setattr(images, "ThreadPoolExecutor", Watched)
    chunks, reader = [], Reader()
    iterator = iter(reader.images(5000))
    for _ in range(looked_at):
        next(iterator)
    assert not futures.wait(chunks, PATIENCE).not_done
    assert looked_at < len(reader.read) <= looked_at + 150
    iterator.close()
    assert all(chunk.done() for chunk in chunks)
    assert len(reader.read) <= looked_at + 150


@pytest.mark.parametrize(("n", "sizes"), [(7, [3, 3, 1]), (6, [3, 3]), (0, [])])
def test_blocks_hold_the_images_in_order_under_their_names_decoded_already_of_so_many_bytes(n, sizes):
    reader = Reader()
    blocks = list(reader.images(n).blocks(3))
    assert [len(block) for block in blocks] == sizes
    assert [level for block in blocks for level in levels(block)] == list(range(n))
    assert [name for block in blocks for name in block.names] == [f"frame {i}" for i in range(n)]
    assert len(reader.read) == n
    widths = [1, 1, 30, 3, 4, 3, 10, 11, 1]  # pixels; ten of them are 30 bytes
    whole = Images(lambda i: np.zeros((1, widths[i], 3), np.uint8), [str(i) for i in range(len(widths))])
    blocks = [[each.shape[1] for each in block] for block in whole.blocks(3, 30)]
    assert blocks == [[1, 1], [30], [3, 4, 3], [10], [11], [1]]


def test_in_memory_reads_every_image_once_and_views_share_the_reading_time_of_the_whole(monkeypatch):
    reader = Reader()
    decoded = reader.images(20).in_memory()
    assert levels(decoded) == levels(decoded) == list(range(20))
    assert sorted(reader.read) == list(range(20))
    reader.images(1000).fingerprint()
    assert len(reader.read) == 20 + 16
    assert Images.from_arrays([]).fingerprint() == Images.from_files([]).fingerprint()
    clock = Clock()
    clock.replaces_those_of([images], monkeypatch)
    monkeypatch.setattr(images, "ThreadPoolExecutor", ReadersThatWait)
    whole = Reader(lambda i: clock.spend(1)).images(20)
    whole[5:10][2]
    list(whole[::2])
    assert whole.reading.seconds == whole[3:4].reading.seconds == 11


def test_files_keep_their_own_sizes_errors_name_their_path_and_the_fingerprint_decodes_nothing(tmp_path):
    sizes = [(4, 6), (7, 3), *[(1, 1)] * 118]
    paths = [save(tmp_path / f"{i:03}.png", image(*size)) for i, size in enumerate(sizes)]
    images = Images.from_files(paths)
    assert [each.shape for each in images] == [(*size, 3) for size in sizes]
    assert images.names[:2] == ("000.png", "001.png")
    paths[117].write_bytes(b"")
    with pytest.raises(BadInput, match=str(paths[117])):
        list(Images.from_files(paths))
    with pytest.raises(BadInput, match=str(paths[117])):
        next(iter(Images.from_files(paths[117:])))
    (tmp_path / "a.png").write_text("no image")
    assert Images.from_files([tmp_path / "a.png"]).fingerprint()
    with pytest.raises(BadInput, match=str(tmp_path / "b.png")):
        Images.from_files([tmp_path / "a.png", tmp_path / "b.png"]).fingerprint()


@pytest.mark.parametrize(("shape", "kind"), [((3, 4, 3), "f8"), ((3, 4, 2), "u1"), ((4,), "u1"), ((3, 4), "f8")])
def test_grey_arrays_are_repeated_in_three_channels_alpha_is_dropped_and_what_is_no_image_refused(shape, kind):
    assert Images.from_arrays([np.array([[1, 2]], np.uint8)])[0].tolist() == [[[1, 1, 1], [2, 2, 2]]]
    assert Images.from_arrays([np.full((2, 2, 4), 9, np.uint8)])[0].shape == (2, 2, 3)
    array = np.zeros(shape, kind)
    with pytest.raises(BadInput, match=str(array.dtype)) as error:
        Images.from_arrays([array])
    assert str(shape) in str(error.value)
    with pytest.raises(BadInput, match="1 images came with 2 names"):
        Images.from_arrays([image(2, 2)], ["a", "b"])


@pytest.mark.parametrize("kind", ["arrays", "rendered", "files"])
def test_the_fingerprint_changes_with_images_names_and_order_and_else_stays(kind, tmp_path):
    def wrap(arrays, names):
        if kind == "arrays":
            return Images.from_arrays(arrays, names)
        if kind == "rendered":
            return Images(arrays.__getitem__, list(names))
        folder = Path(tempfile.mkdtemp(dir=tmp_path))
        options = {"format": "PNG", "compress_level": 0}  # files of one size
        return Images.from_files([save(folder / name, a, **options) for name, a in zip(names, arrays, strict=True)])

    whole = wrap(ARRAYS, "abc")
    assert whole.fingerprint() == wrap([array.copy() for array in ARRAYS], "abc").fingerprint()
    assert whole[1:].fingerprint() == wrap(ARRAYS[1:], "bc").fingerprint()
    others = [
        *((ARRAYS, "abd"), (ARRAYS, "acb"), (ARRAYS[::-1], "abc"), (ARRAYS[:2], "ab")),
        ([ARRAYS[0], ALTERED, ARRAYS[2]], "abc"),
        ([ARRAYS[0], ARRAYS[1].reshape(32, 128, 3), ARRAYS[2]], "abc"),
    ]
    assert whole.fingerprint() not in [wrap(*other).fingerprint() for other in others]


ARRAYS = [image(64, 64, seed) for seed in range(3)]
ALTERED = ARRAYS[1].copy()
ALTERED[32, 32, 0] ^= 1

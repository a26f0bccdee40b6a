"""Images are read when looked at, in order, a bounded number ahead, and a bad file is named."""

import tempfile
import threading
from concurrent import futures
from pathlib import Path

import numpy as np
import pytest
from PIL import EpsImagePlugin
from PIL import Image as PillowImage
from png_files import png_of, saved
from stopped_clock import Clock, ReadersThatWait

from vprbench.api import images, read_ahead
from vprbench.api.decoding import read_image
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


@pytest.fixture
def chunks(monkeypatch):
    """The chunks of images that threads were asked to read."""
    asked = []

    class Watched(futures.ThreadPoolExecutor):
        def submit(self, *arguments):
            asked.append(super().submit(*arguments))
            return asked[-1]

    monkeypatch.setattr(images, "ThreadPoolExecutor", Watched)
    return asked


def wait_until_idle(chunks):
    assert not futures.wait(chunks, PATIENCE).not_done


def levels(images):
    return [int(image[0, 0, 0]) for image in images]


def noise(height, width, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def save(path, pixels, **options):
    PillowImage.fromarray(pixels).save(path, **options)
    return path


def answer(call):
    with pytest.raises(BadInput) as error:
        call()
    return str(error.value)


def test_nothing_is_read_until_an_image_is_looked_at_and_then_that_one_alone():
    reader = Reader()
    images = reader.images(20)
    for index in (slice(3, 9), slice(None, None, -1), np.array([4, 2]), np.arange(20) > 15):
        _ = images[index]
    assert len(images) == 20
    assert images.names[7] == "frame 7"
    assert reader.read == []
    _ = images[7]
    assert reader.read == [7]


@pytest.mark.parametrize(
    ("index", "chosen"),
    [
        (slice(3, 6), [3, 4, 5]),
        (slice(None, None, -7), [19, 12, 5]),
        (slice(18, 40), [18, 19]),
        (slice(5, 5), []),
        (np.array([4, 2, 4]), [4, 2, 4]),
        (np.array([-1, 0]), [19, 0]),
        (np.arange(20) > 17, [18, 19]),
    ],
)
def test_a_view_holds_the_chosen_images_under_their_names_and_so_does_its_view(index, chosen):
    view = Reader().images(20)[index]
    assert levels(view) == levels(view[::-1])[::-1] == chosen
    assert view.names == tuple(f"frame {i}" for i in chosen)


@pytest.mark.parametrize(("index", "level"), [(-1, 19), (-20, 0), (np.int64(3), 3), (np.int64(-2), 18)])
def test_an_index_counts_from_either_end(index, level):
    assert Reader().images(20)[index][0, 0, 0] == level


@pytest.mark.parametrize("index", [20, -21, np.int64(20)])
def test_an_index_outside_raises_index_error_with_the_length(index):
    with pytest.raises(IndexError, match=f"{index} of 20"):
        Reader().images(20)[index]


def test_images_come_in_order_however_long_each_takes_to_read(monkeypatch):
    monkeypatch.setattr(images, "_READERS", 2)
    size, n = read_ahead.CHUNK, 152
    last_read = [threading.Event() for _ in range(n // size)]
    ended = []

    def read(i):
        chunk, place = divmod(i, size)
        if chunk % 2 == 0 and place == 0:
            assert last_read[chunk + 1].wait(PATIENCE)
        if place == size - 1:
            ended.append(chunk)
            last_read[chunk].set()

    assert levels(Reader(read).images(n)) == list(range(n))
    assert all(ended.index(chunk + 1) < ended.index(chunk) for chunk in range(0, n // size, 2))


@pytest.mark.parametrize("n", [0, 1, 2, 8, 9, 137])
def test_each_iteration_reads_every_image_once_in_other_threads(n):
    reader = Reader()
    images = reader.images(n)
    for turn in (1, 2):
        assert levels(images) == list(range(n))
        assert sorted(reader.read) == sorted([*range(n)] * turn)
    assert n < 2 or threading.get_ident() not in reader.threads  # a single image is read by the caller


@pytest.mark.parametrize("looked_at", [1, 500])
def test_reading_goes_on_while_the_caller_works_but_a_bounded_number_ahead(looked_at, chunks):
    reader = Reader()
    iterator = iter(reader.images(5000))
    for _ in range(looked_at):
        next(iterator)
    wait_until_idle(chunks)
    assert looked_at + 7 < len(reader.read) <= looked_at + 150
    iterator.close()


def test_leaving_an_iteration_early_ends_the_reading(chunks):
    reader = Reader()
    for _image in reader.images(100_000):
        break
    assert all(chunk.done() for chunk in chunks)
    assert 0 < len(reader.read) < 200


@pytest.mark.parametrize(("n", "sizes"), [(7, [3, 3, 1]), (6, [3, 3]), (2, [2]), (0, [])])
def test_blocks_hold_the_images_in_order_under_their_names_decoded_already(n, sizes):
    reader = Reader()
    blocks = list(reader.images(n).blocks(3))
    assert [len(block) for block in blocks] == sizes
    assert [level for block in blocks for level in levels(block)] == list(range(n))
    assert [name for block in blocks for name in block.names] == [f"frame {i}" for i in range(n)]
    assert len(reader.read) == n


def test_a_block_ends_before_its_bytes_exceed_those_asked_for_or_holds_one_image():
    sizes = [1, 1, 30, 3, 4, 3, 10, 11, 1]  # pixels; ten of them are 30 bytes
    whole = Images(lambda i: np.zeros((1, sizes[i], 3), np.uint8), [str(i) for i in range(len(sizes))])
    blocks = [[image.shape[1] for image in block] for block in whole.blocks(3, 30)]
    assert blocks == [[1, 1], [30], [3, 4, 3], [10], [11], [1]]


def test_in_memory_reads_every_image_once_and_never_again():
    reader = Reader()
    decoded = reader.images(20).in_memory()
    assert levels(decoded) == levels(decoded) == list(range(20))
    assert sorted(reader.read) == list(range(20))


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    clock.replaces_those_of([images], monkeypatch)
    return clock


def test_views_share_the_reading_time_of_the_whole(clock, monkeypatch):
    monkeypatch.setattr(images, "ThreadPoolExecutor", ReadersThatWait)
    whole = Reader(lambda i: clock.spend(1)).images(20)
    whole[5:10][2]
    list(whole[::2])
    assert whole.reading.seconds == whole[3:4].reading.seconds == 11


def test_reading_while_the_caller_works_is_no_reading_time(clock, chunks):
    caller_works = threading.Event()

    def reading(i):
        if i >= read_ahead.CHUNK:
            assert caller_works.wait(PATIENCE)
            clock.spend(1)

    whole = Reader(reading).images(1000)
    iterator = iter(whole)
    next(iterator)
    assert clock.seconds() == 0
    caller_works.set()
    wait_until_idle(chunks)
    assert clock.seconds() > 1
    iterator.close()
    assert whole.reading.seconds == 0


def test_an_error_in_a_reading_thread_reaches_the_caller_with_the_path(tmp_path):
    paths = [save(tmp_path / f"{i}.png", noise(4, 4)) for i in range(200)]
    paths[117].write_bytes(b"")
    assert str(paths[117]) in answer(lambda: list(Images.from_files(paths)))


def test_files_of_different_sizes_keep_their_own(tmp_path):
    sizes = [(4, 6), (7, 3), (1, 1)]
    images = Images.from_files([save(tmp_path / f"{i}.png", noise(*size)) for i, size in enumerate(sizes)])
    assert [image.shape for image in images] == [(*size, 3) for size in sizes]
    assert images.names == ("0.png", "1.png", "2.png")


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_an_image_of_more_pixels_than_pillow_allows_is_refused_by_name(tmp_path, monkeypatch, suffix):
    monkeypatch.setattr(PillowImage, "MAX_IMAGE_PIXELS", 100)
    fits, too_large = save(tmp_path / f"a.{suffix}", noise(10, 10)), save(tmp_path / f"b.{suffix}", noise(11, 10))
    assert read_image(fits).shape == (10, 10, 3)
    with pytest.raises(BadInput, match=rf"b\.{suffix} .*10 x 11 pixels; at most 100 "):
        read_image(too_large)


BAD_FILES = {
    "truncated PNG": lambda path: path.write_bytes(saved(noise(40, 40))[:2000]),
    "truncated JPEG": lambda path: path.write_bytes(saved(noise(40, 40), kind="JPEG")[:1000]),
    "empty file": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("frame 1 of 3\n"),
    "no file": lambda path: None,
    "folder": lambda path: path.mkdir(),
    "PNG that claims 400 million pixels": lambda path: path.write_bytes(png_of(b"\0", 20_000, 20_000)),
}


@pytest.mark.parametrize("kind", BAD_FILES)
def test_a_file_that_is_no_whole_image_is_answered_in_one_line_with_its_path(tmp_path, kind):
    path = tmp_path / "bad.png"
    BAD_FILES[kind](path)
    message = answer(lambda: read_image(path))
    assert str(path) in message
    assert "\n" not in message
    assert ("does not exist" in message) == (kind == "no file")


def test_no_image_starts_another_program(tmp_path, monkeypatch):
    started = []
    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", lambda *_, **__: started.append(True))
    (tmp_path / "frame.png").write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 4 4\n%%EndComments\nshowpage\n")
    answer(lambda: read_image(tmp_path / "frame.png"))
    assert not started


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_a_file_cut_anywhere_never_gives_other_pixels(tmp_path, suffix):
    path = save(tmp_path / f"a.{suffix}", noise(6, 5))
    whole, pixels = path.read_bytes(), read_image(path)
    for n_bytes in [*range(0, len(whole), 7), *range(len(whole) - 30, len(whole))]:
        path.write_bytes(whole[:n_bytes])
        try:
            cut = read_image(path)
        except BadInput:
            continue
        assert np.array_equal(cut, pixels), f"{n_bytes} of {len(whole)} bytes"


def test_grey_arrays_are_repeated_in_three_channels_and_alpha_is_dropped():
    image = Images.from_arrays([np.array([[1, 2]], np.uint8)])[0]
    assert image.tolist() == [[[1, 1, 1], [2, 2, 2]]]
    assert Images.from_arrays([np.full((2, 2, 4), 9, np.uint8)])[0].shape == (2, 2, 3)


@pytest.mark.parametrize(
    "array",
    [
        np.zeros((3, 4, 3)),
        np.zeros((3, 4, 2), np.uint8),
        np.zeros(4, np.uint8),
        np.zeros((1, 3, 4, 3), np.uint8),
        np.zeros((3, 4)),  # grey levels of another type
    ],
    ids=lambda array: f"{array.dtype}{array.shape}",
)
def test_an_array_that_is_no_uint8_image_is_refused_with_its_shape_and_type(array):
    message = answer(lambda: Images.from_arrays([array]))
    assert str(array.shape) in message
    assert str(array.dtype) in message


def test_the_fingerprint_of_files_decodes_nothing_and_names_a_missing_one(tmp_path):
    paths = [tmp_path / "a.png", tmp_path / "b.png"]
    paths[0].write_text("no image")
    assert Images.from_files(paths[:1]).fingerprint()
    assert str(paths[1]) in answer(lambda: Images.from_files(paths).fingerprint())


ARRAYS = [noise(64, 64, seed) for seed in range(3)]
ALTERED = ARRAYS[1].copy()
ALTERED[32, 32, 0] ^= 1


@pytest.fixture(params=["arrays", "rendered", "files"])
def wrap(request, tmp_path):
    """What makes images of arrays and names, files of one size in a new folder each time."""

    def filed(arrays, names):
        folder = Path(tempfile.mkdtemp(dir=tmp_path))
        paths = [
            save(folder / name, array, format="PNG", compress_level=0)
            for name, array in zip(names, arrays, strict=True)
        ]
        return Images.from_files(paths)

    def rendered(arrays, names):
        return Images(arrays.__getitem__, list(names))

    return {"arrays": Images.from_arrays, "rendered": rendered, "files": filed}[request.param]


def test_the_fingerprint_of_the_same_pixels_under_the_same_names_stays(wrap):
    whole = wrap(ARRAYS, "abc")
    assert whole.fingerprint() == wrap([array.copy() for array in ARRAYS], "abc").fingerprint()
    assert whole[1:].fingerprint() == wrap(ARRAYS[1:], "bc").fingerprint()


@pytest.mark.parametrize(
    ("arrays", "names"),
    [
        (ARRAYS, "abd"),
        (ARRAYS, "acb"),
        (ARRAYS[::-1], "abc"),
        (ARRAYS[:2], "ab"),
        ([ARRAYS[0], ALTERED, ARRAYS[2]], "abc"),
        ([ARRAYS[0], ARRAYS[1].reshape(32, 128, 3), ARRAYS[2]], "abc"),
    ],
    ids=["renamed", "names reordered", "reordered", "fewer", "replaced", "reshaped"],
)
def test_other_images_change_the_fingerprint(wrap, arrays, names):
    assert wrap(arrays, names).fingerprint() != wrap(ARRAYS, "abc").fingerprint()


def test_the_fingerprint_of_many_rendered_images_looks_at_sixteen():
    reader = Reader()
    reader.images(1000).fingerprint()
    assert len(reader.read) == 16


def test_no_images_have_a_fingerprint():
    assert Images.from_arrays([]).fingerprint() == Images.from_files([]).fingerprint()

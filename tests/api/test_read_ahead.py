"""Reading ahead keeps as many threads busy as there are, and holds few bytes however large the frames are."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image as PillowImage
from stopped_clock import ReadersThatWait

from vprbench.api import images, read_ahead
from vprbench.api.images import Images

FRAME = 300 * 400 * 3  # bytes
NOW, SEEN = set(), []  # images that were asked for and not yet given, now and each time more were asked for


class Waiting(ReadersThatWait):
    """Reads images when somebody waits for them."""

    def submit(self, call, start, size):
        NOW.update(range(start, start + size))
        SEEN.append(frozenset(NOW))

        def result():
            NOW.difference_update(range(start, start + size))
            return call(start, size)

        return SimpleNamespace(result=result)


@pytest.fixture
def seen(monkeypatch):
    monkeypatch.setattr(images, "ThreadPoolExecutor", Waiting)
    monkeypatch.setattr(images, "_READERS", 8)
    NOW.clear()
    SEEN.clear()
    return SEEN


def frames(folder, *sizes):
    paths = [folder / f"{number:03}.png" for number in range(len(sizes))]
    for path, (height, width) in zip(paths, sizes, strict=True):
        PillowImage.new("RGB", (width, height)).save(path)
    return paths


def test_small_frames_are_bounded_by_their_number(seen, tmp_path):
    list(Images.from_files(frames(tmp_path, (3, 4)) * 400))
    assert 2 * 8 <= max(map(len, seen)) <= 128


@pytest.mark.parametrize(("room", "together"), [(10, 10), (5, 5), (0.5, 4)])
def test_large_frames_are_bounded_by_their_bytes_from_the_first_one_on_but_not_below_four(
    seen, tmp_path, monkeypatch, room, together
):
    monkeypatch.setattr(read_ahead, "_BYTES", int(room * FRAME) + 1)
    assert len(list(Images.from_files(frames(tmp_path, (300, 400)) * 50))) == 50
    assert max(map(len, seen)) == together


def test_frames_are_held_by_the_size_of_each_whatever_the_first_was(seen, tmp_path, monkeypatch):
    monkeypatch.setattr(read_ahead, "_BYTES", 5 * FRAME)
    monkeypatch.setattr(read_ahead, "_MOST_BYTES", 8 * FRAME)
    sizes = [(3, 4), (300, 400), (900, 800), (1500, 1600)]
    kinds, n_bytes = frames(tmp_path, *sizes), [36, FRAME, 6 * FRAME, 20 * FRAME]
    order = [0, *np.random.default_rng(3).choice(4, 80, p=[0.5, 0.3, 0.15, 0.05]).tolist(), 1, 1, 1, 1, 1, 1, 1]
    shapes = [image.shape for image in Images.from_files([kinds[kind] for kind in order])]
    assert shapes == [(*sizes[kind], 3) for kind in order]
    totals = [(sum(n_bytes[order[number]] for number in under_way), len(under_way)) for under_way in seen]
    for held, count in totals:
        assert held <= 5 * FRAME or count == 1 or (held <= 8 * FRAME and count <= 4)
    assert max(held for held, count in totals if count > 4) > 4 * FRAME


@pytest.mark.parametrize("readers", [1, 8, 64])
def test_every_reading_thread_has_something_to_do(monkeypatch, readers):
    monkeypatch.setattr(images, "_READERS", readers)
    together = threading.Barrier(readers, timeout=120)  # broken unless as many threads read at the same time
    own = threading.local()

    def read(i):
        if not hasattr(own, "before"):
            own.before = True
            together.wait()
        return np.zeros((2, 2, 3), np.uint8)

    assert len(list(Images(read, [str(i) for i in range(1000)]))) == 1000


def test_a_first_file_that_cannot_be_read_is_named_when_its_turn_comes(tmp_path):
    whole, bad = frames(tmp_path, (3, 4), (3, 4))
    bad.write_text("no image")
    with pytest.raises(ValueError, match=r"001\.png"):
        next(iter(Images.from_files([bad, whole])))

"""Reading ahead keeps as many threads busy as there are, and holds few bytes however large the frames are."""

from __future__ import annotations

import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image as PillowImage
from stopped_clock import ReadersThatWait

from vprbench.api import images, read_ahead
from vprbench.api.images import Images

PATIENCE = 120  # seconds for what takes none unless something is broken
FRAME = 300 * 400 * 3  # bytes


class Waiting(ReadersThatWait):
    """Knows which images were asked for and not yet given; they are read when somebody waits for them."""

    now: ClassVar[set[int]] = set()
    seen: ClassVar[list[frozenset[int]]] = []  # the images under way, each time more were asked for
    most = 0

    def submit(self, call: Any, start: int, size: int) -> SimpleNamespace:  # type: ignore[override]
        Waiting.now |= set(range(start, start + size))
        Waiting.seen.append(frozenset(Waiting.now))
        Waiting.most = max(Waiting.most, len(Waiting.now))

        def result() -> list[npt.NDArray[np.uint8]]:
            Waiting.now -= set(range(start, start + size))
            found: list[npt.NDArray[np.uint8]] = call(start, size)
            return found

        return SimpleNamespace(result=result)


@pytest.fixture
def waiting(monkeypatch: pytest.MonkeyPatch) -> type[Waiting]:
    monkeypatch.setattr(images, "ThreadPoolExecutor", Waiting)
    monkeypatch.setattr(images, "_READERS", 8)
    Waiting.now.clear()
    Waiting.seen.clear()
    Waiting.most = 0
    return Waiting


def frames(folder: Path, sizes: list[tuple[int, int]]) -> list[Path]:
    paths = [folder / f"{number:03}.png" for number in range(len(sizes))]
    for path, (height, width) in zip(paths, sizes, strict=True):
        PillowImage.new("RGB", (width, height)).save(path)
    return paths


def test_small_frames_are_bounded_by_their_number(waiting: type[Waiting], tmp_path: Path) -> None:
    list(Images.from_files(frames(tmp_path, [(3, 4)]) * 400))
    assert 2 * 8 <= waiting.most <= 128


@pytest.mark.parametrize(("room", "together"), [(10, 10), (5, 5), (0.5, 4)])
def test_large_frames_are_bounded_by_their_bytes_from_the_first_one_on_but_not_below_four(
    waiting: type[Waiting], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: float, together: int
) -> None:
    monkeypatch.setattr(read_ahead, "_BYTES", int(room * FRAME) + 1)
    paths = frames(tmp_path, [(300, 400)])
    assert len(list(Images.from_files(paths * 50))) == 50
    assert waiting.most == together


def test_frames_are_held_by_the_size_of_each_whatever_the_first_was(
    waiting: type[Waiting], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(read_ahead, "_BYTES", 5 * FRAME)
    monkeypatch.setattr(read_ahead, "_MOST_BYTES", 8 * FRAME)
    kinds = frames(tmp_path, [(3, 4), (300, 400), (900, 800), (1500, 1600)])
    n_bytes = [36, FRAME, 6 * FRAME, 20 * FRAME]
    order = [0, *np.random.default_rng(3).choice(4, 150, p=[0.5, 0.3, 0.15, 0.05]).tolist(), 1, 1, 1, 1, 1, 1, 1]
    shapes = [image.shape for image in Images.from_files([kinds[kind] for kind in order])]
    assert shapes == [((3, 4, 3), (300, 400, 3), (900, 800, 3), (1500, 1600, 3))[kind] for kind in order]
    for under_way in waiting.seen:
        held = sum(n_bytes[order[number]] for number in under_way)
        assert held <= 5 * FRAME or len(under_way) == 1 or (held <= 8 * FRAME and len(under_way) <= 4)
    assert max(sum(n_bytes[order[number]] for number in held) for held in waiting.seen if len(held) > 4) > 4 * FRAME


@pytest.mark.parametrize("readers", [1, 2, 8, 32, 64])
def test_every_reading_thread_has_something_to_do(monkeypatch: pytest.MonkeyPatch, readers: int) -> None:
    monkeypatch.setattr(images, "_READERS", readers)
    together = threading.Barrier(readers, timeout=PATIENCE)  # broken unless as many threads read at the same time
    seen = threading.local()

    def read(i: int) -> npt.NDArray[np.uint8]:
        if not hasattr(seen, "before"):
            seen.before = True
            together.wait()
        return np.zeros((2, 2, 3), np.uint8)

    assert len(list(Images(read, [str(i) for i in range(1000)]))) == 1000


def test_a_first_file_that_cannot_be_read_is_named_when_its_turn_comes(tmp_path: Path) -> None:
    whole, bad = frames(tmp_path, [(3, 4), (3, 4)])
    bad.write_text("no image")
    iterator = iter(Images.from_files([bad, whole]))
    with pytest.raises(ValueError, match=r"001\.png"):
        next(iterator)

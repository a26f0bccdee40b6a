"""Frames that are kept are those that were made, bit for bit; a cache that is damaged or full costs time alone."""

import numpy as np
import pytest

from vprbench.api import Images, frames_kept, kept_frames

N = 300


@pytest.fixture(autouse=True)
def frames_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("VPRBENCH_FRAMES", str(tmp_path / "frames"))
    return tmp_path / "frames"


class Painter:
    """Frames of one seed, and how many were made."""

    def __init__(self, seed=0, n=N):
        self.frames = np.random.default_rng(seed).integers(0, 256, (n, 4, 5, 3), np.uint8)
        self.made = 0

    def read(self, number):
        self.made += 1
        return self.frames[number]

    def shown(self, **what):
        return kept_frames(Images(self.read, [str(i) for i in range(len(self.frames))]), {"seed": 0, **what})

    def check(self, **what):
        """Look at all frames, which are those that were made."""
        np.testing.assert_array_equal(np.stack(list(self.shown(**what))), self.frames)


def test_frames_are_made_once_and_read_in_any_order_by_all_that_ask_for_the_same_and_others_have_their_own():
    painter, other = Painter(), Painter(1)
    order = np.random.default_rng(1).permutation(N)
    images = painter.shown()
    np.testing.assert_array_equal(np.stack([images[i] for i in order]), painter.frames[order])
    for _ in range(3):
        painter.check()
        other.check(seed=1)
    assert painter.made == N + 4  # each time the first tells their size
    assert other.made == N + 3


@pytest.mark.parametrize("damage", [b"", b"short", None])
def test_a_damaged_or_missing_file_is_made_anew(frames_folder, damage):
    painter = Painter()
    painter.check()
    (first, *_) = sorted(frames_folder.rglob("*.frames"))
    content = bytearray(first.read_bytes())
    content[17] ^= 1
    first.write_bytes(content if damage is None else damage)
    for _ in range(2):
        painter.check()
    assert painter.made == N + 3 + 64


def test_nothing_is_kept_where_that_was_not_asked_for_frames_are_few_or_the_folder_refuses(frames_folder, monkeypatch):
    with frames_kept(False):
        list(Painter().shown())
    Painter(n=255).check()
    assert not frames_folder.exists()
    Painter(n=256).check()
    assert list(frames_folder.rglob("*.frames"))
    (frames_folder / "file").write_text("no folder")
    monkeypatch.setenv("VPRBENCH_FRAMES", str(frames_folder / "file"))
    Painter().check()


def test_who_was_not_read_for_longest_makes_room_and_more_than_fits_is_not_kept(frames_folder, monkeypatch):
    most = 2 * N * 60 + 100
    monkeypatch.setattr("vprbench.api.frame_cache._MOST_BYTES", most)
    for seed in range(4):
        Painter(seed).check(seed=seed)
        assert sum(file.stat().st_size for file in frames_folder.rglob("*.frames")) <= most
    for seed in (2, 3):
        newest = Painter(seed)
        newest.check(seed=seed)
        assert newest.made == 1
    monkeypatch.setattr("vprbench.api.frame_cache._MOST_BYTES", 1000)
    kept = sorted(frames_folder.rglob("*.frames"))
    Painter(5).check(seed=5)
    assert sorted(frames_folder.rglob("*.frames")) == kept

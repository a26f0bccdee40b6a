"""The benchmark of reading: every file is read once, bare loops decode what they say, and shares are those of turns."""

from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from stopped_clock import Clock, ReadersThatWait

from vprbench.api import images
from vprbench.api.decoding import read_image
from vprbench.errors import BadInput
from vprbench.plugins.options import chosen
from vprbench.progress import listening
from vprbench.speed import events, frames, measure
from vprbench.speed import files as many_files
from vprbench.speed.frames import ReadingCell, drawn, frame_files, in_own_process, reading_cell
from vprbench.speed.report import Failed, measured
from vprbench.speed.settings import QUICK, Settings
from vprbench.storage import hashes

N_FRAMES, N_FILES = 260, 5  # of quick=true


def quick_settings(*options):
    return chosen(Settings, ["quick=true", "threads=1", *options], QUICK)


@pytest.fixture
def paths(tmp_path):
    return frame_files(quick_settings(), tmp_path)


def test_as_many_files_as_were_asked_for_hold_as_many_different_frames_like_photographs(paths, tmp_path_factory):
    assert len(paths) == len(set(paths)) == N_FRAMES
    assert len({path.read_bytes() for path in paths}) == N_FILES
    assert all(path.samefile(paths[number % N_FILES]) for number, path in enumerate(paths))
    assert {read_image(path).shape for path in paths[:N_FILES]} == {(24, 40, 3)}
    large = quick_settings("frame=[360,640]", "reading_frames=2")
    few = frame_files(large, tmp_path_factory.mktemp("few"))
    assert len({path.read_bytes() for path in few}) == 2
    assert 300_000 < few[0].stat().st_size < 500_000  # of 691,200
    assert np.array_equal(read_image(few[1]), drawn(360, 640, [large.seed, 1]))


def test_every_file_is_read_ahead_once_and_some_of_them_in_bare_loops_in_every_turn(paths, monkeypatch):
    clock, turns, read = Clock(), 8, {"bare": Counter[Path](), "ahead": Counter[Path]()}
    clock.replaces_those_of([measure, images], monkeypatch)
    monkeypatch.setattr(images, "ThreadPoolExecutor", ReadersThatWait)
    monkeypatch.setattr(frames.machine, "cores", lambda: [0, 1, 2])
    for module, who in ((frames, "bare"), (images, "ahead")):

        def noted(path, who=who):
            clock.spend(0.01)
            read[who][path] += 1
            return read_image(path)

        monkeypatch.setattr(module, "read_image", noted)
    cell = reading_cell(quick_settings(), paths)
    assert read["ahead"] == Counter(paths)
    # one loop and three, and the first file before the first turn
    assert read["bare"] == Counter(paths[:1]) + Counter(dict.fromkeys(paths[:N_FILES], turns * (1 + 3)))
    assert (cell.frames, cell.files, cell.cores, cell.height, cell.width) == (N_FRAMES, N_FILES, 3, 24, 40)
    for rates in (cell.one_loop, cell.loops_at_once, cell.ahead):
        assert rates == pytest.approx([100] * turns)  # on a clock that all threads share
    assert cell.peak_memory_bytes > 0


def test_a_share_is_the_median_of_those_of_the_turns_and_a_failure_names_the_frame_and_leaves_no_files(
    monkeypatch, tmp_path
):
    with pytest.raises(BadInput, match=r"none\.png"):
        in_own_process(read_image, Path("none.png"))
    rates = [100.0, 120.0, 110.0], [390.0, 400.0, 410.0], [380.0, 480.0, 420.0]
    cell = ReadingCell(360, 640, 27_592, 300, 4, *rates, 300_000_000, 4 * 10**8)
    # 380 / 400 = 0.95, 480 / 480 = 1, 420 / 440 = 0.954...; 380 / 390 = 0.974, 480 / 400 = 1.2, 420 / 410 = 1.024
    row = ["640x360", "27,592", "4", "110", "400", "420", "0.955x", "1.02x", "300", "400"]
    assert [*cell.row().values()] == row

    def fails(*_):
        raise MemoryError("only 3 bytes are left")

    bench = SimpleNamespace(settings=quick_settings())
    monkeypatch.setattr(frames.tempfile, "tempdir", str(tmp_path))
    for name in ("in_own_process", "frame_files"):
        monkeypatch.setattr(frames, name, fails)
        told = list(measured("reading", frames.reading(bench)))
        assert told == [Failed({"frame": "40x24"}, "MemoryError: only 3 bytes are left")]
    assert not list(tmp_path.iterdir())


def test_the_second_time_hashes_are_known_and_all_is_measured(tmp_path, monkeypatch):
    monkeypatch.setenv("VPRBENCH_HASHES", "")  # which measuring sets
    monkeypatch.setattr(hashes, "time_ns", lambda: 4 * 10**18)
    hashes._shared.cache_clear()
    many_files.town(tmp_path, 1200, seed=0)
    told, cells = [], []
    for which in ("first", "second"):
        with listening(lambda stage, done: told.append(stage)):
            cells.append(many_files.files_cell(tmp_path, 1200, which))
        assert (told != []) == (which == "first")
        told.clear()
    assert [len(list((tmp_path / "database" / folder).iterdir())) for folder in ("00000", "00001")] == [1000, 200]
    for cell in cells:
        assert (len(cell.seconds), min(cell.seconds.values()) > 0) == (4, True)
        assert 0 < cell.memory_before_bytes <= cell.peak_memory_bytes


def test_an_hour_of_events_is_counted_by_the_second(tmp_path, monkeypatch):
    monkeypatch.setenv("VPRBENCH_EVENTS", "")  # which measuring sets
    pytest.importorskip("h5py", reason="extra events is not installed")
    events.write(tmp_path / "hour.h5", 100_000, seed=0)
    cell = events.events_cell(tmp_path, 100_000)
    assert 3598 <= cell.frames <= 3599  # the last second is not over
    assert cell.seconds > 0
    assert 0 < cell.memory_before_bytes <= cell.peak_memory_bytes

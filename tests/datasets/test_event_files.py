"""Event recordings give the events that were written, whatever their format, and what is none is refused by name."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from event_recordings import by_chance, joined, same, write_aedat2, write_aedat4, write_evt3
from image_folders import answer

from vprbench.datasets.readers import event_files
from vprbench.datasets.readers.event_files import events_in
from vprbench.errors import NotThere

EVENTS = by_chance(500, seconds=40.0)


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch):
    monkeypatch.setattr(event_files, "_CHUNK", 64)


def dsec(file):
    group = file.create_group("events")
    for name, column in {"t": EVENTS.t - 5_000_000, "x": EVENTS.x, "y": EVENTS.y, "p": EVENTS.p.astype("u1")}.items():
        group.create_dataset(name, data=column, chunks=(100,), compression="gzip")
    file["t_offset"] = 5_000_000


def seconds(file):
    for name, column in {"xs": EVENTS.x, "ys": EVENTS.y, "ts": EVENTS.t / 1e6, "ps": EVENTS.p * 2 - 1}.items():
        file[f"davis/left/{name}"] = column
    file["davis/left/image"] = np.zeros((3, 4))


def table(file):
    rows = np.zeros(500, [("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])
    rows["x"], rows["y"], rows["p"], rows["t"] = EVENTS.x, EVENTS.y, EVENTS.p, EVENTS.t
    file["CD/events"] = rows
    file["EXT_TRIGGER/events"] = rows[:3]


def nanoseconds(file):
    file["t"] = EVENTS.t * 1000 + 1_600_000_000_000_000_000
    file["x"], file["y"], file["polarity"] = EVENTS.x, EVENTS.y, EVENTS.p


@pytest.mark.parametrize("layout", [dsec, seconds, table, nanoseconds])
def test_layouts_of_hdf5_are_found_by_name(layout, tmp_path):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "drive.h5", "w") as file:
        layout(file)
    since = 1_600_000_000_000_000 if layout is nanoseconds else 0
    assert same(joined(events_in(tmp_path / "drive.h5")), replace(EVENTS, t=EVENTS.t + since))


def test_parquet_as_brisbane_event_vpr_has_it_is_read(tmp_path):
    parquet, arrow = pytest.importorskip("pyarrow.parquet"), pytest.importorskip("pyarrow")
    columns = {"t": EVENTS.t, "x": EVENTS.x, "y": EVENTS.y, "p": EVENTS.p}
    parquet.write_table(arrow.table(columns), tmp_path / "drive.parquet")
    assert same(joined(events_in(tmp_path / "drive.parquet")), EVENTS)
    parquet.write_table(arrow.table({"t": EVENTS.t, "x": EVENTS.x}), tmp_path / "drive.parquet")
    assert "drive.parquet holds no" in answer(joined, events_in(tmp_path / "drive.parquet"))


@pytest.mark.parametrize("begin", [0, 2**31 - 10_000_000, 2**32 - 20_000_000])
def test_aedat_2_is_read_though_its_clock_wraps(begin, tmp_path):
    found = joined(events_in(write_aedat2(tmp_path / "drive.aedat", EVENTS, begin)))
    since = begin - 2**32 * (begin >= 2**31)  # its numbers are signed
    assert same(found, replace(EVENTS, t=EVENTS.t + since))


def test_aedat_4_is_read(tmp_path):
    pytest.importorskip("aedat")
    assert same(joined(events_in(write_aedat4(tmp_path / "drive.aedat4", EVENTS))), EVENTS)


def test_evt3_is_read_though_its_clock_wraps_and_its_vectors_are_events(tmp_path):
    assert same(joined(events_in(write_evt3(tmp_path / "drive.raw", EVENTS))), EVENTS)
    words = [0x8001, 0x6005, 0x0007, 0x3800 | 100, 0x4803, 0x5081]  # base 100, brighter: twelve, then eight pixels
    (tmp_path / "drive.raw").write_bytes(b"% evt 3.0\n% end\n" + np.array(words, "<u2").tobytes())
    found = joined(events_in(tmp_path / "drive.raw"))
    assert found.x.tolist() == [100, 101, 111, 112, 119]
    assert [*found.y, *found.t, *found.p] == [7] * 5 + [4096 + 5] * 5 + [True] * 5


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("drive.h5", b"neither of them", "drive.h5 cannot be read as .h5"),
        ("drive.aedat", b"neither of them", "drive.aedat begins with"),
        ("drive.raw", b"% evt 2.0\n% end\n", "drive.raw is no EVT 3.0"),
        ("drive.txt", b"", ".aedat"),
        ("gone.h5", None, "gone.h5"),
    ],
)
def test_what_is_no_recording_is_refused_by_name(name, content, told, tmp_path):
    if name == "drive.h5":
        pytest.importorskip("h5py")
    if content is None:
        assert told in answer(joined, events_in(tmp_path / name), kind=NotThere)
    else:
        (tmp_path / name).write_bytes(content)
        assert told in answer(joined, events_in(tmp_path / name))


def test_hdf5_without_events_or_its_library_is_refused(tmp_path, monkeypatch):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "drive.h5", "w") as file:
        file["events/t"] = EVENTS.t
    assert "drive.h5 holds no" in answer(joined, events_in(tmp_path / "drive.h5"))
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert "vprbench[events]" in answer(joined, events_in(tmp_path / "drive.h5"))

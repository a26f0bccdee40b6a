"""Events: files of any format, and drives placed by their logs."""

import sys
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest
from event_recordings import by_chance, joined, same, write_aedat2, write_aedat4, write_evt3
from image_folders import REAL, answer, needs_real_frames, rights

from vprbench.datasets.brisbane_events_7x7 import brisbane_events_7x7
from vprbench.datasets.event_folders import event_folders
from vprbench.datasets.event_vpr import brisbane_event_vpr, qcr_event_vpr
from vprbench.datasets.readers import event_files
from vprbench.datasets.readers.event_files import read_events
from vprbench.errors import MissingData
from vprbench.methods.sad import SAD

EVENTS = by_chance(500, seconds=40.0)


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch):
    monkeypatch.setattr(event_files, "_CHUNK", 64)


ROWS = np.zeros(500, [("x", "<u2"), ("y", "<u2"), ("p", "<i2"), ("t", "<i8")])
ROWS["x"], ROWS["y"], ROWS["p"], ROWS["t"] = EVENTS.x, EVENTS.y, EVENTS.p, EVENTS.t
X_Y, SINCE_1970 = {"x": EVENTS.x, "y": EVENTS.y}, 1_600_000_000_000_000
LAYOUTS = {
    "dsec": {
        **{f"events/{name}": column for name, column in X_Y.items()},
        **{"events/t": EVENTS.t - 5_000_000, "events/p": EVENTS.p.astype("u1"), "t_offset": 5_000_000},
    },
    "seconds": {
        **{"davis/left/xs": EVENTS.x, "davis/left/ys": EVENTS.y, "davis/left/ts": EVENTS.t / 1e6},
        **{"davis/left/ps": EVENTS.p * 2 - 1, "davis/left/image": np.zeros((3, 4))},
    },
    "table": {"CD/events": ROWS, "EXT_TRIGGER/events": ROWS[:3]},
    "nanoseconds": {**X_Y, "t": (EVENTS.t + SINCE_1970) * 1000, "polarity": EVENTS.p},
}


def needed(module):
    return pytest.importorskip(module, reason="needs vprbench[events]")


def write_hdf5(file, columns):
    with needed("h5py").File(file, "w") as stored:
        for name, column in columns.items():
            stored[name] = column
    return file


@pytest.mark.parametrize("layout", LAYOUTS)
def test_layouts_of_hdf5_are_found_by_name(layout, tmp_path):
    since = SINCE_1970 if layout == "nanoseconds" else 0
    found = joined(read_events(write_hdf5(tmp_path / "drive.h5", LAYOUTS[layout])))
    assert same(found, replace(EVENTS, t=EVENTS.t + since))


def test_parquet_is_read_and_hdf5_without_events_or_its_library_refused(tmp_path, monkeypatch):
    parquet, arrow = needed("pyarrow.parquet"), needed("pyarrow")
    columns = {"t": EVENTS.t, "x": EVENTS.x, "y": EVENTS.y, "p": EVENTS.p}
    parquet.write_table(arrow.table(columns), tmp_path / "drive.parquet")
    assert same(joined(read_events(tmp_path / "drive.parquet")), EVENTS)
    parquet.write_table(arrow.table({"t": EVENTS.t, "x": EVENTS.x}), tmp_path / "drive.parquet")
    assert "drive.parquet holds no" in answer(joined, read_events(tmp_path / "drive.parquet"))
    file = write_hdf5(tmp_path / "drive.h5", {"events/t": EVENTS.t})
    assert "drive.h5 holds no" in answer(joined, read_events(file))
    monkeypatch.setitem(sys.modules, "h5py", None)
    assert "vprbench[events]" in answer(joined, read_events(file))


@pytest.mark.parametrize("begin", [0, 2**31 - 10_000_000, 2**32 - 20_000_000])
def test_aedat_2_is_read_though_its_clock_wraps(begin, tmp_path):
    found = joined(read_events(write_aedat2(tmp_path / "drive.aedat", EVENTS, begin)))
    since = begin - 2**32 * (begin >= 2**31)  # its numbers are signed
    assert same(found, replace(EVENTS, t=EVENTS.t + since))


def test_evt3_is_read_though_its_clock_wraps_and_its_vectors_are_events_and_aedat_4_too(tmp_path):
    assert same(joined(read_events(write_evt3(tmp_path / "drive.raw", EVENTS))), EVENTS)
    words = [0x8001, 0x6005, 0x0007, 0x3800 | 100, 0x4803, 0x5081]  # base 100, brighter: twelve, then eight pixels
    (tmp_path / "drive.raw").write_bytes(b"% evt 3.0\n% end\n" + np.array(words, "<u2").tobytes())
    found = joined(read_events(tmp_path / "drive.raw"))
    assert found.x.tolist() == [100, 101, 111, 112, 119]
    assert [*found.y, *found.t, *found.p] == [7] * 5 + [4096 + 5] * 5 + [True] * 5
    needed("aedat")
    assert same(joined(read_events(write_aedat4(tmp_path / "drive.aedat4", EVENTS))), EVENTS)


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("drive.h5", b"neither of them", "drive.h5 cannot be read as .h5"),
        ("drive.aedat", b"neither of them", "drive.aedat begins with"),
        ("drive.raw", b"% evt 2.0\n% end\n", "drive.raw is no EVT 3.0"),
        ("drive.txt", b"", ".aedat"),
    ],
)
def test_what_is_no_recording_is_refused_by_name(name, content, told, tmp_path):
    if name == "drive.h5":
        needed("h5py")
    (tmp_path / name).write_bytes(content)
    assert told in answer(joined, read_events(tmp_path / name))


METRES_A_DEGREE = 110_574  # of latitude, at the equator
OPTIONS = {"height": 20, "width": 30, "hot_factor": None}


@pytest.fixture(autouse=True)
def _frames(tmp_path, monkeypatch):
    monkeypatch.setenv("VPRBENCH_EVENTS", str(tmp_path / "frames"))


@pytest.fixture
def options(tmp_path):
    """A drive of 10 s in the map, and one of 7 s."""
    write_aedat2(tmp_path / "map.aedat", by_chance(4000, 1, seconds=10.0))
    write_aedat2(tmp_path / "drive.aedat", by_chance(4000, 2, seconds=7.0))
    return {"references": [str(tmp_path / "map.aedat")], "queries": str(tmp_path / "drive.aedat"), **OPTIONS}


def track(file, metres, times):
    rows = [f"{time},{metres(time) / METRES_A_DEGREE!r},0" for time in times.tolist()]
    file.with_suffix(".csv").write_text("\n".join(["time,lat,lon", *rows]) + "\n")


def test_frames_of_the_same_number_show_the_same_place_or_positions_say_what_lies_within_metres(options, tmp_path):
    dataset = event_folders(**options, window_ms=500.0, tolerance=1)
    assert (dataset.n_places, len(dataset.queries)) == (19, 13)
    assert ["13 frames" in note and "ground_truth=gps" in note for note in dataset.notes] == [True]
    assert rights(dataset)[:2] == [[0, 1], [0, 1, 2]]
    assert dataset.references[0].sum() > 0
    assert dict(dataset.protocol) == {
        **{"protocol": "event_folders", "references": ["map.aedat"], "queries": "drive.aedat", "hot_factor": None},
        **{"ground_truth": "index", "window_us": 500_000, "tolerance_places": 1, "unmatched": "error"},
    }
    by_number = event_folders(**options, events_per_frame=400)
    assert (by_number.n_places, [int(image[..., 0].sum()) for image in by_number.queries]) == (10, [400] * 10)
    assert by_number.notes == ()
    # The map is driven at 10 m/s from 5 s on, the other drive at 20 m/s; its positions begin at 6 s.
    track(tmp_path / "map.aedat", lambda time: 10 * time, np.arange(5.0, 16.0))
    track(tmp_path / "drive.aedat", lambda time: 20 * time - 60, np.arange(6.0, 13.0, 0.5))
    dataset = event_folders(**options, ground_truth="gps", radius_metres=12.0, unmatched="keep")
    t = [np.floor(5 + 1e-3) + np.arange(n) + 0.5 for n in (9, 6)]
    mapped, asked = 10 * t[0], 20 * t[1][t[1] > 6] - 60
    assert (dataset.n_places, len(dataset.queries)) == (9, 5)
    assert rights(dataset) == [np.flatnonzero(abs(mapped - metres) <= 12).tolist() for metres in asked]
    assert [len(recording.positions_us) for recording in dataset.recordings] == [11, 14]


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        ("time,lat,lon\n900,0,0\n999,0,0\n", "map.aedat run from 900.0 to"),
        ("time,lat,lon\n9,0,0\n8,0,0\n", "map.csv holds times that do not ascend"),
        ("time,lat,lon\n8,0,0\n9,inf,0\n", "map.csv holds times that do not ascend, or no numbers"),
        ("time,lat,lon\n8,-27,153\n9,0,0\n", "map.csv holds 1 positions that are none (first: 0, 0 at 9 s)"),
        ("time,lat,lon\n8,545000,4184000\n", "map.csv holds 1 positions that are none (first: 545000"),
        ("time,lat,lon\n8,x,0\n", "map.csv: "),
        ("a,b\n", "map.csv"),
    ],
)
def test_tables_that_do_not_fit_are_refused_by_name(options, tmp_path, rows, told):
    for name in ("map.csv", "drive.csv"):
        (tmp_path / name).write_text(rows)
    assert told in answer(event_folders, **options, ground_truth="gps")


def test_recordings_that_are_missing_are_named(options, tmp_path):
    assert "dataset.references" in answer(event_folders, kind=MissingData)
    assert "gone.h5" in answer(event_folders, kind=MissingData, **options | {"queries": "gone.h5"})
    assert "fetch brisbane_event_vpr" in answer(brisbane_event_vpr, kind=MissingData, root=str(tmp_path))
    write_aedat2(tmp_path / "dvs_vpr_2020-04-22-17-24-21.aedat", by_chance(40))
    write_aedat2(tmp_path / "dvs_vpr_2020-04-21-17-03-03.aedat", by_chance(40))
    assert "nmea" in answer(brisbane_event_vpr, kind=MissingData, root=str(tmp_path))
    assert "sunset" in answer(brisbane_event_vpr, root=str(tmp_path), queries="sunset3")


def sentence(kind, at, lat, fix=True):
    """Return a sentence of NMEA 0183 with its checksum, at 0 degrees of longitude."""
    clock, degrees = f"{at:%H%M%S}.00", int(lat)
    where = f"{degrees:02d}{60 * (lat - degrees):010.7f},N,00000.0000000,E"
    if kind == "RMC":
        text = f"GPRMC,{clock},{'A' if fix else 'V'},{where},0.0,0.0,{at:%d%m%y},,,A"
    else:
        text = f"GPGGA,{clock},{where},{int(fix)},08,1.0,10.0,M,0.0,M,,"
    return f"${text}*{np.bitwise_xor.reduce(np.frombuffer(text.encode(), np.uint8)):02X}\r\n"


def log(begin, seconds, metres_a_second, kinds=("RMC",)):
    """Return a log of a drive to the north that has no fix in its first two seconds, and a broken line."""
    lines = ["$GPGSV,3,1,11,03,03,111,00*74\r\n", "$GPRMC,broken\r\n"]
    for n in range(seconds):
        at = datetime.fromtimestamp(begin.timestamp() + n, UTC)
        lines += [sentence(kind, at, n * metres_a_second / METRES_A_DEGREE, fix=n >= 2) for kind in kinds]
    return "".join(lines)


@pytest.mark.parametrize("kinds", [("RMC",), ("GGA",), ("RMC", "GGA"), ("GGA", "RMC")])
def test_a_brisbane_drive_is_placed_by_its_gps_log(tmp_path, kinds):
    # The log of the camera car has a date of its own; events begin at 5 s, the logs at 3 s before midnight.
    midnight = datetime(2020, 1, 1, 23, 59, 57, tzinfo=UTC)
    for name, date, begin, seconds, speed in (
        ("sunset2", "2020-04-22-17-24-21", 1587540271.65, 12.0, 10),
        ("sunset1", "2020-04-21-17-03-03", 1587452582.35, 8.0, 20),
    ):
        (tmp_path / name).mkdir()
        events = by_chance(4000, seed=speed, seconds=seconds)
        columns = {"t": events.t * 1000 + round(begin * 1e9), "x": events.x, "y": events.y, "p": events.p}
        write_hdf5(tmp_path / name / f"dvs_vpr_{date}.hdf5", columns)
        (tmp_path / f"2020-{name}_concat.nmea").write_text(log(midnight, 15, speed, kinds))
    dataset = brisbane_event_vpr(root=str(tmp_path), **OPTIONS, radius_metres=13.0, unmatched="keep")
    mapped, asked = 10 * (5.5 + np.arange(len(dataset.places))), 20 * (5.5 + np.arange(len(dataset.queries)))
    assert (dataset.n_places, len(dataset.queries)) == (9, 7)  # until 14 s, where the log ends
    assert rights(dataset) == [np.flatnonzero(abs(mapped - metres) <= 13).tolist() for metres in asked]
    assert dataset.protocol["references"] == ["dvs_vpr_2020-04-22-17-24-21.hdf5"]


def test_a_qcr_drive_is_placed_by_the_points_that_it_passes(tmp_path):
    write_aedat2(tmp_path / "bags_2021-08-19-08-25-42_denoised.aedat", by_chance(20_000, 1, 170.0))  # normal1
    write_aedat2(tmp_path / "bags_2021-08-20-10-19-45_denoised.aedat", by_chance(20_000, 2, 70.0))  # fast2
    dataset = qcr_event_vpr(root=str(tmp_path), **OPTIONS, queries="fast2")
    # The first way begins 2 s after the first event, and both pass their fifth point after 58 and 23.7 s.
    assert dataset.n_places == 163
    at_fifth = 23  # the frame from 23 to 24 s, whose middle is 0.2 s before it: 0.2 * (31 - 58) / (12.7 - 23.7) = 0.5 s
    middle = 58 - 0.2 * 27 / 11
    right = [place for place in range(163) if abs(place + 0.5 - middle) <= 0.02 * 163]
    assert rights(dataset)[at_fifth] == right
    assert dataset.protocol["radius_percent"] == 2.0
    assert "none" in answer(qcr_event_vpr, root=str(tmp_path), queries="none")


@needs_real_frames
def test_sad_finds_76_of_724_places_of_brisbane():
    dataset = brisbane_events_7x7("brisbane", root=str(REAL / "brisbane_events_7x7"))
    assert (dataset.n_places, len(dataset.queries), sum(map(len, dataset.positives))) == (641, 724, 822)
    best = SAD(preprocessing="grey", height=7, width=7).fit(dataset.references, dataset.places).query(dataset.queries)
    found = [place in right for place, right in zip(best.argmax(axis=1), dataset.positives, strict=True)]
    assert sum(found) == 76  # 0.105 of 724, as the data's own description measured it

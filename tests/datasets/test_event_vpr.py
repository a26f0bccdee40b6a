"""Published recordings of event cameras: drives by name, and where the camera was."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from event_recordings import by_chance, write_aedat2
from image_folders import answer, rights

from vprbench.api import Events
from vprbench.datasets.event_folders import event_folders
from vprbench.datasets.event_vpr import brisbane_event_vpr, qcr_event_vpr
from vprbench.errors import NotThere

METRES_A_DEGREE = 110_574  # of latitude, at the equator
OPTIONS = {"height": 20, "width": 30, "hot_factor": None}


@pytest.fixture(autouse=True)
def _frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VPRBENCH_EVENTS", str(tmp_path / "frames"))


def write_hdf5(file: Path, events: Events, nanoseconds: int) -> None:
    """Write events whose clock of nanoseconds since 1970 is at `nanoseconds` when that of `events` is at 0."""
    h5py = pytest.importorskip("h5py", reason="h5py is not installed: pip install vprbench[events]")
    file.parent.mkdir(exist_ok=True)
    with h5py.File(file, "w") as stored:
        for name, column in (("t", events.t * 1000 + nanoseconds), ("x", events.x), ("y", events.y), ("p", events.p)):
            stored[name] = column


def write_parquet(file: Path, events: Events, microseconds: int) -> None:
    pyarrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed: pip install vprbench[events]")
    from pyarrow.parquet import write_table

    columns = {"t": events.t + microseconds, "x": events.x, "y": events.y, "p": events.p}
    write_table(pyarrow.table(columns), file)


def sentence(kind: str, at: datetime, lat: float, fix: bool = True) -> str:
    """Return a sentence of NMEA 0183 with its checksum, at 0 degrees of longitude."""
    clock, degrees = f"{at:%H%M%S}.00", int(lat)
    where = f"{degrees:02d}{60 * (lat - degrees):010.7f},N,00000.0000000,E"
    if kind == "RMC":
        text = f"GPRMC,{clock},{'A' if fix else 'V'},{where},0.0,0.0,{at:%d%m%y},,,A"
    else:
        text = f"GPGGA,{clock},{where},{int(fix)},08,1.0,10.0,M,0.0,M,,"
    return f"${text}*{np.bitwise_xor.reduce(np.frombuffer(text.encode(), np.uint8)):02X}\r\n"


def log(begin: datetime, seconds: int, metres_a_second: float, kinds: tuple[str, ...] = ("RMC",)) -> str:
    """Return a log of a drive to the north that has no fix in its first two seconds, and a broken line."""
    lines = ["$GPGSV,3,1,11,03,03,111,00*74\r\n", "$GPRMC,broken\r\n"]
    for n in range(seconds):
        at = datetime.fromtimestamp(begin.timestamp() + n, UTC)
        lines += [sentence(kind, at, n * metres_a_second / METRES_A_DEGREE, fix=n >= 2) for kind in kinds]
    return "".join(lines)


@pytest.mark.parametrize("kinds", [("RMC",), ("GGA",), ("RMC", "GGA"), ("GGA", "RMC")])
def test_a_brisbane_drive_is_placed_by_its_gps_log(tmp_path: Path, kinds: tuple[str, ...]) -> None:
    # The log of the camera car has a date of its own; events begin at 5 s, the logs at 3 s before midnight.
    begin = {"sunset2": 1587540271.65, "sunset1": 1587452582.35}
    midnight = datetime(2020, 1, 1, 23, 59, 57, tzinfo=UTC)
    for name, seconds, speed in (("sunset2", 12.0, 10), ("sunset1", 8.0, 20)):
        date = {"sunset2": "2020-04-22-17-24-21", "sunset1": "2020-04-21-17-03-03"}[name]
        events = by_chance(4000, seed=speed, seconds=seconds)
        write_hdf5(tmp_path / name / f"dvs_vpr_{date}.hdf5", events, round(begin[name] * 1e9))
        (tmp_path / f"2020-{name}_concat.nmea").write_text(log(midnight, 15, speed, kinds))
    dataset = brisbane_event_vpr(root=str(tmp_path), **OPTIONS, radius_metres=13.0, unmatched="keep")
    mapped, asked = 10 * (5.5 + np.arange(len(dataset.places))), 20 * (5.5 + np.arange(len(dataset.queries)))
    assert (dataset.n_places, len(dataset.queries)) == (9, 7)  # until 14 s, where the log ends
    assert rights(dataset) == [np.flatnonzero(abs(mapped - metres) <= 13).tolist() for metres in asked]
    assert dataset.protocol["references"] == ["dvs_vpr_2020-04-22-17-24-21.hdf5"]


def test_an_own_gps_log_is_read_on_the_clock_of_1970(tmp_path: Path) -> None:
    begin = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)
    for name in ("map", "drive"):
        write_hdf5(tmp_path / f"{name}.h5", by_chance(4000, seconds=9.0), round(begin.timestamp() * 1e9))
        (tmp_path / f"{name}.nmea").write_text(log(begin, 20, 10))
    files = {"references": [str(tmp_path / "map.h5")], "queries": str(tmp_path / "drive.h5")}
    dataset = event_folders(**files, **OPTIONS, ground_truth="gps", radius_metres=1.0)
    assert rights(dataset) == [[place] for place in range(8)]
    (tmp_path / "map.nmea").write_text(sentence("RMC", begin, 0.0, fix=False))
    assert "map.nmea" in answer(event_folders, **files, **OPTIONS, ground_truth="gps")


def test_a_qcr_drive_is_placed_by_the_points_that_it_passes(tmp_path: Path) -> None:
    stamps = {"normal1": "2021-08-19-08-25-42", "fast2": "2021-08-20-10-19-45"}
    write_parquet(tmp_path / f"bags_{stamps['normal1']}_denoised.parquet", by_chance(20_000, 1, 170.0), 10**15)
    write_parquet(tmp_path / f"bags_{stamps['fast2']}_denoised.parquet", by_chance(20_000, 2, 70.0), 10**15)
    dataset = qcr_event_vpr(root=str(tmp_path), **OPTIONS, queries="fast2")
    # The first way begins 2 s after the first event, and both pass their fifth point after 58 and 23.7 s.
    assert dataset.n_places == 163
    at_fifth = 23  # the frame from 23 to 24 s, whose middle is 0.2 s before it: 0.2 * (31 - 58) / (12.7 - 23.7) = 0.5 s
    middle = 58 - 0.2 * 27 / 11
    right = [place for place in range(163) if abs(place + 0.5 - middle) <= 0.02 * 163]
    assert rights(dataset)[at_fifth] == right
    assert dataset.protocol["radius_percent"] == 2.0
    assert "none" in answer(qcr_event_vpr, root=str(tmp_path), queries="none")


def test_what_is_missing_of_a_published_drive_is_named(tmp_path: Path) -> None:
    assert "fetch brisbane_event_vpr" in answer(brisbane_event_vpr, kind=NotThere, root=str(tmp_path))
    write_aedat2(tmp_path / "dvs_vpr_2020-04-22-17-24-21.aedat", by_chance(40))
    write_aedat2(tmp_path / "dvs_vpr_2020-04-21-17-03-03.aedat", by_chance(40))
    assert "nmea" in answer(brisbane_event_vpr, kind=NotThere, root=str(tmp_path))
    assert "sunset" in answer(brisbane_event_vpr, root=str(tmp_path), queries="sunset3")

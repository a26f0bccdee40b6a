"""Where a camera was at what time: tables, and logs of GPS receivers."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput

from .coordinates import Metres, earth_centred
from .csv_tables import read_csv

Track = tuple[npt.NDArray[np.int64], Metres]  # microseconds (n,), ascending, and positions (n, d)

_WANTED = "time (seconds on the clock of the events, ascending), lat and lon (degrees)"
_DAY_S = 86_400
_FAR_DEGREES = 5.0  # from 0, 0, farther than a drive


def track_of(recording: Path) -> Track:
    """Return the track beside a recording: of its name and `.csv`, or of its name and `.nmea`; raises BadInput."""
    table, log = (recording.with_suffix(suffix) for suffix in (".csv", ".nmea"))
    return nmea_track(log) if log.is_file() and not table.is_file() else _csv_track(table)


def _csv_track(file: Path) -> Track:
    table = read_csv(file, _WANTED)
    try:
        time, lat, lon = (np.array(table.column(name), np.float64) for name in ("time", "lat", "lon"))
    except ValueError as error:
        raise BadInput(f"{file}: {error}; wanted are {_WANTED}") from error
    if not len(time) or not (np.diff(time) > 0).all() or not np.isfinite([time, lat, lon]).all():
        raise BadInput(f"{file} holds times that do not ascend, or no numbers; wanted are {_WANTED}")
    nowhere = (lat == 0) & (lon == 0) & (np.hypot(lat, lon).max() > _FAR_DEGREES)
    if wrong := np.flatnonzero(nowhere | (np.abs(lat) > 90) | (np.abs(lon) > 180)).tolist():
        raise BadInput(
            f"{file} holds {len(wrong)} positions that are none (first: {lat[wrong[0]]:g}, {lon[wrong[0]]:g} at "
            f"{time[wrong[0]]:g} s): leave such rows out; wanted are {_WANTED}"
        )
    return np.round(time * 1e6).astype(np.int64), earth_centred(lat, lon)


def nmea_track(file: Path, begin_s: float | None = None) -> Track:
    """Return the fixes of an NMEA 0183 log, RMC and GGA, at seconds since 1970 (UTC).

    With `begin_s` its first sentence was written then, on the clock of the events. Broken sentences, those without a
    fix and second ones of one time are left out. Raises BadInput for a log without a fix.
    """
    try:
        from pynmeagps import ERR_IGNORE, NMEAReader  # type: ignore[import-untyped, unused-ignore]
    except ImportError as error:
        raise BadInput(f"{file}: {error.name} is not installed: pip install vprbench[events]") from error
    fixes: list[tuple[float, float, float]] = []
    first, day, last, dated = -1.0, 0.0, -1.0, False  # seconds; whether a date came yet
    with file.open("rb") as stored:
        for _, said in NMEAReader(stored, quitonerror=ERR_IGNORE):
            kind = getattr(said, "msgID", "")
            if kind not in ("RMC", "GGA") or not hasattr(said.time, "hour"):
                continue
            clock = (datetime.combine(datetime.min, said.time) - datetime.min).total_seconds()
            if kind == "RMC" and hasattr(said.date, "year"):
                date = datetime(said.date.year, said.date.month, said.date.day, tzinfo=UTC).timestamp()
                if not dated and first >= 0:  # GGA came before: it was of that day, or of the one before
                    ahead = date - (day + _DAY_S if day + clock < last - _DAY_S / 2 else day)
                    first, last, dated = first + ahead, last + ahead * (last >= 0), True
                    fixes = [(at + ahead, lat, lon) for at, lat, lon in fixes]
                day, dated = date, True
            elif day + clock < last - _DAY_S / 2:  # after midnight
                day += _DAY_S
            now = day + clock
            first = now if first < 0 else first
            has_fix = said.status == "A" if kind == "RMC" else said.quality > 0
            if has_fix and now > last:
                fixes.append((now, said.lat, said.lon))
                last = now
    if not fixes:
        raise BadInput(f"{file} holds no position: wanted are RMC or GGA sentences of NMEA 0183 with a fix")
    time, lat, lon = np.array(fixes, np.float64).T
    if begin_s is not None:
        time += begin_s - first
    return np.round(time * 1e6).astype(np.int64), earth_centred(lat, lon)

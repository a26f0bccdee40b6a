"""Where a camera was at what time: tables, and logs of GPS receivers."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput

from .csv_tables import read_csv
from .positions import Metres, convert_degrees

Track = tuple[npt.NDArray[np.int64], Metres]  # microseconds (n,), ascending, and positions (n, d)

_WANTED = "time (seconds on the clock of the events, ascending), lat and lon (degrees)"
_DAY_S = 86_400
_FAR_DEGREES = 5.0  # from 0, 0, farther than a drive


def read_track(recording: Path) -> Track:
    """Return the track beside a recording: of its name and `.csv`, or of its name and `.nmea`; raises BadInput."""
    file, log = (recording.with_suffix(suffix) for suffix in (".csv", ".nmea"))
    if log.is_file() and not file.is_file():
        return read_nmea_track(log)
    if not file.is_file():
        raise BadInput(f"{file} does not exist: wanted are {_WANTED}")
    table = read_csv(file, _WANTED)
    try:
        time, lat, lon = (table[name].to_numpy(np.float64) for name in ("time", "lat", "lon"))
    except (KeyError, ValueError) as error:
        raise BadInput(f"{file}: {error}; wanted are {_WANTED}") from error
    if not len(time) or not (np.diff(time) > 0).all() or not np.isfinite([time, lat, lon]).all():
        raise BadInput(f"{file} holds times that do not ascend, or no numbers; wanted are {_WANTED}")
    nowhere = (lat == 0) & (lon == 0) & (np.hypot(lat, lon).max() > _FAR_DEGREES)
    if wrong := np.flatnonzero(nowhere | (np.abs(lat) > 90) | (np.abs(lon) > 180)).tolist():
        raise BadInput(
            f"{file} holds {len(wrong)} positions that are none (first: {lat[wrong[0]]:g}, {lon[wrong[0]]:g} at "
            f"{time[wrong[0]]:g} s): leave such rows out; wanted are {_WANTED}"
        )
    return np.round(time * 1e6).astype(np.int64), convert_degrees(lat, lon)


def read_nmea_track(file: Path, begin_s: float | None = None) -> Track:
    """Return the fixes of an NMEA 0183 log, RMC and GGA, at seconds since 1970 (UTC).

    With `begin_s` its first sentence was written then, on the clock of the events. Broken sentences, those without a
    fix and second ones of one time are left out. Raises BadInput for a log without a fix, or without a date where there
    is no `begin_s`.
    """
    try:
        from pynmeagps import ERR_IGNORE, NMEAReader  # type: ignore[import-untyped, unused-ignore]
    except ImportError as error:
        raise BadInput(f"{file}: {error.name} is not installed: pip install vprbench[events]") from error
    rows: list[tuple[float, float, float, float]] = []  # second of the day, its day's first second, lat, lon
    with file.open("rb") as stored:
        for _, sentence in NMEAReader(stored, quitonerror=ERR_IGNORE):
            kind = getattr(sentence, "msgID", "")
            if kind not in ("RMC", "GGA") or not hasattr(sentence.time, "hour"):
                continue
            second = (datetime.combine(datetime.min, sentence.time) - datetime.min).total_seconds()
            date: Any = sentence.date if kind == "RMC" else None
            day = datetime(date.year, date.month, date.day, tzinfo=UTC).timestamp() if hasattr(date, "year") else np.nan
            has_fix = sentence.status == "A" if kind == "RMC" else sentence.quality > 0
            rows.append((second, day, *((sentence.lat, sentence.lon) if has_fix else (np.nan, np.nan))))
    seconds, days, lat, lon = np.array(rows, np.float64).reshape(-1, 4).T
    clock = np.unwrap(seconds, period=_DAY_S)  # a log may run past midnight
    dated = np.flatnonzero(np.isfinite(days))
    fixes = np.flatnonzero(np.isfinite(lat))
    if not len(fixes) or (begin_s is None and not len(dated)):
        raise BadInput(f"{file} holds no position: wanted are RMC or GGA sentences of NMEA 0183 with a fix, and a date")
    ahead = begin_s - clock[0] if begin_s is not None else (days + seconds - clock)[dated[0]]
    times, firsts = np.unique(clock[fixes], return_index=True)
    return np.round((times + ahead) * 1e6).astype(np.int64), convert_degrees(lat[fixes][firsts], lon[fixes][firsts])

"""Files of event cameras, read chunk by chunk: HDF5, parquet, AEDAT 2 and 4, EVT3 raw."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from vprbench.api import BadInput, Events, MissingData

_CHUNK = 1 << 20  # events
_NAMES = {
    "t": ("t", "ts", "time", "timestamp", "timestamps"),
    "x": ("x", "xs", "x_pos"),
    "y": ("y", "ys", "y_pos"),
    "p": ("p", "ps", "pol", "polarity", "polarities", "on"),
}
_LIKE = "columns or a group with " + ", ".join(names[0] for names in _NAMES.values())
_FROM_MICROS, _FROM_NANOS = 1e12, 1e17  # numbers since 1970 tell their unit


def read_events(file: Path) -> Iterator[Events]:
    """Yield the events of a file in chunks of about a million at most; its suffix chooses the reader.

    Times become microseconds: numbers with a fraction are seconds, and numbers as large as micro- or nanoseconds since
    1970 are those. Rows and columns are as stored. Raises MissingData without the file, BadInput for a file that is not
    what its suffix says, and where a library is missing.
    """
    reader = READERS.get(file.suffix.lower())
    if reader is None or not file.is_file():
        raise (MissingData if reader else BadInput)(f"{file} is no recording: give a file, {', '.join(READERS)}")
    try:
        yield from reader(file)
    except BadInput:
        raise
    except ImportError as error:
        raise BadInput(f"{file}: {error.name} is not installed: pip install vprbench[events]") from error
    except (OSError, ValueError, KeyError, RuntimeError, TypeError) as error:
        raise BadInput(f"{file} cannot be read as {file.suffix} ({str(error)[:200]!r}): convert it again") from error


def _make_events(t: Any, x: Any, y: Any, p: Any) -> Events:
    first = float(t[0]) if len(t) else 0.0
    if first >= _FROM_NANOS:
        t = t // 1000
    elif t.dtype.kind == "f" and first < _FROM_MICROS:
        t = np.round(t * 1e6)
    column, row = np.ascontiguousarray(x, np.uint16), np.ascontiguousarray(y, np.uint16)
    return Events(np.ascontiguousarray(t, np.int64), column, row, p > 0)


def _find_names(names: Iterable[str]) -> dict[str, str]:
    """Return which of the names hold t, x, y and p; fewer if some are missing."""
    known = {name.lower(): name for name in names}
    return {key: known[other] for key, others in _NAMES.items() for other in reversed(others) if other in known}


def _read_hdf5(file: Path) -> Iterator[Events]:
    import h5py

    with suppress(ImportError):
        import hdf5plugin  # noqa: F401 - Blosc, as DSEC's files want it
    with h5py.File(file) as stored:
        found: list[dict[str, Any]] = []

        def look(_: str, node: Any) -> None:
            grouped = isinstance(node, h5py.Group)  # else a table
            names = _find_names(node if grouped else node.dtype.names or ())
            if len(names) == len(_NAMES):
                found.append({key: node[name] if grouped else node.fields(name) for key, name in names.items()})

        look("", stored)
        stored.visititems(look)
        if not found:
            raise BadInput(f"{file} holds no {_LIKE}: rename what holds the events")
        columns = max(found, key=lambda columns: len(columns["t"]))
        offset = int(stored["t_offset"][()]) if "t_offset" in stored else 0  # DSEC
        for at in range(0, len(columns["t"]), _CHUNK):
            chunk = _make_events(*(columns[key][at : at + _CHUNK] for key in _NAMES))
            yield replace(chunk, t=chunk.t + offset) if offset else chunk


def _read_parquet(file: Path) -> Iterator[Events]:
    from pyarrow.parquet import ParquetFile

    with ParquetFile(file) as stored:
        names = _find_names(list(stored.schema_arrow.names))
        if len(names) < len(_NAMES):
            raise BadInput(f"{file} holds no {_LIKE}: rename its columns")
        for batch in stored.iter_batches(_CHUNK, columns=[*names.values()]):
            yield _make_events(*(batch.column(names[key]).to_numpy(zero_copy_only=False) for key in _NAMES))


def _read_aedat(file: Path) -> Iterator[Events]:
    with file.open("rb") as stored:
        version = stored.readline().strip()[:11]
        if version == b"#!AER-DAT2.":
            yield from _read_aedat2(stored)
        elif version != b"#!AER-DAT4.":
            raise BadInput(f"{file} begins with {version!r}: AEDAT 2 and 4 are read, convert it with DV")
        else:
            from aedat import Decoder

            for found in (packet["events"] for packet in Decoder(file) if "events" in packet):
                yield _make_events(*(found[name] for name in ("t", "x", "y", "on")))


def _read_aedat2(stored: BinaryIO) -> Iterator[Events]:
    """Yield the brightness changes of a DAVIS camera (docs.inivation.com, AEDAT 2.0); its 32-bit clock may wrap."""
    _read_head(stored, b"#", b"#End Of ASCII Header")
    now, last = np.int64(0), np.zeros(1, np.uint32)
    while len(words := stored.read(8 * _CHUNK)) >= 8:
        address, ticks = np.frombuffer(words, ">u4", len(words) // 8 * 2).astype(np.uint32).reshape(-1, 2).T
        t = now + np.cumsum(np.diff(ticks, prepend=last).view(np.int32), dtype=np.int64)
        now, last = t[-1], ticks[-1:]
        kept = (address & 0x80000400) == 0  # neither an image or inertia sample nor a signal from outside
        address = address[kept]
        yield _make_events(t[kept], address >> 12 & 0x3FF, address >> 22 & 0x1FF, address >> 11 & 1)


def _read_evt3(file: Path) -> Iterator[Events]:
    """Yield the events of Prophesee's EVT 3.0 (docs.prophesee.ai); its 24-bit clock may wrap.

    A word of 16 bits is a row, a column, a part of the time, or says which of the next 12 or 8 pixels sent an event;
    what it leaves open is said by the last words of the other kinds.
    """
    with file.open("rb") as stored:
        head = _read_head(stored, b"%", b"% end")
        if head and b"evt 3" not in head and b"evt3" not in head:
            raise BadInput(f"{file} is no EVT 3.0 by its head: convert it")
        last, wrapped = np.array([0x8000, 0x6000, 0x3000, 0x0000]), 0  # high and low bits of the time, column, row
        while content := stored.read(_CHUNK // 4):
            words = np.append(last, np.frombuffer(content, "<u2", len(content) // 2).astype(np.int64))
            kind, value, at = words >> 12, words & 0xFFF, np.arange(len(words))
            highs, lows, columns, rows = (
                np.maximum.accumulate(np.where(np.isin(kind, own), at, 0)) for own in ((8,), (6,), (2, 3), (0,))
            )
            high = value[highs]
            steps = np.diff(high, prepend=high[0])
            turns = wrapped + np.cumsum(steps < -0x800)
            low = np.where(lows > np.maximum.accumulate(at * (steps != 0)), value[lows], 0)  # it begins anew
            widths = 12 * (kind == 4) + 8 * (kind == 5)
            passed = np.cumsum(widths)
            column = (value[columns] & 0x7FF) + passed - passed[columns]  # behind each word
            bits = np.select([kind == 2, kind == 4, kind == 5], [1, value, value & 0xFF], 0)
            n, pixel = np.nonzero(bits[:, None] >> np.arange(12) & 1)
            t = ((turns << 24) + (high << 12) + low)[n]
            yield _make_events(t, (column - widths)[n] + pixel, (value[rows] & 0x7FF)[n], value[columns][n] >> 11)
            behind = value[columns[-1]] & 0x800 | column[-1] & 0x7FF
            last = np.array([0x8000 | high[-1], 0x6000 | low[-1], 0x3000 | behind, value[rows[-1]]])
            wrapped = turns[-1]


def _read_head(stored: BinaryIO, mark: bytes, last: bytes) -> bytes:
    """Read the lines that begin with `mark`, up to one that begins with `last`, and return them in small letters."""
    head, start = b"", stored.tell()
    while (line := stored.readline()).startswith(mark) and line.isascii() and line.endswith(b"\n"):
        head, start = head + line.lower(), stored.tell()
        if line.startswith(last):
            break
    stored.seek(start)
    return head


READERS: Mapping[str, Callable[[Path], Iterator[Events]]] = {
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), _read_hdf5),
    ".parquet": _read_parquet,
    **dict.fromkeys((".aedat", ".aedat4", ".aedat2"), _read_aedat),
    ".raw": _read_evt3,
}

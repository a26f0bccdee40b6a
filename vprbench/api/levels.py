"""How the files of a dataset are decoded: whether EXIF turns frames, and one range for levels deeper than 8 bits."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.decoding import Decoding, Exif, Levels, read_counts
from vprbench.api.heads import UPRIGHT, head_of
from vprbench.errors import BadInput
from vprbench.storage.atomic import replace_bytes
from vprbench.storage.cores import count_cores
from vprbench.storage.hashes import find_hashes_folder, hash_each_file
from vprbench.storage.paths import Paths

#: (n_files, 3): lowest and highest level, and 1 if they are floats; infinite if some are no numbers, NaN if unreadable.
Extremes = npt.NDArray[np.float64]

_BYTE: Levels = (0.0, 255.0)
_BETWEEN = ".."
_FORMAT = 1  # of what is kept
_REPORT_EVERY = 50  # files


def decoding_of(
    files: Sequence[Path], exif: Exif = "obey", levels: str | None = None, prefix: str = ""
) -> tuple[Decoding, dict[str, Any]]:
    """Return how all files of a dataset are decoded, and what of it belongs to the protocol.

    `levels` is LOW..HIGH, the levels that become 0 and 255 where files have more than 8 bits. If None, all such files
    together decide: floats of 0 to 1 or 0 to 255 and integers of 0 to 255 stand for levels of 8 bits, and
    other integers run from the lowest to the highest of any file. The protocol names `exif` if a file has a tag that
    turns it, and `levels` if a file is deeper than 8 bits; it is empty otherwise. Raises BadInput, which names the
    option after `prefix`, for levels that are no range and for files whose levels decide none.
    """
    given = None if levels is None else _parse_range(levels, f"{prefix}levels")
    distinct = Paths.of(files).distinct()
    heads = [head_of(path) for path in distinct]
    deep = np.flatnonzero([head.deep for head in heads])
    protocol: dict[str, Any] = {"exif": exif} if any(head.orientation != UPRIGHT for head in heads) else {}
    if not len(deep):
        return Decoding(exif, given), protocol
    found = given or _find_range(distinct[deep], len(deep) < len(distinct), f"{prefix}levels")
    return Decoding(exif, found), {**protocol, "levels": _format_range(found)}


def _parse_range(text: str, option: str) -> Levels:
    low, _, high = text.partition(_BETWEEN)
    with suppress(ValueError):
        levels = float(low), float(high)
        if np.isfinite(levels).all() and levels[0] < levels[1]:
            return levels
    raise BadInput(f"{option}={text}: give the lowest and the highest level as LOW..HIGH, as in 0..4095")


def _format_range(levels: Levels) -> str:
    return _BETWEEN.join(f"{level:.15g}" for level in levels)


def _find_range(files: Paths, beside_bytes: bool, option: str) -> Levels:
    """Return the range of deep files, some `beside_bytes` of 8 bits; raises BadInput if they do not decide it."""
    extremes = _load_extremes(files)
    readable = np.flatnonzero(~np.isnan(extremes[:, 0]))
    if not len(readable):  # said when they are read
        return _BYTE
    low, high, is_float = extremes[readable].T
    lowest, highest = float(low.min()), float(high.max())
    brightest = files[int(readable[high.argmax()])]
    advice = f"give {option}=LOW..HIGH, the levels that become 0 and 255"
    if is_float.any() and not is_float.all():
        raise BadInput(f"{brightest}: {int(is_float.sum())} of {len(readable)} such files hold floats: {advice}")
    if is_float.all() and lowest >= 0 and highest <= 1:
        return 0.0, 1.0
    of_one = is_float.any() and bool(((high > 0) & (high <= 1)).any())  # among others of 0 to 255
    if lowest >= 0 and highest <= _BYTE[1] and not of_one:
        return _BYTE
    if is_float.any() or beside_bytes:
        others = "other files have 8 bits" if beside_bytes else f"the files' highest are {high.min():g} to {highest:g}"
        raise BadInput(f"{brightest} has levels from {low[high.argmax()]:g} to {highest:g}, {others}: {advice}")
    return lowest, max(highest, lowest + 1)


def _load_extremes(files: Paths) -> Extremes:
    """Return the extremes of files; finding them takes a decoding, so the cache keeps them by the files' content."""
    key = hashlib.sha256(b"".join(sha256 for _, sha256 in hash_each_file(files))).hexdigest()
    path = find_hashes_folder() / f"levels-{_FORMAT}" / f"{key}.npy"
    with suppress(OSError, ValueError, EOFError):
        kept = np.load(path)
        if kept.shape == (len(files), 3):
            return np.asarray(kept, np.float64)
    extremes = _find_extremes(files)
    content = io.BytesIO()
    np.save(content, extremes)
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        replace_bytes(path, content.getvalue())
    return extremes


def _find_extremes(files: Paths) -> Extremes:
    rows = []
    with ThreadPoolExecutor(count_cores()) as readers:
        for row in readers.map(_read_extremes, files):
            rows.append(row)
            if len(rows) % _REPORT_EVERY == 0:
                progress.report("looking for the range of levels", len(rows) / len(files))
    return np.array(rows, np.float64)


def _read_extremes(path: Path) -> tuple[float, float, float]:
    try:
        counts = read_counts(path)
    except BadInput:  # said when it is read
        return np.nan, np.nan, np.nan
    if counts.dtype.kind == "f" and not np.isfinite(counts).all():
        return -np.inf, np.inf, 1.0
    return float(counts.min()), float(counts.max()), float(counts.dtype.kind == "f")

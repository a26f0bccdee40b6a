"""How the files of a dataset are decoded: whether EXIF turns frames, and one range for levels deeper than 8 bits."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from vprbench.api.decoding import UPRIGHT, Decoding, Exif, Levels, read_counts, read_head
from vprbench.errors import BadInput
from vprbench.storage.cores import count_cores
from vprbench.storage.paths import Paths

_BYTE: Levels = (0.0, 255.0)
_BETWEEN = ".."


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
    heads = [read_head(path) for path in distinct]
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
    with ThreadPoolExecutor(count_cores()) as readers:
        low, high, is_float = np.array(list(readers.map(_find_extremes, files)), np.float64).T
    readable = ~np.isnan(low)
    if not readable.any():  # read_image reports them
        return _BYTE
    lowest, highest = float(np.nanmin(low)), float(np.nanmax(high))
    floats = is_float[readable] > 0
    advice = f"give {option}=LOW..HIGH, the levels that become 0 and 255"
    found = f"{files[int(np.nanargmax(high))]} has levels up to {highest:g}, the lowest of all is {lowest:g}"
    if floats.any() and not floats.all():
        raise BadInput(f"{found}, and {floats.sum()} of {len(floats)} such files hold floats: {advice}")
    if floats.any() and lowest >= 0 and highest <= 1:
        return 0.0, 1.0
    of_one = floats.any() and bool(((high > 0) & (high <= 1)).any())  # among others of 0 to 255
    if lowest >= 0 and highest <= _BYTE[1] and not of_one:
        return _BYTE
    if floats.any() or beside_bytes:
        raise BadInput(f"{found}; other files have {'8 bits' if beside_bytes else 'other ranges'}: {advice}")
    return lowest, max(highest, lowest + 1)


def _find_extremes(path: Path) -> tuple[float, float, float]:
    """Return the lowest and the highest level of a file, and 1 for floats; infinite if some are none, NaN if unread."""
    try:
        counts = read_counts(path)
    except BadInput:  # read_image reports it
        return np.nan, np.nan, np.nan
    if counts.dtype.kind == "f" and not np.isfinite(counts).all():
        return -np.inf, np.inf, 1.0
    return float(counts.min()), float(counts.max()), float(counts.dtype.kind == "f")

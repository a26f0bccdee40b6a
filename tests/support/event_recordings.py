"""Events by chance, and recordings of them written by the rules of their formats."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vprbench.api import Events


def by_chance(n: int, seed: int = 0, seconds: float = 3.0, height: int = 20, width: int = 30) -> Events:
    """Return n events in the order of their times, which begin at 5 s."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.integers(5_000_000, 5_000_000 + round(seconds * 1e6), n))
    x, y = (rng.integers(0, most, n).astype(np.uint16) for most in (width, height))
    return Events(t, x, y, rng.random(n) < 0.5)


def in_chunks(events: Events, seed: int = 0) -> Iterator[Events]:
    """Yield the events in pieces of any length, empty ones too."""
    cuts = np.sort(np.random.default_rng(seed).integers(0, len(events.t), 7))
    pieces = (np.split(column, cuts) for column in (events.t, events.x, events.y, events.p))
    yield from (Events(*piece) for piece in zip(*pieces, strict=True))


def joined(chunks: Iterator[Events]) -> Events:
    """Return all chunks as one."""
    parts = [(chunk.t, chunk.x, chunk.y, chunk.p) for chunk in chunks]
    return Events(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def same(first: Events, second: Events) -> bool:
    pairs = ((first.t, second.t), (first.x, second.x), (first.y, second.y), (first.p, second.p))
    return all(one.dtype == other.dtype and np.array_equal(one, other) for one, other in pairs)


def write_aedat2(file: Path, events: Events, begin: int = 0) -> Path:
    """Write AEDAT 2.0 as a DAVIS does, its clock `begin` microseconds ahead; an image sample and a signal beside."""
    words = []
    for t, x, y, p in zip(*(c.tolist() for c in (events.t, events.x, events.y, events.p)), strict=True):
        words += [y << 22 | x << 12 | int(p) << 11, (t + begin) % 2**32]
    beside = [1 << 31 | 3 << 12, words[1], 1 << 10, words[1]]
    head = b"#!AER-DAT2.0\r\n# a DAVIS346\r\n"
    file.write_bytes(head + np.array([*words[:2], *beside, *words[2:]], ">u4").tobytes())
    return file


def write_evt3(file: Path, events: Events) -> Path:
    """Write EVT 3.0 with one word for each coordinate that changes; the clock of 24 bits begins with the events."""
    words, row = [], None
    last = (-1, -1)
    for t, x, y, p in zip(*(c.tolist() for c in (events.t, events.x, events.y, events.p)), strict=True):
        high, low = t >> 12 & 0xFFF, t & 0xFFF
        words += [0x8000 | high] * (high != last[0]) + [0x6000 | low] * ((high, low) != last) + [y] * (y != row)
        words.append(0x2000 | int(p) << 11 | x)
        last, row = (high, low), y
    head = b"% evt 3.0\n% format EVT3;height=720;width=1280\n% end\n"
    file.write_bytes(head + np.array(words, "<u2").tobytes())
    return file

"""Whether a PNG holds as many pixels as its header says."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator

_SIGNATURE_BYTES = 8
_HEADER = struct.Struct(">IIBBBBB")  # width, height, bits, kind of colour, compression, filter, interlacing
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
_AT_ONCE = 1 << 16  # bytes
# Adam7: first column, first row, columns apart, rows apart (PNG specification, 8.2).
_PASSES = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))


def insist_on_pixels(content: bytes) -> None:
    """Raise ValueError for a PNG whose compressed pixels come to a proper end, but before the last row.

    What is wrong in any other way is left to the decoder, which finds it. Nothing that is unpacked is kept.
    """
    chunks = _chunks(content)
    kind, header = next(chunks, (b"", memoryview(b"")))
    if kind != b"IHDR" or len(header) != _HEADER.size:
        return
    width, height, bits, colour, _, _, interlaced = _HEADER.unpack(header)
    if colour not in _CHANNELS:
        return
    wanted = _row_bytes(width, height, bits * _CHANNELS[colour], bool(interlaced))
    came, stream = 0, zlib.decompressobj()
    try:
        for kind, packed in chunks:
            for start in range(0, len(packed) if kind == b"IDAT" else 0, _AT_ONCE):
                rest: bytes | memoryview = packed[start : start + _AT_ONCE]
                while rest and not stream.eof and came < wanted:
                    came += len(stream.decompress(rest, _AT_ONCE))
                    rest = stream.unconsumed_tail
    except zlib.error:
        return
    if stream.eof and came < wanted:
        raise ValueError(f"its pixels end after {came} of {wanted} bytes")


def _chunks(content: bytes) -> Iterator[tuple[bytes, memoryview]]:
    """Yield kind and content of the chunks that are there whole."""
    view, place = memoryview(content), _SIGNATURE_BYTES
    while place + 8 <= len(content):
        length, kind = struct.unpack_from(">I4s", content, place)
        if place + 12 + length > len(content):
            return
        yield kind, view[place + 8 : place + 8 + length]
        place += 12 + length


def _row_bytes(width: int, height: int, bits: int, interlaced: bool) -> int:
    """Return the bytes of all rows, each with the one that names its filter, of pixels of so many bits."""
    total = 0
    for column, row, across, down in _PASSES if interlaced else ((0, 0, 1, 1),):
        columns, rows = len(range(column, width, across)), len(range(row, height, down))
        total += rows * (1 + (columns * bits + 7) // 8) if columns else 0
    return total

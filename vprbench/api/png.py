"""Plain, whole PNG files decoded free of the interpreter's lock; what is any other file is left to Pillow."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
from PIL import Image as PillowImage

from vprbench.api.arrays import Image
from vprbench.api.png_pixels import insist_on_pixels

SIGNATURE = b"\x89PNG\r\n\x1a\n"

_HEADER = struct.Struct(">IIBBBBB")  # width, height, bits, kind of colour, compression, filter, interlacing
_KINDS = {0, 2, 6}  # grey, colour, colour with alpha
# Chunks that change no pixel, and of which libpng has nothing to say on the terminal.
_PLAIN = {b"IDAT", b"IEND", b"pHYs", b"gAMA", b"cHRM", b"sRGB", b"cICP", b"tEXt", b"tIME"}


def decoded(content: bytes) -> Image | None:
    """Return the pixels of a PNG of 8 bits, RGB uint8 (height, width, 3); None for any file that is not plain or whole.

    Alpha is dropped and grey repeated. All checksums are compared before OpenCV, which says what it finds wrong on the
    terminal, sees the file. Raises ValueError for a PNG of any kind whose pixels end early though its checksums fit:
    Pillow would leave the rest black.
    """
    if _is_plain_and_whole(content):
        flags = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
        image = cv2.imdecode(np.frombuffer(content, np.uint8), flags)
        if image is not None:
            return np.asarray(image, np.uint8)
    insist_on_pixels(content)
    return None


def _is_plain_and_whole(content: bytes) -> bool:
    """Tell whether every chunk up to the last is there, has its checksum and is known to be harmless."""
    view = memoryview(content)
    kind, place = b"", len(SIGNATURE)
    if content[:place] != SIGNATURE:
        return False
    while kind != b"IEND":
        if place + 12 > len(content):
            return False
        length, kind = struct.unpack_from(">I4s", content, place)
        end = place + 8 + length
        if end + 4 > len(content):
            return False
        if zlib.crc32(view[place + 4 : end]) != int.from_bytes(view[end : end + 4]):
            return False
        first = place == len(SIGNATURE)
        if not (_is_plain_header(kind, content[place + 8 : end]) if first else kind in _PLAIN):
            return False
        place = end + 4
    return True


def _is_plain_header(kind: bytes, content: bytes) -> bool:
    if kind != b"IHDR" or len(content) != _HEADER.size:
        return False
    width, height, bits, colour, *ways = _HEADER.unpack(content)
    largest = PillowImage.MAX_IMAGE_PIXELS
    small = largest is None or width * height <= largest  # Pillow has a say in what is larger
    return small and bits == 8 and colour in _KINDS and not any(ways)

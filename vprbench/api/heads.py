"""What the head of an image file says: how EXIF turns its frame, and whether its levels are deeper than 8 bits."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path

from PIL import Image as PillowImage

ORIENTATION = 0x0112  # the number of the tag, EXIF 2.32 and TIFF 6.0
UPRIGHT = 1

_BITS = 258  # of each channel of a TIFF
_DEEP_MODES = ("RGB", "RGBA", "RGBX", "LA")  # in which Pillow keeps the upper 8 bits alone
_START = 4096  # bytes, which tell it of most files
_WHOLE = -1
_EXIF = b"Exif\0\0"
_JPEG, _PNG, _TIFFS = b"\xff\xd8", b"\x89PNG\r\n\x1a\n", (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_WEBP_HAS_EXIF = 0x08  # among the flags
_PNM = re.compile(rb"P[2356](?:\s+(?:#[^\n]*\n\s*)*\d+){2}\s+(?:#[^\n]*\n\s*)*(\d+)\s")  # the largest level


@dataclass(frozen=True)
class Head:
    """What is known of a file before its pixels are decoded."""

    orientation: int = UPRIGHT  # 1 to 8, of the EXIF tag; 2 to 8 turn or mirror the frame
    deep: bool = False  # whether a level has more than 8 bits


def head_of(path: Path) -> Head:
    """Return the head of an image file; that of an upright frame of 8 bits for a file that cannot be read.

    A tag counts where browsers look for it: of PNG before the pixels, of JPEG before the first scan.
    """
    try:
        for size in (_START, _WHOLE):
            with open(path, "rb", buffering=0) as file:  # noqa: PTH123 - Path.open takes as long as all the rest
                content = file.read(size)
            if content.startswith(_TIFFS):
                return _head_of_tiff(path)
            orientation = _orientation_in(content)
            if orientation is not None:
                return Head(orientation if orientation in range(1, 9) else UPRIGHT, _is_deep(content))
    except (OSError, ValueError):  # said when the frame is decoded
        pass
    return Head()


def _orientation_in(content: bytes) -> int | None:
    """Return the orientation of any file but a TIFF by its first bytes; None if it stands further behind."""
    if content.startswith(_JPEG):
        return _of_jpeg(content)
    if content.startswith(_PNG):
        return _of_png(content)
    if content[:4] == b"RIFF" and content[8:16] == b"WEBPVP8X" and content[20] & _WEBP_HAS_EXIF:
        return _of_webp(content)
    return UPRIGHT


def _is_deep(content: bytes) -> bool:
    if content.startswith(_PNG):
        return content[24:25] == b"\x10"
    found = _PNM.match(content)
    return content[:2] in (b"Pf", b"PF") or (found is not None and int(found[1]) > 255)


def _of_jpeg(content: bytes) -> int | None:
    at = 2
    while at + 4 <= len(content) and content[at] == 0xFF:
        marker, size = content[at + 1], int.from_bytes(content[at + 2 : at + 4])
        if marker in (0xDA, 0xD9):  # pixels, the end
            return UPRIGHT
        if marker == 0xE1 and content[at + 4 : at + 10] == _EXIF:
            return _of_exif(content[at + 10 : at + 2 + size])
        at += 1 if marker == 0xFF else 2 + size  # padding
    return None


def _of_png(content: bytes) -> int | None:
    at = len(_PNG)
    while at + 8 <= len(content):
        size, kind = struct.unpack_from(">I4s", content, at)
        if kind in (b"IDAT", b"IEND"):
            return UPRIGHT
        if kind == b"eXIf":
            return _of_exif(content[at + 8 : at + 8 + size])
        at += 12 + size
    return None


def _of_webp(content: bytes) -> int | None:
    at = 12
    while at + 8 <= len(content):
        kind, size = struct.unpack_from("<4sI", content, at)
        if kind == b"EXIF":
            return _of_exif(content[at + 8 : at + 8 + size].removeprefix(_EXIF))
        at += 8 + size + size % 2
    return None


def _of_exif(block: bytes) -> int | None:
    """Return the orientation in a block of EXIF, which is laid out as a TIFF; None if the block ends before it."""
    order = {b"II": "<", b"MM": ">"}.get(block[:2])
    if order is None or len(block) < 8:
        return UPRIGHT
    (first,) = struct.unpack_from(f"{order}I", block, 4)
    if first + 2 > len(block):
        return None
    (count,) = struct.unpack_from(f"{order}H", block, first)
    for at in range(first + 2, first + 2 + 12 * count, 12):
        if at + 12 > len(block):
            return None
        tag, _, _, value = struct.unpack_from(f"{order}HHIH", block, at)
        if tag == ORIENTATION:
            return int(value)
    return UPRIGHT


def _head_of_tiff(path: Path) -> Head:
    with PillowImage.open(path, formats=["TIFF"]) as image:
        tags = image.tag_v2  # type: ignore[attr-defined]
        orientation = tags.get(ORIENTATION, UPRIGHT)
        deeper = image.mode in _DEEP_MODES and max(tags.get(_BITS, (8,))) > 8
        deep = image.mode.startswith(("I", "F")) or deeper
    return Head(orientation if orientation in range(1, 9) else UPRIGHT, deep)

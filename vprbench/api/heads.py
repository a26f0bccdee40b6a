"""What the head of an image file says: how EXIF turns its frame, and whether its levels are deeper than 8 bits."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from PIL import Image as PillowImage

ORIENTATION = 0x0112  # the number of the tag, EXIF 2.32 and TIFF 6.0
UPRIGHT = 1

_BITS = 258  # of each channel of a TIFF
_DEEP_MODES = ("RGB", "RGBA", "RGBX", "LA")  # in which Pillow keeps the upper 8 bits alone
_START = 32  # bytes that tell the kind of a file
_EXIF = b"Exif\0\0"
_PNG, _TIFFS = b"\x89PNG\r\n\x1a\n", (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_PNM = re.compile(rb"P[2356](?:\s+(?:#[^\n]*\n\s*)*\d+){2}\s+(?:#[^\n]*\n\s*)*(\d+)\s")  # the largest level
_PNM_HEAD = 4096  # bytes, comments and all


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
        with path.open("rb") as file:
            start = file.read(_START)
            if start.startswith(b"\xff\xd8"):
                return Head(_orientation(_exif_of_jpeg(file)))
            if start.startswith(_PNG):
                return Head(_orientation(_exif_of_png(file)), start[24:25] == b"\x10")
            if start[:4] == b"RIFF" and start[8:16] == b"WEBPVP8X":
                return Head(_orientation(_exif_of_webp(file) if start[20:21] > b"\x07" else b""))
            if start.startswith(_TIFFS):
                return _head_of_tiff(file)
            if start[:1] == b"P":
                found = _PNM.match(start + file.read(_PNM_HEAD))
                return Head(deep=start[:2] in (b"Pf", b"PF") or (found is not None and int(found[1]) > 255))
    except (OSError, ValueError):  # said when the frame is decoded
        pass
    return Head()


def _orientation(exif: bytes) -> int:
    """Return the orientation in a block of EXIF, which is laid out as a TIFF; 1 if there is none."""
    order = {b"II": "<", b"MM": ">"}.get(exif[:2])
    if order is None or len(exif) < 8:
        return UPRIGHT
    (first,) = struct.unpack_from(f"{order}I", exif, 4)
    for at in range(first + 2, len(exif) - 11, 12):
        tag, _, _, value = struct.unpack_from(f"{order}HHIH", exif, at)
        if tag >= ORIENTATION:  # tags ascend
            return value if tag == ORIENTATION and 1 <= value <= 8 else UPRIGHT
    return UPRIGHT


def _exif_of_jpeg(file: BinaryIO) -> bytes:
    file.seek(2)
    while len(marker := file.read(4)) == 4 and marker[0] == 0xFF and marker[1] not in (0xDA, 0xD9):
        if marker[1] == 0xFF:  # padding
            file.seek(-3, 1)
            continue
        length = int.from_bytes(marker[2:]) - 2
        if marker[1] != 0xE1:
            file.seek(length, 1)
        elif (content := file.read(length)).startswith(_EXIF):
            return content[len(_EXIF) :]
    return b""


def _exif_of_png(file: BinaryIO) -> bytes:
    file.seek(len(_PNG))
    while len(start := file.read(8)) == 8 and start[4:] not in (b"IDAT", b"IEND"):
        length = int.from_bytes(start[:4])
        if start[4:] == b"eXIf":
            return file.read(length)
        file.seek(length + 4, 1)
    return b""


def _exif_of_webp(file: BinaryIO) -> bytes:
    file.seek(12)
    while len(start := file.read(8)) == 8:
        length = int.from_bytes(start[4:], "little")
        if start[:4] == b"EXIF":
            return file.read(length).removeprefix(_EXIF)
        file.seek(length + length % 2, 1)
    return b""


def _head_of_tiff(file: BinaryIO) -> Head:
    with PillowImage.open(file, formats=["TIFF"]) as image:
        tags = image.tag_v2  # type: ignore[attr-defined]
        orientation = tags.get(ORIENTATION, UPRIGHT)
        deeper = image.mode in _DEEP_MODES and max(tags.get(_BITS, (8,))) > 8
        deep = image.mode.startswith(("I", "F")) or deeper
    return Head(orientation if orientation in range(1, 9) else UPRIGHT, deep)

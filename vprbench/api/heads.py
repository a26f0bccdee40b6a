"""Image files opened with Pillow, and the facts of a file's head: how EXIF turns its frame, and whether it is deep."""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from PIL import Image as PillowImage

#: Pillow knows many more, some of which start other programs (EPS) or have no use here.
FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "WEBP", "PPM")
ORIENTATION = 0x0112  # the number of the tag, EXIF 2.32 and TIFF 6.0
UPRIGHT = 1
#: The errors by which Pillow reports a file that it cannot read.
UNREADABLE = (
    *(OSError, SyntaxError, ValueError),
    *(PillowImage.DecompressionBombError, PillowImage.DecompressionBombWarning),
)

_BITS = 258  # tag of a TIFF: the bits of each channel
_COLOUR_MODES = ("RGB", "RGBA", "RGBX", "LA")  # in which Pillow keeps the upper 8 bits alone


@dataclass(frozen=True, slots=True)  # one for each of millions of files
class Head:
    """The facts of a file that are known before its pixels are decoded."""

    orientation: int = UPRIGHT  # 1 to 8, of the EXIF tag; 2 to 8 turn or mirror the frame
    deep: bool = False  # whether a level has more than 8 bits


def open_image(path: Path) -> PillowImage.Image:
    """Open an image of one of the formats without decoding its pixels; the caller closes it.

    Raises Pillow's errors: UnidentifiedImageError, an OSError, for any other content, whatever its name.
    """
    return PillowImage.open(path, formats=FORMATS)


def head_of(path: Path) -> Head:
    """Return the head of an image file; that of an upright frame of 8 bits for a file that cannot be read."""
    try:
        with open_image(path) as image:
            return read_head(image)
    except UNREADABLE:  # read_image reports it
        return Head()


def read_head(image: PillowImage.Image) -> Head:
    """Return the head of an image that is opened and not yet loaded.

    A tag counts where browsers look for it: of PNG before the pixels, of JPEG before the first scan.
    """
    if image.format == "TIFF":
        orientation = image.tag_v2.get(ORIENTATION)  # type: ignore[attr-defined]
    else:
        exif = PillowImage.Exif()
        with suppress(SyntaxError, ValueError, struct.error):  # a damaged block turns nothing
            exif.load(image.info.get("exif", b""))
        orientation = exif.get(ORIENTATION)
    return Head(orientation if orientation in range(1, 9) else UPRIGHT, _is_deep(image))


def _is_deep(image: PillowImage.Image) -> bool:
    if image.mode.startswith(("I", "F")):
        return True
    if image.format == "TIFF":
        bits = image.tag_v2.get(_BITS, (8,))  # type: ignore[attr-defined]
        return image.mode in _COLOUR_MODES and max(bits) > 8
    tiles = image.tile if image.format in ("PNG", "PPM") else []  # type: ignore[attr-defined]
    stored = tiles[0].args if tiles else ""
    if isinstance(stored, tuple):  # of PPM: the mode, and the highest level
        return int(stored[1]) > 255
    return str(stored).endswith("16B")

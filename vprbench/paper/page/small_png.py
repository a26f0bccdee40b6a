"""Figures in a page: large ones with a palette, which takes a third of the bytes and is hardly seen."""

from __future__ import annotations

import io

from PIL import Image

_LARGE = 200_000  # bytes
_COLOURS = 256


def small_png(png: bytes) -> bytes:
    """Return a PNG as it is, or, if it is large, on white with at most 256 colours if that takes fewer bytes."""
    if len(png) <= _LARGE:
        return png
    with Image.open(io.BytesIO(png), formats=["PNG"]) as image:
        drawn = image.convert("RGBA")
    paper = Image.new("RGBA", drawn.size, "white")
    written = io.BytesIO()
    Image.alpha_composite(paper, drawn).convert("RGB").quantize(_COLOURS).save(written, "PNG", optimize=True)
    return min(png, written.getvalue(), key=len)

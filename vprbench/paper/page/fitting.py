"""Thumbnails in a page: as they are stored, or coarser if they would make it too large."""

from __future__ import annotations

import io
from collections.abc import Sequence

from PIL import Image

from vprbench.progress import report

_STEPS = ((96, 40), (96, 20), (80, 20), (64, 20), (48, 20), (32, 20), (24, 10))  # longest side in pixels, WebP quality
_SAMPLED = 50  # frames by which the size of all is estimated
_ENCLOSING = 3  # bytes of the quotes and the comma around a frame


def text_bytes(frames: Sequence[bytes]) -> int:
    """Return how many bytes frames fill in a page, in base64."""
    return sum(4 * -(-len(frame) // 3) + _ENCLOSING for frame in frames)


def fitting(frames: Sequence[bytes], most_bytes: int) -> list[bytes] | None:
    """Return the frames so that all of them fill at most `most_bytes` of a page; None if no size is small enough.

    They stay as they are where that is little enough, or else are all made coarser in the same way. An empty frame, in
    the place of an image that is not kept, stays empty.
    """
    if not frames or text_bytes(frames) <= most_bytes:
        return list(frames)
    there = [frame for frame in frames if frame]
    empty = text_bytes([b""]) * (len(frames) - len(there))
    sample = there[:: max(1, len(there) // _SAMPLED)] or [b""]
    for side, quality in _STEPS:
        estimated = text_bytes([_coarser(frame, side, quality) for frame in sample]) / len(sample) * len(there)
        if estimated + empty > most_bytes:
            continue
        made = []
        for number, frame in enumerate(frames):
            report("making frames coarser", number / len(frames))
            made.append(_coarser(frame, side, quality))
        if text_bytes(made) <= most_bytes:
            return made
    return None


def _coarser(frame: bytes, side: int, quality: int) -> bytes:
    """Return a WebP image with its longest side at most `side`, never larger in bytes than it was."""
    if not frame:
        return frame
    with Image.open(io.BytesIO(frame), formats=["WEBP"]) as image:
        small = image.convert("RGB")
    small.thumbnail((side, side))
    written = io.BytesIO()
    small.save(written, "WEBP", quality=quality, method=4)
    return min(frame, written.getvalue(), key=len)


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

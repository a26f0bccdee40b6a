"""One image file decoded: whole and as RGB, or an error that names the file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image as PillowImage

from vprbench.api import png
from vprbench.api.arrays import Image
from vprbench.api.image_formats import open_image
from vprbench.errors import BadInput

_UNREADABLE = (  # how Pillow and the reader of PNG say what a file is not
    *(OSError, SyntaxError, ValueError),
    *(PillowImage.DecompressionBombError, PillowImage.DecompressionBombWarning),
)


def read_image(path: Path) -> Image:
    """Decode one image file to RGB uint8 (height, width, 3); grey is repeated, alpha dropped, 16 bit reduced to 8.

    Raises BadInput with the path if the file is missing, truncated or no image, and, undecoded, if it has more pixels
    than `PIL.Image.MAX_IMAGE_PIXELS` (89,478,485 unless a program sets another number).
    """
    try:
        if (pixels := _decoded_png(path)) is not None:
            return pixels
        with open_image(path) as image:
            _require_size(image)
            if image.mode.startswith("I"):
                return as_rgb((np.asarray(image) >> 8).astype(np.uint8))
            if image.mode == "RGB":
                return np.asarray(image)
            # A palette with transparency has to become RGBA first.
            return np.asarray((image.convert("RGBA") if image.mode == "P" else image).convert("RGB"))
    except FileNotFoundError as error:
        raise BadInput(f"{path} does not exist: restore the file or choose other places") from error
    except _UNREADABLE as error:
        reason = str(error).replace(f" {str(path)!r}", "").replace(str(path), "it").splitlines()[0]
        raise BadInput(f"{path} cannot be read as an image ({reason}): replace the file; none is skipped") from error


def _require_size(image: PillowImage.Image) -> None:
    most = PillowImage.MAX_IMAGE_PIXELS
    if most is not None and image.width * image.height > most:
        raise ValueError(f"{image.width} x {image.height} pixels; at most {most:,} may be decoded")


def _decoded_png(path: Path) -> Image | None:
    """Return the pixels of a plain, whole PNG, which is read fastest; None for any other file."""
    with path.open("rb") as file:
        start = file.read(len(png.SIGNATURE))
        return png.decoded(start + file.read()) if start == png.SIGNATURE else None


def decoded_bytes(path: Path) -> int:
    """Return the bytes of an image once it is decoded, from the head of its file; 1 if the head cannot be read."""
    try:
        with open_image(path) as image:
            return max(1, 3 * image.width * image.height)
    except _UNREADABLE:  # said when the image is read
        return 1


def as_rgb(array: Image) -> Image:
    """Return an image as RGB, grey repeated and alpha dropped; raises BadInput for another shape or type."""
    if array.ndim == 2 and array.dtype == np.uint8:
        return np.repeat(array[:, :, None], 3, axis=2)
    if array.ndim != 3 or array.shape[2] not in (3, 4) or array.dtype != np.uint8:
        raise BadInput(
            f"an image of shape {array.shape} and type {array.dtype} came; wanted uint8 (height, width, 3), "
            "or (height, width) for grey"
        )
    return array[:, :, :3]

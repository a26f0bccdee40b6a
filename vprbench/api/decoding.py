"""One image file decoded, whole and as RGB, or an error that names the file; and which files are images at all."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image as PillowImage

from vprbench.api.arrays import Image
from vprbench.errors import BadInput

IMAGE_SUFFIXES = (
    *(".png", ".jpg", ".jpeg", ".jpe", ".jfif", ".bmp", ".tif", ".tiff", ".webp"),
    *(".ppm", ".pgm", ".pbm", ".pnm"),
)

# In small letters.
_FOLDERS_BESIDE = {"@eadir", "__macosx", "$recycle.bin", "system volume information"}
_FILES_BESIDE = {
    *("icon\r", "readme", "license", "licence", "copying", "citation", "changelog"),
    *("sha256sums", "md5sums", "checksums"),
}
_SUFFIXES_BESIDE = {
    *(".txt", ".md", ".rst", ".html", ".pdf", ".bib", ".log"),
    *(".csv", ".tsv", ".json", ".jsonl", ".geojson", ".yaml", ".yml", ".xml", ".toml", ".ini", ".cfg", ".gpx", ".kml"),
    *(".npy", ".npz", ".mat", ".pkl", ".pickle", ".h5", ".hdf5", ".parquet", ".db", ".sqlite"),
    *(".py", ".m", ".sh", ".ipynb", ".md5", ".sha256"),
    *(".mp4", ".avi", ".mov", ".mkv", ".webm"),
}


def is_image_name(name: str) -> bool:
    """Tell whether a file of this name is an image by its suffix."""
    return name.lower().endswith(IMAGE_SUFFIXES)


def is_beside(name: str) -> bool:
    """Tell whether a file of this name lies beside frames and is none: hidden, a system's own, a document, a list."""
    lower = name.lower()
    return name.startswith(".") or lower in _FILES_BESIDE or Path(lower).suffix in _SUFFIXES_BESIDE


def is_folder_beside(name: str) -> bool:
    """Tell whether a folder of this name holds no frames: hidden, or a system's own."""
    return name.startswith(".") or name.lower() in _FOLDERS_BESIDE


Exif = Literal["obey", "ignore"]  # the tag by which a camera says how it was held
Levels = tuple[float, float]  # those that become 0 and 255
Counts = npt.NDArray[Any]  # (height, width), integers of 16 or 32 bits, or floats

UPRIGHT = 1  # EXIF 2.32
_ORIENTATION = 0x0112  # the number of the tag
_TURNED_BACK = {6: 8, 8: 6}  # all other orientations are their own inverse
_FLIPS = {2: 1, 3: -1, 4: 0, 6: 1, 7: -1, 8: 0}  # as OpenCV calls them, after a transposition from 5 on
_N_LEVELS = 256
_FULL = {np.dtype(np.uint16): (0.0, 65_535.0)}
#: Pillow knows many more, some of which start other programs (EPS) or have no use here.
_FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "WEBP", "PPM")
#: The errors by which Pillow reports a file that it cannot read.
_UNREADABLE = (
    *(OSError, SyntaxError, ValueError),
    *(PillowImage.DecompressionBombError, PillowImage.DecompressionBombWarning),
)


@dataclass(frozen=True, slots=True)  # one for each of millions of files
class Head:
    """The facts of a file that are known before its pixels are decoded."""

    orientation: int = UPRIGHT  # 1 to 8, of the EXIF tag; 2 to 8 turn or mirror the frame
    deep: bool = False  # whether it is grey of more than 8 bits
    n_bytes: int = 1  # of the frame once it is decoded


@dataclass(frozen=True)
class Decoding:
    """How image files become frames of 8 bits, the same for all frames of a dataset.

    `levels` are the lowest and the highest level of frames deeper than 8 bits. Without them 16 bits are taken in full,
    and integers of 32 bits and floats are refused.
    """

    exif: Exif = "obey"  # as phones and browsers do; ignore: frames as they are stored
    levels: Levels | None = None

    def scale(self, counts: Counts, path: Path) -> npt.NDArray[np.uint8]:
        """Return the deep levels of a file as 0 to 255; a level outside the range becomes the range's nearer end.

        Integers of 256 levels and more fall into 256 bins of equal width: of 0..65535 the upper 8 bits are kept. Fewer
        levels and floats are stretched and rounded. Raises BadInput with the path if no range is known.
        """
        levels = self.levels or _FULL.get(counts.dtype)
        if levels is None:
            raise BadInput(
                f"{path} has levels of type {counts.dtype}: give Images.from_files a Decoding with levels, the lowest "
                "and the highest of all frames"
            )
        low, high = levels
        above = np.nan_to_num(counts.astype(np.float64)) - low
        if counts.dtype.kind in "iu" and high - low >= _N_LEVELS - 1:
            scaled = np.floor(above * (_N_LEVELS / (high - low + 1)))
        else:
            scaled = np.rint(above * ((_N_LEVELS - 1) / (high - low)))
        return np.clip(scaled, 0, _N_LEVELS - 1).astype(np.uint8)


_USUAL = Decoding()


def read_image(path: Path, decoding: Decoding = _USUAL) -> Image:
    """Decode one image file to RGB uint8 (height, width, 3); grey is repeated, alpha dropped.

    `decoding` says whether the EXIF tag turns the frame, and which levels become 0 and 255 if there are more than 256.
    Raises BadInput with the path if the file is missing, truncated or no image, if nothing says how to scale its
    levels, and, undecoded, if it has more pixels than `PIL.Image.MAX_IMAGE_PIXELS` (89,478,485 unless a program sets
    another number).
    """
    with _open(path) as image:
        orientation, deep, is_turned = _read_orientation(image), _is_deep(image), image.format == "TIFF"  # by Pillow
        if deep:
            pixels = as_rgb(decoding.scale(_read_counts(image), path))
        else:  # a palette with transparency has to become RGBA first
            colours = image.convert("RGBA") if image.mode == "P" else image
            pixels = np.array(colours if colours.mode == "RGB" else colours.convert("RGB"))
    if orientation == UPRIGHT or is_turned == (decoding.exif == "obey"):
        return pixels
    return _turn(pixels, _TURNED_BACK.get(orientation, orientation) if is_turned else orientation)


def read_counts(path: Path) -> Counts:
    """Decode the levels of a file deeper than 8 bits as they stand there; raises what `read_image` raises."""
    with _open(path) as image:
        return _read_counts(image)


def read_head(path: Path) -> Head:
    """Return the head of an image file; that of an upright frame of 8 bits for a file that cannot be read."""
    try:
        with open_image(path) as image:
            return Head(_read_orientation(image), _is_deep(image), max(1, 3 * image.width * image.height))
    except _UNREADABLE:  # read_image reports it
        return Head()


def open_image(path: Path) -> PillowImage.Image:
    """Open an image of one of the formats without decoding its pixels; the caller closes it.

    Raises Pillow's errors: UnidentifiedImageError, an OSError, for any other content, whatever its name.
    """
    return PillowImage.open(path, formats=_FORMATS)


@contextmanager
def _open(path: Path) -> Iterator[PillowImage.Image]:
    """Open an image for decoding; errors of the decoders become BadInput with the path."""
    file = io.BytesIO()
    try:
        file = io.BytesIO(path.read_bytes())  # of a path Pillow maps some TIFF, and then turns their shape alone
        with PillowImage.open(file, formats=_FORMATS) as image:
            most = PillowImage.MAX_IMAGE_PIXELS
            if most is not None and image.width * image.height > most:
                raise ValueError(f"{image.width} x {image.height} pixels; at most {most:,} may be decoded")
            yield image
    except FileNotFoundError as error:
        raise BadInput(f"{path} does not exist: restore the file or choose other places") from error
    except _UNREADABLE as error:
        reason = str(error).replace(f" {file!r}", "").replace(str(path), "it").splitlines()[0]
        raise BadInput(f"{path} cannot be read as an image ({reason}): replace the file; none is skipped") from error


def _read_counts(image: PillowImage.Image) -> Counts:
    counts = np.array(image)
    return counts.astype(np.uint16) if image.format == "PPM" else counts  # which Pillow scales to 0..65535


def _is_deep(image: PillowImage.Image) -> bool:
    return image.mode.startswith(("I", "F"))  # of colours Pillow keeps the upper 8 bits alone


def _read_orientation(image: PillowImage.Image) -> int:
    """Return the tag of an image that is opened and not yet loaded.

    A tag counts where browsers look for it: of PNG before the pixels, of JPEG before the first scan.
    """
    exif: Any = PillowImage.Exif()
    with suppress(SyntaxError, ValueError, struct.error):  # a damaged block turns nothing
        exif.load(image.info.get("exif", b""))
    orientation = getattr(image, "tag_v2", exif).get(_ORIENTATION)  # of a TIFF its own tags
    return orientation if orientation in range(1, 9) else UPRIGHT


def _turn(pixels: Image, orientation: int) -> Image:
    """Return the frame that a tag of 2 to 8 tells of stored pixels: 6 turns it clockwise, 8 the other way."""
    turned = cv2.transpose(pixels) if orientation >= 5 else pixels  # in a tenth of the time of NumPy's copy
    return np.asarray(turned if orientation == 5 else cv2.flip(turned, _FLIPS[orientation]), np.uint8)


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

"""One image file decoded, whole and as RGB, or an error that names the file; and which files are images at all."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image as PillowImage

from vprbench.api.arrays import Image
from vprbench.api.heads import UPRIGHT, Head, head_of
from vprbench.errors import BadInput

SIGNATURE = b"\x89PNG\r\n\x1a\n"

_HEADER = struct.Struct(">IIBBBBB")  # width, height, bits, kind of colour, compression, filter, interlacing
_KINDS = {0, 2, 6}  # grey, colour, colour with alpha
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}  # by kind of colour
# Chunks that change no pixel, and of which libpng has nothing to say on the terminal.
_PLAIN = {b"IDAT", b"IEND", b"pHYs", b"gAMA", b"cHRM", b"sRGB", b"cICP", b"tEXt", b"tIME"}
_AT_ONCE = 1 << 16  # bytes
_SAMPLE_FORMAT = 339  # tag of a TIFF; 1: unsigned integers
# Adam7: first column, first row, columns apart, rows apart (PNG specification, 8.2).
_PASSES = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))


def decoded_png(content: bytes) -> Image | None:
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
    _require_pixels(content)
    return None


def _chunks(content: bytes) -> Iterator[tuple[bytes, memoryview, bool]]:
    """Yield kind and content of each chunk that is there whole, and whether its checksum fits."""
    view, place = memoryview(content), len(SIGNATURE)
    while place + 12 <= len(content):
        length, kind = struct.unpack_from(">I4s", content, place)
        end = place + 8 + length
        if end + 4 > len(content):
            return
        yield kind, view[place + 8 : end], zlib.crc32(view[place + 4 : end]) == int.from_bytes(view[end : end + 4])
        place = end + 4


def _is_plain_and_whole(content: bytes) -> bool:
    """Tell whether every chunk up to the last is there, has its checksum and is known to be harmless."""
    chunks = _chunks(content)
    kind, header, right = next(chunks, (b"", memoryview(b""), False))
    if not (content.startswith(SIGNATURE) and right and _is_plain_header(kind, header)):
        return False
    for kind, _, right in chunks:
        if not right or kind not in _PLAIN:
            return False
        if kind == b"IEND":
            return True
    return False


def _is_plain_header(kind: bytes, content: memoryview) -> bool:
    if kind != b"IHDR" or len(content) != _HEADER.size:
        return False
    width, height, bits, colour, *ways = _HEADER.unpack(content)
    largest = PillowImage.MAX_IMAGE_PIXELS
    small = largest is None or width * height <= largest  # Pillow has a say in what is larger
    return small and bits == 8 and colour in _KINDS and not any(ways)


def _require_pixels(content: bytes) -> None:
    """Raise ValueError for a PNG whose compressed pixels come to a proper end, but before the last row.

    What is wrong in any other way is left to the decoder, which finds it. Nothing that is unpacked is kept.
    """
    chunks = _chunks(content)
    kind, header, _ = next(chunks, (b"", memoryview(b""), False))
    if kind != b"IHDR" or len(header) != _HEADER.size:
        return
    width, height, bits, colour, _, _, interlaced = _HEADER.unpack(header)
    if colour not in _CHANNELS:
        return
    wanted = _row_bytes(width, height, bits * _CHANNELS[colour], bool(interlaced))
    came, stream = 0, zlib.decompressobj()
    try:
        for kind, packed, _ in chunks:
            for start in range(0, len(packed) if kind == b"IDAT" else 0, _AT_ONCE):
                rest: bytes | memoryview = packed[start : start + _AT_ONCE]
                while rest and not stream.eof and came < wanted:
                    came += len(stream.decompress(rest, _AT_ONCE))
                    rest = stream.unconsumed_tail
    except zlib.error:
        return
    if stream.eof and came < wanted:
        raise ValueError(f"its pixels end after {came} of {wanted} bytes")


def _row_bytes(width: int, height: int, bits: int, interlaced: bool) -> int:
    """Return the bytes of all rows, each with the byte that names its filter, of pixels of so many bits."""
    total = 0
    for column, row, across, down in _PASSES if interlaced else ((0, 0, 1, 1),):
        columns, rows = len(range(column, width, across)), len(range(row, height, down))
        total += rows * (1 + (columns * bits + 7) // 8) if columns else 0
    return total


#: Pillow knows many more, some of which start other programs (EPS) or have no use here.
FORMATS = ("PNG", "JPEG", "BMP", "TIFF", "WEBP", "PPM")
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


def open_image(path: Path) -> PillowImage.Image:
    """Open an image of one of the formats, of which nothing is decoded yet; to be closed by the caller.

    Raises what Pillow does: UnidentifiedImageError, an OSError, for any other content, whatever its name.
    """
    return PillowImage.open(path, formats=FORMATS)


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


_UNREADABLE = (  # how Pillow and the reader of PNG say what a file is not
    *(OSError, SyntaxError, ValueError),
    *(PillowImage.DecompressionBombError, PillowImage.DecompressionBombWarning),
)


Exif = Literal["obey", "ignore"]  # the tag by which a camera says how it was held
Levels = tuple[float, float]  # those that become 0 and 255
Counts = npt.NDArray[Any]  # (height, width) or (height, width, 3), integers of 16 or 32 bits, or floats

_FULL = {np.dtype(np.uint16): (0.0, 65_535.0)}
_TURNED_BACK = {6: 8, 8: 6}  # all other orientations are their own inverse
_FLIPS = {2: 1, 3: -1, 4: 0, 6: 1, 7: -1, 8: 0}  # as OpenCV calls them, after a transposition from 5 on
_N_LEVELS = 256


@dataclass(frozen=True)
class Decoding:
    """How image files become frames of 8 bits, the same for all frames of a dataset.

    `levels` are the lowest and the highest level of frames deeper than 8 bits. Without them 16 bits are taken in full,
    and integers of 32 bits and floats are refused.
    """

    exif: Exif = "obey"  # as phones and browsers do; ignore: frames as they are stored
    levels: Levels | None = None

    def scaled(self, counts: Counts, path: Path) -> npt.NDArray[np.uint8]:
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
    with _named_in_errors(path):
        if (pixels := _decoded_png(path)) is not None:  # which has no tag
            return pixels
        head = head_of(path)
        with _opened(path, head) as image:
            _require_size(image)
            has_turned = image.format == "TIFF"  # its decoders obey the tag
            pixels = _deep_pixels(image, path) if head.deep else _shallow_pixels(image)
    if head.deep:
        pixels = as_rgb(decoding.scaled(pixels, path))
    if head.orientation == UPRIGHT or has_turned == (decoding.exif == "obey"):
        return pixels
    orientation = _TURNED_BACK.get(head.orientation, head.orientation) if has_turned else head.orientation
    return _turn(pixels, orientation)


def read_counts(path: Path) -> Counts:
    """Decode the levels of a file deeper than 8 bits as they stand there; raises what `read_image` raises."""
    with _named_in_errors(path):
        _decoded_png(path)  # whose pixels may end early
        with open_image(path) as image:
            _require_size(image)
            return _deep_pixels(image, path)


@contextmanager
def _named_in_errors(path: Path) -> Iterator[None]:
    """Turn what decoders raise into BadInput that names the file."""
    try:
        yield
    except FileNotFoundError as error:
        raise BadInput(f"{path} does not exist: restore the file or choose other places") from error
    except _UNREADABLE as error:
        reason = str(error).replace(f" {str(path)!r}", "").replace(str(path), "it").splitlines()[0]
        raise BadInput(f"{path} cannot be read as an image ({reason}): replace the file; none is skipped") from error


def _opened(path: Path, head: Head) -> PillowImage.Image:
    """Open an image; Pillow 13 maps a file by its name into memory as if its pixels were stored upright."""
    if head.orientation == UPRIGHT:
        return open_image(path)
    return PillowImage.open(io.BytesIO(path.read_bytes()), formats=FORMATS)


def _shallow_pixels(image: PillowImage.Image) -> Image:
    if image.mode == "RGB":
        return np.asarray(image)
    # A palette with transparency has to become RGBA first.
    return np.asarray((image.convert("RGBA") if image.mode == "P" else image).convert("RGB"))


def _deep_pixels(image: PillowImage.Image, path: Path) -> Counts:
    """Return all bits of a file; Pillow, which keeps 8 bits of colours and scales PNM, only sees that it is whole."""
    image.load()
    if image.mode == "F" or (image.format != "PPM" and image.mode.startswith("I")):
        counts: Counts = np.asarray(image)
        unsigned = image.mode == "I" and getattr(image, "tag_v2", {}).get(_SAMPLE_FORMAT, (1,))[0] == 1
        return counts.view(np.uint32) if unsigned else counts
    colours = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)
    if colours is None:
        raise ValueError(f"its levels of more than 8 bits in mode {image.mode} are not read")
    return colours if colours.ndim == 2 else colours[:, :, 2::-1]  # from BGR


def _turn(pixels: Image, orientation: int) -> Image:
    """Return the frame that a tag of 2 to 8 tells of stored pixels: 6 turns it clockwise, 8 the other way."""
    turned = cv2.transpose(pixels) if orientation >= 5 else pixels  # in a tenth of the time of NumPy's copy
    return np.asarray(turned if orientation == 5 else cv2.flip(turned, _FLIPS[orientation]), np.uint8)


def _require_size(image: PillowImage.Image) -> None:
    most = PillowImage.MAX_IMAGE_PIXELS
    if most is not None and image.width * image.height > most:
        raise ValueError(f"{image.width} x {image.height} pixels; at most {most:,} may be decoded")


def _decoded_png(path: Path) -> Image | None:
    """Return the pixels of a plain, whole PNG, which is read fastest; None for any other file."""
    with path.open("rb") as file:
        start = file.read(len(SIGNATURE))
        return decoded_png(start + file.read()) if start == SIGNATURE else None


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

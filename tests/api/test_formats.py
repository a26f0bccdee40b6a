"""Every format and kind of pixels gives the frame that was saved, turned by its tag, and levels deeper than 8 bits."""

import io
import struct

import cv2
import numpy as np
import pytest
from described_images import image
from image_folders import answer
from PIL import EpsImagePlugin
from PIL import Image as PillowImage

from vprbench.api.decoding import Decoding, read_image
from vprbench.api.levels import decoding_of
from vprbench.errors import BadInput

HEIGHT, WIDTH = 6, 9
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH]
# Smooth, so that JPEG keeps it, and the same in no other orientation.
GREY = (20 + 30 * ROWS + 7 * COLUMNS).astype(np.uint8)
COLOUR = np.stack([GREY, 230 - GREY, GREY // 2 + 60], axis=2)
ALPHA = np.dstack([COLOUR, 255 - GREY // 4])
INKS = np.dstack([255 - COLOUR, np.zeros_like(GREY)])
FEW = np.where(GREY[:, :, None] > 120, COLOUR[0, 0], COLOUR[-1, -1]).astype(np.uint8)
REPEATED = np.repeat(GREY[:, :, None], 3, axis=2)
FULL = 257  # times a level of 8 bits is that level of 16

LOSSY = {"JPEG": 6}
LOSSLESS = {"WEBP": {"lossless": True}, "JPEG": {"quality": 98, "subsampling": 0}}
SUFFIXES = {"JPEG": "jpg", "PNG": "png", "TIFF": "tif", "WEBP": "webp", "PPM": "pgm"}


def saved(pixels, kind, mode=None, **options):
    file = io.BytesIO()
    image = PillowImage.fromarray(pixels) if mode is None else PillowImage.frombytes(mode, (WIDTH, HEIGHT), pixels)
    image.save(file, kind, **LOSSLESS.get(kind, {}), **options)
    return file.getvalue()


def palette(kind):
    file = io.BytesIO()
    PillowImage.fromarray(FEW).convert("P", palette=PillowImage.Palette.ADAPTIVE).save(file, kind)
    return file.getvalue()


def deep(counts, suffix):
    """A file that OpenCV writes, of colours as RGB."""
    order = {2: slice(None), 3: [2, 1, 0], 4: [2, 1, 0, 3]}[2 if counts.ndim == 2 else counts.shape[2]]
    written, content = cv2.imencode(suffix, counts if counts.ndim == 2 else counts[:, :, order])
    assert written
    return content.tobytes()


def wide(pixels):
    return pixels.astype(np.uint16) * FULL


MILLIONS = (0, 255_000)  # a thousand counts a level, more than 16 bits hold
PLAIN = Decoding()
# By format and kind: the file, the frame, and what has to be said of its levels.
MATRIX = {
    **{("grey", kind): (saved(GREY, kind), REPEATED, PLAIN) for kind in ("JPEG", "PNG", "TIFF", "PPM")},
    **{("colour", kind): (saved(COLOUR, kind), COLOUR, PLAIN) for kind in SUFFIXES},
    **{("alpha", kind): (saved(ALPHA, kind, exact=True), COLOUR, PLAIN) for kind in ("PNG", "TIFF", "WEBP")},
    **{("palette", kind): (palette(kind), FEW, PLAIN) for kind in ("PNG", "TIFF")},
    **{("four inks", kind): (saved(INKS, kind, "CMYK"), COLOUR, PLAIN) for kind in ("JPEG", "TIFF")},
    **{("16 bits", kind): (saved(wide(GREY), kind), REPEATED, PLAIN) for kind in ("PNG", "TIFF", "PPM")},
    **{
        (f"16 bits, {what}", kind): (deep(wide(pixels), suffix), COLOUR, PLAIN)
        for kind, suffix in (("PNG", ".png"), ("TIFF", ".tiff"))
        for what, pixels in (("colour", COLOUR), ("alpha", ALPHA))
    },
    ("32 bits", "TIFF"): (saved(GREY.astype(np.int32) * 1000, "TIFF"), REPEATED, Decoding(levels=MILLIONS)),
    ("32 bits, below zero", "TIFF"): (
        saved(GREY.astype(np.int32) * 1000 - 100_000, "TIFF"),
        REPEATED,
        Decoding(levels=(-100_000, 155_000)),
    ),
    ("floats of 0 to 1", "TIFF"): (saved(GREY.astype(np.float32) / 255, "TIFF"), REPEATED, Decoding(levels=(0, 1))),
    ("floats of 0 to 255", "TIFF"): (saved(GREY.astype(np.float32), "TIFF"), REPEATED, Decoding(levels=(0, 255))),
}


@pytest.mark.parametrize(("kind", "format"), MATRIX)
def test_a_file_of_every_format_and_kind_gives_the_frame_that_was_saved(tmp_path, kind, format):
    content, wanted, decoding = MATRIX[kind, format]
    path = tmp_path / f"frame.{SUFFIXES[format]}"
    path.write_bytes(content)
    found = read_image(path, decoding)
    assert (found.dtype, found.shape, found.flags["C_CONTIGUOUS"]) == (np.uint8, (HEIGHT, WIDTH, 3), True)
    assert np.abs(found.astype(int) - wanted).max() <= LOSSY.get(format, 0)


def turned(stored, tag):
    """The frame by the table of EXIF 2.32: on which side of it the first row and the first column of pixels lie."""
    far_row, far_column = HEIGHT - 1 - ROWS, WIDTH - 1 - COLUMNS
    row, column = {
        1: (ROWS, COLUMNS),  # top, left
        2: (ROWS, far_column),  # top, right
        3: (far_row, far_column),  # bottom, right
        4: (far_row, COLUMNS),  # bottom, left
        5: (COLUMNS, ROWS),  # left, top
        6: (COLUMNS, far_row),  # right, top
        7: (far_column, far_row),  # right, bottom
        8: (far_column, ROWS),  # left, bottom
    }[tag]
    frame = np.zeros((HEIGHT, WIDTH, 3) if tag < 5 else (WIDTH, HEIGHT, 3), np.uint8)
    frame[row, column] = stored
    return frame


def with_tag(tag):
    exif = PillowImage.Exif()
    exif[0x0112] = tag
    exif[0x010F] = "a maker whose name is longer than four bytes"
    return exif


START = b"\xff\xd8"  # of a JPEG
PROFILE = START + b"\xff\xe2" + struct.pack(">H", 60_002) + bytes(60_000)  # with a segment, as of a large profile
TAGGED = {
    "JPEG": lambda exif: saved(COLOUR, "JPEG", exif=exif),
    "JPEG, the tag far behind": lambda exif: saved(COLOUR, "JPEG", exif=exif).replace(START, PROFILE, 1),
    "PNG": lambda exif: saved(COLOUR, "PNG", exif=exif),
    "PNG, 16 bits": lambda exif: saved(wide(GREY), "PNG", exif=exif),
    "TIFF": lambda exif: saved(COLOUR, "TIFF", exif=exif),
    "TIFF, grey": lambda exif: saved(GREY, "TIFF", exif=exif),
    "TIFF, 16 bits": lambda exif: saved(wide(GREY), "TIFF", exif=exif),
    "WEBP": lambda exif: saved(COLOUR, "WEBP", exif=exif),
}


@pytest.mark.parametrize("tag", range(1, 9))
@pytest.mark.parametrize("format", TAGGED)
def test_the_tag_of_every_format_turns_the_frame_or_is_ignored_and_is_told(tmp_path, format, tag):
    path = tmp_path / "frame"
    path.write_bytes(TAGGED[format](with_tag(tag)))
    stored = REPEATED if format.endswith(("16 bits", "grey")) else COLOUR
    for exif, wanted in (("obey", turned(stored, tag)), ("ignore", stored)):
        found = read_image(path, Decoding(exif))
        assert found.shape == wanted.shape
        assert np.abs(found.astype(int) - wanted).max() <= LOSSY.get(format[:4], 0)
        _, told = decoding_of([path], exif, "0..65535")
        assert told.get("exif") == (None if tag == 1 else exif)


@pytest.mark.filterwarnings("ignore:Corrupt EXIF data")  # as Pillow says
def test_a_tag_of_no_orientation_and_a_damaged_block_turn_nothing(tmp_path):
    path = tmp_path / "frame.jpg"
    whole = saved(COLOUR, "JPEG", exif=with_tag(6))
    at = whole.index(b"Exif\0\0")
    for content in (
        saved(COLOUR, "JPEG", exif=with_tag(9)),
        whole[:at] + b"Else" + whole[at + 4 :],
        whole[: at + 6] + b"??" + whole[at + 8 :],
        whole[: at + 10] + b"\xff\xff\xff\xff" + whole[at + 14 :],
    ):
        path.write_bytes(content)
        assert read_image(path).shape == (HEIGHT, WIDTH, 3)
        assert decoding_of([path])[1] == {}


def written(tmp_path, *frames):
    """Write arrays as TIFF, and bytes as they come; returns the paths."""
    paths = [tmp_path / f"{number}.tif" for number in range(len(frames))]
    for path, frame in zip(paths, frames, strict=True):
        path.write_bytes(frame if isinstance(frame, bytes) else saved(np.asarray(frame), "TIFF"))
    return paths


def counts(*levels, kind=np.uint16):
    return np.array([levels], kind)


RANGES = {
    "12 bits, of the darkest and the brightest frame": ([counts(9, 4095), counts(0, 70)], "0..4095"),
    "what a thermal camera counts": ([counts(7612, 7700), counts(7650, 8441)], "7612..8441"),
    "more than 16 bits": ([counts(3, 70_000, kind=np.int32)], "3..70000"),
    "below zero": ([counts(-20, 5000, kind=np.int32)], "-20..5000"),
    "8 bits in 16 or 32": ([counts(9, 250), counts(9, 30, kind=np.int32), COLOUR], "0..255"),
    "floats of 0 to 1, beside 8 bits": ([counts(0.1, 0.7, kind=np.float32), COLOUR], "0..1"),
    "floats of 0 to 255, one frame black": (
        [counts(0, 200.5, kind=np.float32), counts(0, 0, kind=np.float32)],
        "0..255",
    ),
    "8 bits alone": ([COLOUR, GREY], None),
}


@pytest.mark.parametrize("case", RANGES)
def test_one_range_for_all_files_is_told_from_them_and_named(tmp_path, case):
    frames, told = RANGES[case]
    files = written(tmp_path, *frames)
    assert decoding_of(files)[1].get("levels") == told
    if told:
        low, high = map(float, told.split("..", 1)) if not told.startswith("-") else (-20.0, 5000.0)
        assert decoding_of(files)[0].levels == (low, high)


UNTOLD = {
    "floats of degrees": [counts(271.5, 305.0, kind=np.float32)],
    "floats below zero": [counts(-0.2, 0.9, kind=np.float32)],
    "floats that are none": [counts(0.2, np.nan, kind=np.float32)],
    "floats of 0 to 1 and of 0 to 255": [counts(0.2, 0.9, kind=np.float32), counts(3, 200, kind=np.float32)],
    "floats and deep integers": [counts(0.2, 0.9, kind=np.float32), counts(3, 4095)],
    "deep integers beside 8 bits": [counts(3, 4095), COLOUR],
}


@pytest.mark.parametrize("case", UNTOLD)
def test_levels_that_cannot_be_told_are_refused_unless_the_option_says_a_range(tmp_path, case):
    files = written(tmp_path, *UNTOLD[case])
    for text in ("4095", "0..", "10..2", "a..b", "0..inf"):
        assert f"levels={text}" in answer(decoding_of, files, levels=text)
    said = answer(decoding_of, files, prefix="dataset.")
    assert "dataset.levels=LOW..HIGH" in said
    assert str(tmp_path) in said
    decoding, told = decoding_of(files, levels="0..300")
    assert (decoding.levels, told) == ((0, 300), {"levels": "0..300"})
    assert all(read_image(file, decoding).dtype == np.uint8 for file in files)


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
def test_an_image_of_more_pixels_than_pillow_allows_is_refused_by_name(tmp_path, monkeypatch, kind):
    path = tmp_path / "frame.png"
    path.write_bytes(saved(image(37, 50), kind))
    monkeypatch.setattr(PillowImage, "MAX_IMAGE_PIXELS", 37 * 50)
    assert read_image(path).shape == (37, 50, 3)
    monkeypatch.setattr(PillowImage, "MAX_IMAGE_PIXELS", 37 * 50 - 1)
    with pytest.raises(BadInput, match=r"frame\.png .*50 x 37 pixels; at most 1,849 "):
        read_image(path)


PNG, JPEG = (saved(image(40, 40), kind) for kind in ("PNG", "JPEG"))
BAD = {
    "a truncated PNG": PNG[:2000],
    "a PNG without its last pixels": PNG[:-40],
    "a changed byte among the pixels": b"%b%c%b" % (PNG[:2900], PNG[2900] ^ 16, PNG[2901:]),
    "a changed byte in the header": b"%b%c%b" % (PNG[:20], PNG[20] ^ 16, PNG[21:]),
    "a truncated JPEG": JPEG[:1000],
    "empty": b"",
    "a web page": b"<!doctype html>",
    "a program": b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 4 4\n%%EndComments\nshowpage\n",
    "missing": None,
}


@pytest.mark.parametrize("content", BAD.values(), ids=BAD)
def test_a_file_that_is_no_whole_image_is_answered_in_one_line_with_its_path_and_starts_no_other_program(
    tmp_path, monkeypatch, content
):
    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", lambda *_, **__: pytest.fail("a program was started"))
    if content is not None:
        (tmp_path / "frame.png").write_bytes(content)
    assert f"frame.png {'does not exist' * (content is None)}" in answer(read_image, tmp_path / "frame.png")
    assert "cannot be read as an image" in answer(read_image, tmp_path)

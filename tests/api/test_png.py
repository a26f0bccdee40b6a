"""Files come with the pixels that Pillow gives, whatever decodes them, and a broken file is never half an image."""

import io
import struct
import zlib
from contextlib import suppress

import numpy as np
import pytest
from PIL import EpsImagePlugin, PngImagePlugin
from PIL import Image as PillowImage

from vprbench.api import decoding, png
from vprbench.api.decoding import read_image
from vprbench.errors import BadInput

HEIGHT, WIDTH = 37, 50


@pytest.fixture
def path(tmp_path):
    return tmp_path / "frame.png"


def chunk(kind, content):
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def png_of(rows, width, height, *, bits=8, colour=2, interlaced=0, extra=b""):
    """A PNG of rows as they stand in the file, each after the byte that names its filter."""
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, colour, 0, 0, interlaced))
    return png.SIGNATURE + header + extra + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b"")


def saved(pixels, mode=None, kind="PNG", **options):
    file = io.BytesIO()
    image = PillowImage.fromarray(pixels)
    (image if mode is None else image.convert(mode)).save(file, kind, **options)
    return file.getvalue()


def noise(*shape, seed=0):
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def filtered(kind, channels, height=9):
    """Rows of random differences, all under one filter."""
    return b"".join(bytes([kind]) + noise(7 * channels, seed=row).tobytes() for row in range(height))


COLOUR, GREY = noise(HEIGHT, WIDTH, 3), noise(HEIGHT, WIDTH)
TURNED = PillowImage.Exif()
TURNED[0x0112] = 6  # taken with the camera on its side
TEXT = PngImagePlugin.PngInfo()
TEXT.add_text("Software", "camera")

PLAIN = {
    "colour": saved(COLOUR),
    "grey": saved(GREY),
    "colour with alpha": saved(noise(HEIGHT, WIDTH, 4)),
    "text and resolution": saved(COLOUR, pnginfo=TEXT, dpi=(72, 72)),
    "another gamma": png_of(filtered(0, 3), 7, 9, extra=chunk(b"gAMA", struct.pack(">I", 100_000))),
    "the colours of a video": png_of(filtered(0, 3), 7, 9, extra=chunk(b"cICP", bytes([1, 1, 0, 1]))),
    "more after its end": saved(COLOUR) + b"more",
    **{
        f"filter {kind}, {n} channels": png_of(filtered(kind, n), 7, 9, colour=c)
        for kind in range(5)
        for n, c in ((1, 0), (3, 2), (4, 6))
    },
}
OTHERS = {
    "grey with alpha": saved(GREY, "LA"),
    "palette with transparency": saved(COLOUR, "P", transparency=bytes(range(256))),
    "16 bits of grey": saved(GREY.astype(np.uint16) * 257),
    "16 bits of colour": png_of(filtered(0, 6), 7, 9, bits=16),
    "interlaced": png_of(b"\0\x01\x02\x03", 1, 1, interlaced=1),
    "a transparent colour": png_of(filtered(0, 3), 7, 9, extra=chunk(b"tRNS", bytes(6))),
    "a colour profile": saved(COLOUR, icc_profile=b"no profile"),
    "camera on its side": saved(COLOUR, exif=TURNED),
    "two frames": saved(COLOUR, save_all=True, append_images=[PillowImage.new("RGB", (WIDTH, HEIGHT))]),
    "JPEG, four inks": saved(COLOUR, "CMYK", kind="JPEG"),
    "JPEG, camera on its side": saved(COLOUR, kind="JPEG", exif=TURNED),
}


def by_pillow(content):
    """The pixels by Pillow alone: a palette through its transparency, 16 bits of grey by the upper 8."""
    with PillowImage.open(io.BytesIO(content)) as image:
        if image.mode.startswith("I"):
            return np.repeat((np.asarray(image) >> 8).astype(np.uint8)[:, :, None], 3, 2)
        return np.asarray((image.convert("RGBA") if image.mode == "P" else image).convert("RGB"))


@pytest.mark.parametrize("kind", [*PLAIN, *OTHERS])
def test_a_file_has_the_pixels_that_pillow_gives_and_a_plain_png_is_decoded_without_it(path, kind, monkeypatch):
    content = {**PLAIN, **OTHERS}[kind]
    wanted = by_pillow(content)
    path.write_bytes(content)
    assert (png.decoded(content) is None) == (kind in OTHERS)
    if kind in PLAIN:
        monkeypatch.setattr(decoding.PillowImage, "open", None)
    image = read_image(path)
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image, wanted)


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
def test_an_image_of_more_pixels_than_pillow_allows_is_refused_by_name(path, monkeypatch, kind):
    path.write_bytes(saved(COLOUR, kind=kind))
    monkeypatch.setattr(PillowImage, "MAX_IMAGE_PIXELS", HEIGHT * WIDTH)
    assert read_image(path).shape == (HEIGHT, WIDTH, 3)
    assert kind == "JPEG" or png.decoded(path.read_bytes()) is not None
    monkeypatch.setattr(PillowImage, "MAX_IMAGE_PIXELS", HEIGHT * WIDTH - 1)
    with pytest.raises(BadInput, match=r"frame\.png .*50 x 37 pixels; at most 1,849 "):
        read_image(path)


@pytest.mark.parametrize(("kind", "shape"), [("PNG", (6, 5, 3)), ("PNG", (6, 5)), ("JPEG", (6, 5))])
def test_a_file_cut_anywhere_never_gives_other_pixels_and_a_cut_png_is_left_to_pillow(path, kind, shape, capfd):
    whole = saved(noise(*shape), kind=kind)
    for n_bytes in [*range(0, len(whole), 7), *range(len(whole) - 30, len(whole))]:
        path.write_bytes(whole[:n_bytes])
        assert png.decoded(whole[:n_bytes]) is None
        with suppress(BadInput):
            assert np.array_equal(read_image(path), by_pillow(whole)), f"{n_bytes} of {len(whole)} bytes"
    assert capfd.readouterr() == ("", "")


def test_a_png_with_one_wrong_byte_is_an_error_or_what_pillow_makes_of_it(path):
    whole = PLAIN["text and resolution"]
    refused = 0
    for place in [*range(120), *range(120, len(whole), 97), *range(len(whole) - 20, len(whole))]:
        content = bytearray(whole)
        content[place] ^= 0x10
        path.write_bytes(content)
        try:
            expected = by_pillow(bytes(content))
        except (OSError, SyntaxError, ValueError):
            refused += 1
            with pytest.raises(BadInput, match=r"frame\.png"):
                read_image(path)
        else:
            np.testing.assert_array_equal(read_image(path), expected)
    assert refused > 30


BAD = {
    "no such filter": png_of(bytes([9]) + filtered(0, 3)[1:], 7, 9),
    "a row too few": png_of(filtered(0, 3)[:-22], 7, 9),
    "a row too few of 16 bits, left to Pillow": png_of(filtered(0, 6)[:-43], 7, 9, bits=16),
    "a pass too few of those interlaced": png_of(b"\0\1" * 2, 2, 2, colour=0, interlaced=1),
    "400 million pixels that are not there": png_of(b"\0", 20_000, 20_000),
    "a truncated PNG": saved(noise(40, 40, 3))[:2000],
    "a truncated JPEG": saved(noise(40, 40, 3), kind="JPEG")[:1000],
    "empty": b"",
}


@pytest.mark.parametrize("content", BAD.values(), ids=BAD)
def test_a_file_that_is_no_whole_image_is_answered_in_one_line_with_its_path(path, content):
    path.write_bytes(content)
    with pytest.raises(BadInput, match=r"frame\.png") as error:
        read_image(path)
    assert "\n" not in str(error.value)


def test_a_missing_file_and_a_folder_are_named_and_no_image_starts_another_program(tmp_path, path, monkeypatch):
    for wrong, named in ((path, r"frame\.png does not exist"), (tmp_path, "cannot be read as an image")):
        with pytest.raises(BadInput, match=named):
            read_image(wrong)
    started = []
    monkeypatch.setattr(EpsImagePlugin, "Ghostscript", lambda *_, **__: started.append(True))
    path.write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 4 4\n%%EndComments\nshowpage\n")
    with pytest.raises(BadInput):
        read_image(path)
    assert not started

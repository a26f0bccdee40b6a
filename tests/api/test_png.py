"""Files come with the pixels that Pillow gives, whatever decodes them, and a broken PNG is never half an image."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image as PillowImage
from PIL import PngImagePlugin
from png_files import chunk, png_of, saved

from vprbench.api import decoding, png
from vprbench.api.decoding import read_image
from vprbench.errors import BadInput

Pixels = npt.NDArray[np.uint8]
HEIGHT, WIDTH = 37, 50


def noise(*shape: int, seed: int = 0) -> Pixels:
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


def filtered(kind: int, channels: int, height: int = 9) -> bytes:
    """Rows of random differences, all under one filter."""
    return b"".join(bytes([kind]) + noise(7 * channels, seed=row).tobytes() for row in range(height))


def turned(kind: str, **options: object) -> bytes:
    """A file that says it was taken with the camera on its side."""
    exif = PillowImage.Exif()
    exif[0x0112] = 6
    return saved(noise(HEIGHT, WIDTH, 3), kind=kind, exif=exif, **options)


def with_text() -> bytes:
    text = PngImagePlugin.PngInfo()
    text.add_text("Software", "camera")
    return saved(noise(HEIGHT, WIDTH, 3), pnginfo=text, dpi=(72, 72))


GAMMA = chunk(b"gAMA", struct.pack(">I", 100_000))
HD_VIDEO = chunk(b"cICP", bytes([1, 1, 0, 1]))
PLAIN = {
    "colour": saved(noise(HEIGHT, WIDTH, 3)),
    "colour, smooth": saved(
        np.add.outer(np.arange(HEIGHT), np.arange(3 * WIDTH)).astype(np.uint8).reshape(-1, WIDTH, 3)
    ),
    "grey": saved(noise(HEIGHT, WIDTH)),
    "colour with alpha": saved(noise(HEIGHT, WIDTH, 4)),
    "text and resolution": with_text(),
    "another gamma": png_of(filtered(0, 3), 7, 9, extra=GAMMA),
    "the colours of a video": png_of(filtered(0, 3), 7, 9, extra=HD_VIDEO),
    "more after its end": saved(noise(HEIGHT, WIDTH, 3)) + b"more",
    **{
        f"filter {kind}, {n} channels": png_of(filtered(kind, n), 7, 9, colour=c)
        for kind in range(5)
        for n, c in ((1, 0), (3, 2), (4, 6))
    },
}
OTHERS = {
    "grey with alpha": saved(noise(HEIGHT, WIDTH), "LA"),
    "palette": saved(noise(HEIGHT, WIDTH, 3), "P"),
    "palette with transparency": saved(noise(HEIGHT, WIDTH, 3), "P", transparency=bytes(range(256))),
    "black and white": saved(noise(HEIGHT, WIDTH), "1"),
    "four levels of grey": png_of(b"\0\x1b\0\xe4", 4, 2, bits=2, colour=0),
    "16 bits of grey": saved(noise(HEIGHT, WIDTH).astype(np.uint16) * 257),
    "16 bits of colour": png_of(filtered(0, 6), 7, 9, bits=16),
    "interlaced": png_of(b"\0\x01\x02\x03", 1, 1, interlaced=1),
    "a transparent colour": png_of(filtered(0, 3), 7, 9, extra=chunk(b"tRNS", bytes(6))),
    "a colour profile": saved(noise(HEIGHT, WIDTH, 3), icc_profile=b"no profile"),
    "camera on its side": turned("PNG"),
    "two frames": saved(
        noise(HEIGHT, WIDTH, 3), save_all=True, append_images=[PillowImage.new("RGB", (WIDTH, HEIGHT))]
    ),
    "JPEG": saved(noise(HEIGHT, WIDTH, 3), kind="JPEG"),
    "JPEG, grey": saved(noise(HEIGHT, WIDTH), kind="JPEG"),
    "JPEG, four inks": saved(noise(HEIGHT, WIDTH, 3), "CMYK", kind="JPEG"),
    "JPEG, progressive": saved(noise(HEIGHT, WIDTH, 3), kind="JPEG", progressive=True),
    "JPEG, camera on its side": turned("JPEG"),
    "BMP": saved(noise(HEIGHT, WIDTH, 3), kind="BMP"),
}


def by_pillow(content: bytes) -> Pixels:
    """The pixels by Pillow alone: a palette through its transparency, 16 bits of grey by the upper 8."""
    with PillowImage.open(io.BytesIO(content)) as image:
        if image.mode.startswith("I"):
            return np.repeat((np.asarray(image) >> 8).astype(np.uint8)[:, :, None], 3, 2)
        return np.asarray((image.convert("RGBA") if image.mode == "P" else image).convert("RGB"))


@pytest.mark.parametrize("kind", [*PLAIN, *OTHERS])
def test_a_file_of_any_kind_has_the_pixels_that_pillow_gives(tmp_path: Path, kind: str) -> None:
    content = {**PLAIN, **OTHERS}[kind]
    path = tmp_path / "frame.png"
    path.write_bytes(content)
    image = read_image(path)
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image, by_pillow(content))


@pytest.mark.parametrize("kind", PLAIN)
def test_a_plain_png_is_decoded_without_pillow(tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "frame.png"
    path.write_bytes(PLAIN[kind])

    def never(*_: object) -> None:
        raise AssertionError("Pillow was asked")

    monkeypatch.setattr(decoding.PillowImage, "open", never)
    assert read_image(path).shape[2] == 3


@pytest.mark.parametrize("kind", OTHERS)
def test_what_is_no_plain_png_is_left_to_pillow(kind: str) -> None:
    assert png.decoded(OTHERS[kind]) is None


def test_an_image_of_more_pixels_than_pillow_takes_without_a_word_is_left_to_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    content = PLAIN["colour"]
    monkeypatch.setattr(PillowImage, "MAX_IMAGE_PIXELS", HEIGHT * WIDTH)
    assert png.decoded(content) is not None
    monkeypatch.setattr(PillowImage, "MAX_IMAGE_PIXELS", HEIGHT * WIDTH - 1)
    assert png.decoded(content) is None


@pytest.mark.parametrize("kind", ["colour", "grey", "colour with alpha"])
def test_a_png_cut_anywhere_is_left_to_pillow_and_nothing_is_printed(
    kind: str, capfd: pytest.CaptureFixture[str]
) -> None:
    content = PLAIN[kind]
    for n_bytes in [*range(0, len(content), 53), *range(len(content) - 30, len(content))]:
        assert png.decoded(content[:n_bytes]) is None
    assert capfd.readouterr() == ("", "")


def test_a_png_with_one_wrong_byte_is_an_error_or_what_pillow_makes_of_it(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path, whole = tmp_path / "frame.png", PLAIN["text and resolution"]
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
    assert capfd.readouterr() == ("", "")


SHORT = filtered(0, 3)[:-22]  # eight of nine rows
BAD_ROWS = {
    "no such filter": png_of(bytes([9]) + filtered(0, 3)[1:], 7, 9),
    "no rows": png_of(b"", 7, 9),
    "a row too few": png_of(SHORT, 7, 9),
    "a row too few, grey": png_of(filtered(0, 1)[:-8], 7, 9, colour=0),
    "a row too few beside what is left to Pillow": png_of(SHORT, 7, 9, extra=chunk(b"sBIT", b"\x08\x08\x08")),
    "a row too few of 16 bits": png_of(filtered(0, 6)[:-43], 7, 9, bits=16),
    "a row too few of single bits": png_of(b"\0\x80" * 8, 7, 9, bits=1, colour=0),
    "a pass too few of those interlaced": png_of(b"\0\1" * 2, 2, 2, colour=0, interlaced=1),
}


@pytest.mark.parametrize("content", BAD_ROWS.values(), ids=BAD_ROWS)
def test_a_png_whose_checksums_are_right_but_whose_rows_are_not_is_an_error(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "frame.png"
    path.write_bytes(content)
    with pytest.raises(BadInput, match=r"frame\.png"):
        read_image(path)

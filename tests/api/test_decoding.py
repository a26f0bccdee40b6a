"""Files come with the pixels that were saved or are refused by name, and each way to resize them is its filter."""

import io

import numpy as np
import pytest
import torch
from image_folders import answer
from PIL import EpsImagePlugin
from PIL import Image as PillowImage

from vprbench.api.decoding import read_image
from vprbench.api.neural import resize_batch, resize_image
from vprbench.errors import BadInput

HEIGHT, WIDTH = 37, 50


@pytest.fixture
def path(tmp_path):
    return tmp_path / "frame.png"


def saved(pixels, mode=None, kind="PNG", **options):
    file = io.BytesIO()
    image = PillowImage.fromarray(pixels)
    (image if mode is None else image.convert(mode)).save(file, kind, **options)
    return file.getvalue()


def noise(*shape, seed=0):
    return np.random.default_rng(seed).integers(0, 256, shape, dtype=np.uint8)


COLOUR = noise(HEIGHT, WIDTH, 3)


@pytest.mark.filterwarnings("ignore::PIL.Image.DecompressionBombWarning")
@pytest.mark.parametrize("kind", ["PNG", "JPEG"])
def test_an_image_of_more_pixels_than_pillow_allows_is_refused_by_name(path, monkeypatch, kind):
    path.write_bytes(saved(COLOUR, kind=kind))
    monkeypatch.setattr(PillowImage, "MAX_IMAGE_PIXELS", HEIGHT * WIDTH)
    assert read_image(path).shape == (HEIGHT, WIDTH, 3)
    monkeypatch.setattr(PillowImage, "MAX_IMAGE_PIXELS", HEIGHT * WIDTH - 1)
    with pytest.raises(BadInput, match=r"frame\.png .*50 x 37 pixels; at most 1,849 "):
        read_image(path)


def changed(content, at):
    return content[:at] + bytes([content[at] ^ 0x10]) + content[at + 1 :]


WHOLE = {kind: saved(noise(40, 40, 3), kind=kind) for kind in ("PNG", "JPEG")}
BAD = {
    "a truncated PNG": WHOLE["PNG"][:2000],
    "a PNG without its last pixels": WHOLE["PNG"][:-40],
    "a changed byte among the pixels": changed(WHOLE["PNG"], len(WHOLE["PNG"]) // 2),
    "a changed byte in the header": changed(WHOLE["PNG"], 20),
    "a truncated JPEG": WHOLE["JPEG"][:1000],
    "empty": b"",
    "a web page": b"<!doctype html>",
}


@pytest.mark.parametrize("content", BAD.values(), ids=BAD)
def test_a_file_that_is_no_whole_image_is_answered_in_one_line_with_its_path(path, content):
    path.write_bytes(content)
    assert "frame.png" in answer(read_image, path)


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


KINDS = ("bilinear", "bicubic")
CHANGES = [((32, 48), (10, 13)), ((9, 14), (20, 31)), ((40, 20), (7, 41)), ((64, 64), (1, 1))]


def filter_of(kind, antialiased, x):
    """The triangle, or Keys' cubic convolution: a = -0.5 where images are antialiased, -0.75 elsewhere."""
    x, a = np.abs(x), -0.5 if antialiased else -0.75
    if kind == "bilinear":
        return np.maximum(1 - x, 0)
    near, far = ((a + 2) * x - (a + 3)) * x**2 + 1, a * (x**3 - 5 * x**2 + 8 * x - 4)
    return np.where(x <= 1, near, np.where(x < 2, far, 0))


def weights(n_in, n_out, kind, antialiased):
    """What each of `n_out` takes from each of `n_in`: pixel centres at half, rows summing to 1.

    An antialiasing filter is as wide as the output's pixels; the other one repeats the outermost input pixels.
    """
    scale = n_in / n_out
    width = max(scale, 1) if antialiased else 1
    repeated = 0 if antialiased else 4
    inputs = np.arange(-repeated, n_in + repeated)
    found = filter_of(kind, antialiased, (inputs + 0.5 - (np.arange(n_out)[:, None] + 0.5) * scale) / width)
    found /= found.sum(1, keepdims=True)
    folded = np.zeros((n_out, n_in))
    for column, place in enumerate(np.clip(inputs, 0, n_in - 1)):
        folded[:, place] += found[:, column]
    return folded


def filtered_exactly(image, height, width, kind, antialiased):
    """Resize (h, w, 3) without rounding anything."""
    down, across = (weights(*sides, kind, antialiased) for sides in zip(image.shape, (height, width), strict=False))
    return np.einsum("yh,hwc,xw->yxc", down, image.astype(np.float64), across)


def random_image(size, low=0, high=256):
    return np.random.default_rng(sum(size)).integers(low, high, (*size, 3), dtype=np.uint8)


def as_batch(image):
    return torch.from_numpy(image.astype(np.float32)).permute(2, 0, 1)[None]


def by(how):
    if how == "tensor":
        return lambda image, *size, kind: resize_batch(as_batch(image), *size, kind)[0].permute(1, 2, 0).numpy()
    return lambda image, *size, kind: resize_image(image, *size, how, kind)


# Images are rounded twice, for columns, then for rows.
@pytest.mark.parametrize(("before", "after"), CHANGES)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("how", "antialiased", "within"), [("tensor", True, 1e-3), ("pillow", True, 1.2), ("opencv", False, 1.2)]
)
def test_antialiasing_filters_are_as_wide_as_the_new_pixels(how, antialiased, within, kind, before, after):
    image = random_image(before, 64, 192)
    found = by(how)(image, *after, kind=kind)
    assert np.abs(found - filtered_exactly(image, *after, kind, antialiased)).max() < within


@pytest.mark.parametrize("size", [(10, 13), (64, 96), (70, 40)])
def test_areas_are_means_that_are_not_rounded_or_bilinear_where_a_side_grows(size):
    image = random_image((40, 52))
    found = resize_image(image, *size, "area", "bicubic")
    assert found.dtype == np.float32
    if size == (10, 13):
        np.testing.assert_allclose(found, image.reshape(10, 4, 13, 4, 3).mean((1, 3)), atol=1e-3)
    else:
        assert np.abs(found - filtered_exactly(image, *size, "bilinear", False)).max() < 1e-2

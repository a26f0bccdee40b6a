"""Each way to resize images is its filter."""

import numpy as np
import pytest
import torch

from vprbench.api.neural import resize_batch, resize_image

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


def by(how):
    def as_tensor(image, *size, kind):
        batch = torch.from_numpy(image.astype(np.float32)).permute(2, 0, 1)[None]
        return resize_batch(batch, *size, kind)[0].permute(1, 2, 0).numpy()

    return as_tensor if how == "tensor" else lambda image, *size, kind: resize_image(image, *size, how, kind)


# Images are rounded twice, for columns, then for rows.
@pytest.mark.parametrize(("before", "after"), CHANGES)
@pytest.mark.parametrize("kind", ["bilinear", "bicubic"])
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

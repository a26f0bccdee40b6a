"""Resizing: each way against filters worked out in float64 here, and against the others."""

from __future__ import annotations

from typing import get_args

import numpy as np
import numpy.typing as npt
import pytest
import torch

from vprbench.api.arrays import Image
from vprbench.api.resize import Interpolation, resize_batch, resize_image

KINDS = get_args(Interpolation)
SIZES = [((32, 48), (10, 13)), ((33, 47), (11, 30)), ((9, 14), (20, 31)), ((40, 20), (7, 41)), ((64, 64), (1, 1))]


def triangle(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.maximum(1 - np.abs(x), 0)


def cubic(a: float):
    """Keys' cubic convolution; a = -0.5 where images are antialiased, -0.75 elsewhere."""

    def kernel(x: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        x = np.abs(x)
        near = ((a + 2) * x - (a + 3)) * x**2 + 1
        far = a * (x**3 - 5 * x**2 + 8 * x - 4)
        return np.where(x <= 1, near, np.where(x < 2, far, 0))

    return kernel


def weights(n_in: int, n_out: int, kernel, antialiased: bool) -> npt.NDArray[np.float64]:
    """Return what each of `n_out` takes from each of `n_in`: pixel centres at half, rows summing to 1.

    An antialiasing filter is as wide as the output's pixels; the other one as the input's, at whose border the
    outermost pixel is repeated.
    """
    scale = n_in / n_out
    width = max(scale, 1) if antialiased else 1
    repeated = 0 if antialiased else 4
    inputs = np.arange(-repeated, n_in + repeated)
    found = kernel((inputs + 0.5 - (np.arange(n_out)[:, None] + 0.5) * scale) / width)
    found /= found.sum(1, keepdims=True)
    folded = np.zeros((n_out, n_in))
    for column, place in enumerate(np.clip(inputs, 0, n_in - 1)):
        folded[:, place] += found[:, column]
    return folded


def wanted(image: npt.NDArray, height: int, width: int, kernel, antialiased: bool = True) -> npt.NDArray[np.float64]:
    """Resize (h, w, 3) without rounding anything."""
    down = weights(image.shape[0], height, kernel, antialiased)
    across = weights(image.shape[1], width, kernel, antialiased)
    return np.einsum("yh,hwc,xw->yxc", down, image.astype(np.float64), across)


KERNELS = {"bilinear": triangle, "bicubic": cubic(-0.5)}
NARROW_KERNELS = {"bilinear": triangle, "bicubic": cubic(-0.75)}


def noise(size: tuple[int, int], low: int = 0, high: int = 256) -> Image:
    return np.random.default_rng(sum(size)).integers(low, high, (*size, 3), dtype=np.uint8)


def as_batch(image: npt.NDArray) -> torch.Tensor:
    return torch.from_numpy(image.astype(np.float32)).permute(2, 0, 1)[None]


def as_image(batch: torch.Tensor) -> npt.NDArray[np.float32]:
    return batch[0].permute(1, 2, 0).numpy()


def by_tensor(image: npt.NDArray, height: int, width: int, kind: Interpolation):
    return as_image(resize_batch(as_batch(image), height, width, kind))


def by(how):
    return lambda image, height, width, kind: resize_image(image, height, width, how, kind)


# Images are rounded twice, for columns, then for rows.
FILTERS = {
    "tensor": (by_tensor, True, 1e-3),
    "pillow": (by("pillow"), True, 1.2),
    "opencv": (by("opencv"), False, 1.2),
}


@pytest.mark.parametrize(("before", "after"), SIZES)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("way", FILTERS)
def test_antialiased_levels_are_filtered_as_wide_as_the_new_pixels_and_others_as_the_old(
    way, kind, before, after
) -> None:
    resize, antialiased, tolerance = FILTERS[way]
    image = noise(before, 64, 192)
    kernel = (KERNELS if antialiased else NARROW_KERNELS)[kind]
    assert np.abs(resize(image, *after, kind) - wanted(image, *after, kernel, antialiased)).max() < tolerance


def test_bicubic_levels_are_cut_in_an_image_and_not_in_a_tensor() -> None:
    edge = np.zeros((12, 12, 3), np.uint8)
    edge[:, 6:] = 255
    tensor = as_image(resize_batch(as_batch(edge), 30, 30, "bicubic"))
    assert tensor.min() < -5
    assert tensor.max() > 260
    for how in ("pillow", "opencv"):
        image = resize_image(edge, 30, 30, how, "bicubic")
        assert (image.min(), image.max()) == (0, 255)


@pytest.mark.parametrize("how", ["pillow", "opencv"])
def test_a_part_of_an_image_is_resized_and_left_as_it_was(how) -> None:
    whole = noise((40, 50))
    before = whole.copy()
    resized = resize_image(whole[4:36, ::-2], 8, 9, how, "bilinear")
    assert resized.dtype == np.uint8
    assert np.array_equal(resized, resize_image(np.ascontiguousarray(before[4:36, ::-2]), 8, 9, how, "bilinear"))
    assert np.array_equal(whole, before)


@pytest.mark.parametrize("kind", KINDS)
def test_what_has_the_size_already_is_returned_itself(kind) -> None:
    image, batch = noise((12, 20)), as_batch(noise((12, 20)))
    assert all(resize_image(image, 12, 20, how, kind) is image for how in ("pillow", "opencv", "area"))
    assert resize_batch(batch, 12, 20, kind) is batch


def test_images_of_a_batch_and_their_channels_do_not_mix() -> None:
    images = [noise((20, 30), 0, 100), noise((20, 31))[:, 1:]]
    together = resize_batch(torch.cat([as_batch(image) for image in images]), 7, 9, "bilinear")
    for found, image in zip(together, images, strict=True):
        for channel in range(3):
            alone = resize_batch(as_batch(image)[:, channel : channel + 1], 7, 9, "bilinear")
            assert torch.allclose(found[channel], alone[0, 0], atol=1e-4)

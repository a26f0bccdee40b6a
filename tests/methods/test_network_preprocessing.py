"""What each network sees of an image, in its authors' evaluation and in VPR-methods-evaluation, against plain NumPy."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from described_images import composed, drawn_images
from PIL import Image as PillowImage
from published_networks import SmallNetwork
from torch import Tensor
from torch.nn import functional

from vprbench.api.arrays import Image
from vprbench.api.images import Images
from vprbench.api.neural import NeuralDescriptor
from vprbench.errors import BadInput
from vprbench.plugins import registry

Levels = npt.NDArray[Any]

ENTRIES = registry.entries("method")
NETWORKS = [name for name, entry in ENTRIES.items() if issubclass(entry.target(), NeuralDescriptor)]
configuration = cache(lambda name: composed(f"method={name}"))
LARGE, SMALL = (768, 2048), (47, 61)
AVERAGE = (117.5, 120.25, 90.75)  # what the network of `netvlad` sees images less of


def shown(name: str, image: Image, **changed: Any) -> tuple[NeuralDescriptor, Tensor]:
    """A method, and what its network sees of an image, (3, height, width)."""
    method = registry.make_method({**configuration(name), **changed})
    assert isinstance(method, NeuralDescriptor)
    method.use(network := SmallNetwork())
    network.mean = AVERAGE if name == "netvlad" else None
    method.encode(Images.from_arrays([image]))
    return method, network.seen[0]


def seen(name: str, image: Image, **changed: Any) -> Levels:
    """What the network sees, as levels 0..255, (height, width, 3)."""
    values = shown(name, image, **changed)[1].permute(1, 2, 0).double().numpy()
    if name == "netvlad":
        return values + AVERAGE
    return (values * [0.229, 0.224, 0.225] + [0.485, 0.456, 0.406]) * 255


def pillow(side: tuple[int, int]) -> Callable[[Image], Levels]:
    size = side[::-1]
    return lambda image: np.asarray(PillowImage.fromarray(image).resize(size, PillowImage.Resampling.BILINEAR))


def floats(side: tuple[int, int], mode: str = "bilinear") -> Callable[[Image], Levels]:
    def resized(image: Image) -> Levels:
        levels = torch.from_numpy(image).permute(2, 0, 1)[None].double()
        if levels.shape[2:] != side:
            levels = functional.interpolate(levels, side, mode=mode, antialias=True, align_corners=False)
        return levels[0].permute(1, 2, 0).numpy()

    return resized


def means_of_four(image: Image) -> Levels:
    return image.reshape(image.shape[0] // 2, 2, image.shape[1] // 2, 2, 3).mean((1, 3))


AUTHORS: list[tuple[str, tuple[int, int], Callable[[Image], Levels]]] = [
    ("netvlad", LARGE, means_of_four),  # hloc: at most 1024 pixels
    ("netvlad", SMALL, lambda image: image),
    ("netvlad_pytorch", LARGE, lambda image: image),
    ("netvlad_msls", LARGE, pillow((480, 640))),
    ("patch_netvlad", LARGE, pillow((480, 640))),
    ("gcl", LARGE, pillow((480, 640))),
    ("cosplace", LARGE, lambda image: image),
    ("eigenplaces", LARGE, lambda image: image),
    ("mixvpr", LARGE, pillow((320, 320))),
    ("dinov2", LARGE, pillow((322, 322))),  # this project's choice
    ("salad", LARGE, pillow((322, 322))),
    ("boq", LARGE, floats((322, 322), "bicubic")),
    ("boq_resnet50", LARGE, floats((384, 384), "bicubic")),
    ("megaloc", SMALL, floats((42, 56))),
    ("anyloc", SMALL, lambda image: image[2:44, 2:58]),  # 42x56 from the middle: halves of a pixel go to even rows
    ("anyloc", LARGE, lambda image: floats((384, 1024), "bicubic")(image)[3:381, 1:1023]),
]


@pytest.mark.parametrize(("name", "size", "expected"), AUTHORS)
def test_images_are_seen_as_in_the_authors_evaluation(name: str, size: tuple[int, int], expected) -> None:
    (image,) = drawn_images(size)
    found, wanted = seen(name, image), expected(image)
    assert found.shape == wanted.shape
    assert np.abs(found - wanted).max() < 0.1


@pytest.mark.parametrize(
    ("name", "size"), [*((name, (200, 301)) for name in NETWORKS), ("netvlad", LARGE), ("anyloc", LARGE)]
)
def test_images_are_seen_as_in_vpr_methods_evaluation_by_every_network(name: str, size: tuple[int, int]) -> None:
    (image,) = drawn_images(size)
    config = configuration(name)
    assert config["preprocessing"] == "authors"
    multiple = ENTRIES[name].target().multiple
    given = config["height"] or size[0], config["width"] or size[1]
    side = round(given[0] / multiple) * multiple, round(given[1] / multiple) * multiple
    asked = {"preprocessing": "vpr_methods_evaluation", "resize": "opencv", "interpolation": "bicubic"}
    method, found = shown(name, image, **asked)
    normalised = method.pixels(torch.from_numpy(image).permute(2, 0, 1)[None].double())[0].permute(1, 2, 0).numpy()
    wanted = torch.from_numpy(floats(side)(normalised)).permute(2, 0, 1)
    assert found.shape == wanted.shape
    assert (found - wanted).abs().max() < np.ptp(normalised) / 2000


@pytest.mark.parametrize(
    ("how", "expected"), [("pillow", pillow((384, 1024))), ("tensor", floats((384, 1024))), ("area", means_of_four)]
)
def test_netvlad_shrinks_large_images_by_other_kernels_on_request(how: str, expected) -> None:
    (image,) = drawn_images(LARGE)
    assert np.abs(seen("netvlad", image, resize=how) - expected(image)).max() < 0.1


def test_area_enlarges_by_interpolation() -> None:
    edge = np.full((8, 8, 3), 100, np.uint8)
    edge[:, 4:] = 200
    levels = seen("netvlad", edge, height=16, width=32)[8, :, 0]
    assert set(levels.round(1)) == {100.0, 112.5, 137.5, 162.5, 187.5, 200.0}


def test_anyloc_refuses_an_image_without_a_whole_patch() -> None:
    with pytest.raises(BadInput, match="AnyLoc needs 14 pixels a side"):
        seen("anyloc", drawn_images((13, 40))[0])

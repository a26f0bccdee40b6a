"""What the tests of networks share: images, how far descriptors lie apart, and methods as they are composed."""

from __future__ import annotations

from typing import Any

import cv2
import hydra
import numpy as np
import numpy.typing as npt
from omegaconf import OmegaConf
from PIL import Image as PillowImage

from vprbench.api.arrays import Image
from vprbench.api.images import Images
from vprbench.api.method import Method


def image(height: int, width: int, seed: int = 0) -> Image:
    """Return noise."""
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def pillow(image: Image, height: int, width: int, how: Any = PillowImage.Resampling.BILINEAR) -> Image:
    """Return an image as Pillow resizes it, antialiased."""
    return np.asarray(PillowImage.fromarray(image).resize((width, height), how))


def drawn_images(*sizes: tuple[int, int], seed: int = 0) -> list[Image]:
    """Return images of coarse and fine structure, (height, width, 3)."""
    generator = np.random.default_rng(seed)
    images = []
    for height, width in sizes:
        coarse = cv2.resize(generator.integers(0, 256, (5, 7, 3), dtype=np.uint8), (width, height))
        images.append(np.clip(coarse + generator.normal(0, 30, (height, width, 3)), 0, 255).astype(np.uint8))
    return images


def encoded(method: Method, *images: Image) -> npt.NDArray[np.float32]:
    """Return the codes of images."""
    return method.encode(Images.from_arrays(list(images)))


def distance(codes: npt.NDArray[Any], others: npt.NDArray[Any]) -> float:
    """Return the largest difference between numbers."""
    return float(np.abs(codes - others).max())


def composed(*overrides: str) -> dict[str, Any]:
    """Return the configuration of the method that a run with these options gets."""
    with hydra.initialize_config_module("vprbench.conf", version_base="1.3"):
        config = OmegaConf.to_container(hydra.compose("run", overrides=list(overrides)), resolve=True)
    return config["method"]  # type: ignore[index, call-overload, return-value]

"""What the tests of networks share: images, how far descriptors lie apart, and methods as they are composed."""

import cv2
import hydra
import numpy as np
from omegaconf import OmegaConf
from PIL import Image as PillowImage

from vprbench.api.images import Images


def image(height, width, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def pillow(image, height, width, how=PillowImage.Resampling.BILINEAR):
    """Return an image as Pillow resizes it, antialiased."""
    return np.asarray(PillowImage.fromarray(image).resize((width, height), how))


def drawn_images(*sizes, seed=0):
    """Return images of coarse and fine structure, (height, width, 3)."""
    generator = np.random.default_rng(seed)
    images = []
    for height, width in sizes:
        coarse = cv2.resize(generator.integers(0, 256, (5, 7, 3), dtype=np.uint8), (width, height))
        images.append(np.clip(coarse + generator.normal(0, 30, (height, width, 3)), 0, 255).astype(np.uint8))
    return images


def encoded(method, *images):
    return method.encode(Images.from_arrays(list(images)))


def distance(codes, others):
    return float(np.abs(codes - others).max())


def composed(*overrides):
    """Return the configuration of the method that a run with these options gets."""
    with hydra.initialize_config_module("vprbench.conf", version_base="1.3"):
        config = OmegaConf.to_container(hydra.compose("run", overrides=list(overrides)), resolve=True)
    return config["method"]

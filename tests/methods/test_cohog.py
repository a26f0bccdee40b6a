"""CoHOG against a slow float64 implementation."""

import cohog_oracle as oracle
import cv2
import numpy as np
import pytest

from vprbench.api.images import Images
from vprbench.methods.cohog import CoHOG

SMALL = {"size": 64, "cell": 8, "entropy_size": 20, "entropy_radius": 3, "entropy_threshold": 0.45}


def scene(seed, height=31, width=47):
    """A smooth picture of noise with a flat and a nearly flat corner."""
    generator = np.random.default_rng(seed)
    coarse = generator.integers(0, 256, (6, 8, 3), dtype=np.uint8)
    image = np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC), np.uint8).copy()
    image[: height // 2, : width // 3] = 77
    image[height // 2 :, : width // 3] = 120 + generator.integers(0, 2, (1, 1, 3), dtype=np.uint8)
    return image


def resized(image, size):
    return cv2.resize(image, (size, size), interpolation=cv2.INTER_LINEAR)


def judged(images, size, cell, entropy_size, entropy_radius, **_):
    """Regions and their mean entropy by the slow implementation."""
    greys = [resized(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), size) for image in images]
    regions = [oracle.regions(oracle.histograms(grey, cell, 8)) for grey in greys]
    entropies = [oracle.region_entropy(resized(grey, entropy_size), entropy_radius, size, cell) for grey in greys]
    return np.stack(regions), np.stack(entropies)


def test_regions_their_goodness_and_scores_equal_the_slow_implementation():
    images = [scene(0), scene(1, 64, 64), scene(2, 101, 33), np.zeros((7, 9, 3), np.uint8)]
    regions, entropies = judged(images, **SMALL)
    good = entropies >= SMALL["entropy_threshold"]
    sure = np.abs(entropies - SMALL["entropy_threshold"]) > 1e-6
    assert 0.1 < good.mean() < 0.9
    codes = CoHOG(**SMALL).encode(Images.from_arrays(images))
    assert codes.dtype == np.float32
    assert codes[..., :-1] == pytest.approx(regions, abs=1e-4)
    assert np.array_equal((codes[..., -1] == 1)[sure], good[sure])
    wanted = [
        [oracle.score(query, chosen, other) for other in regions] for query, chosen in zip(regions, good, strict=True)
    ]
    method = CoHOG(**SMALL).fit(Images.from_arrays(images), np.arange(len(images)))
    assert method.match(codes) == pytest.approx(np.array(wanted), abs=1e-4)

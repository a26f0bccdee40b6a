"""CoHOG against a slow float64 implementation, examples by hand and the results that VPR-Bench stored."""

import cohog_oracle as oracle
import cv2
import numpy as np
import pytest
import torch
from corridor import needs_corridor, right, scored, stored

from vprbench.api.images import Images
from vprbench.methods.cohog import CoHOG

SMALL = {"size": 64, "cell": 8, "entropy_size": 20, "entropy_radius": 3, "entropy_threshold": 0.45}
PUBLISHED = {"size": 512, "cell": 16, "entropy_size": 100, "entropy_radius": 5, "entropy_threshold": 0.4}


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


def unit(*numbers):
    return np.isin(np.arange(32), numbers).astype(np.float32) / max(1, len(numbers)) ** 0.5


THREE = [unit(0), unit(0), unit(2), unit()], [unit(0), unit(1), unit(2), unit(0, 5)]


@pytest.mark.parametrize(
    ("reference", "query", "good", "wanted"),
    [
        (*THREE, [1, 1, 0, 1], (1 + 0.5**0.5) / 3),
        ([unit(0)] * 4, [unit(0), unit(), unit(), unit()], [1, 1, 0, 0], 1 / 2),  # one without a gradient counts
        ([unit(0)] * 4, [unit(0)] * 4, [0] * 4, 0),  # none is good
    ],
)
def test_a_score_is_the_mean_over_the_good_regions_of_the_best_region(reference, query, good, wanted):
    method = CoHOG(size=48)
    method._references, method._places = torch.tensor(np.array([reference])), np.arange(1)
    code = np.column_stack([query, good]).astype(np.float32)[None]
    assert method.match(code)[0] == pytest.approx([wanted])


def judged(images, size, cell, entropy_size, entropy_radius, **_):
    """Regions and their mean entropy by the slow implementation."""
    greys = [resized(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), size) for image in images]
    regions = [oracle.regions(oracle.histograms(grey, cell, 8)) for grey in greys]
    entropies = [oracle.region_entropy(resized(grey, entropy_size), entropy_radius, size, cell) for grey in greys]
    return np.stack(regions), np.stack(entropies)


@pytest.mark.parametrize(
    ("arguments", "constants", "images"),
    [
        (SMALL, SMALL, [scene(0), scene(1, 64, 64), scene(2, 101, 33), np.zeros((7, 9, 3), np.uint8)]),
        pytest.param({}, PUBLISHED, [scene(3, 97, 131)], marks=pytest.mark.extended),
    ],
    ids=["small", "published"],
)
def test_regions_their_goodness_and_scores_equal_the_slow_implementation(arguments, constants, images):
    regions, entropies = judged(images, **constants)
    good = entropies >= constants["entropy_threshold"]
    sure = np.abs(entropies - constants["entropy_threshold"]) > 1e-6
    assert 0.1 < good.mean() < 0.9
    codes = CoHOG(**arguments).encode(Images.from_arrays(images))
    assert codes.dtype == np.float32
    assert codes[..., :-1] == pytest.approx(regions, abs=1e-4)
    assert np.array_equal((codes[..., -1] == 1)[sure], good[sure])
    wanted = [
        [oracle.score(query, chosen, other) for other in regions] for query, chosen in zip(regions, good, strict=True)
    ]
    method = CoHOG(**arguments).fit(Images.from_arrays(images), np.arange(len(images)))
    assert method.match(codes) == pytest.approx(np.array(wanted), abs=1e-4)
    assert {name: getattr(CoHOG(), name) for name in PUBLISHED} == PUBLISHED
    assert (method.bins, method.region_cells, method.sobel) == (8, 2, 5)


@needs_corridor
def test_corridor_scores_are_those_that_vprbench_stored():
    # Stored: 69 of 111 within two frames; the same rule gives SAD 49 (0.4414). Four best matches are near-ties.
    every, whole = 3, stored("CoHOG")
    scores, some = scored(CoHOG(), every), whole[::every]
    assert right(scores, every) == pytest.approx(right(some, every), abs=2)
    assert np.median(np.abs(scores - some)) < 1e-4
    assert np.abs(scores - some).max() < 4e-3
    assert np.count_nonzero(scores.argmax(1) == some.argmax(1)) >= len(some) - 4

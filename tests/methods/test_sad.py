"""SAD against brute force, hand-made codes and the rate measured on real frames by other code."""

import cv2
import numpy as np
import pytest
from checkout import SHARED

from vprbench.api.images import Images
from vprbench.datasets.nordland import nordland
from vprbench.methods.sad import SAD
from vprbench.metrics.intervals import block_bootstrap, share_interval

needs_shared = pytest.mark.skipif(
    not (SHARED / "data").is_dir(), reason="the folder shared/ is not beside the checkout"
)


class Pixels(SAD):
    """SAD on raw pixels: its codes are made by hand."""

    def encode(self, images):
        return np.stack([image[:, :, 0].ravel() for image in images])


def pixel_sad(references, places=None):
    references = np.asarray(references, np.uint8)
    places = np.arange(len(references)) if places is None else np.asarray(places)
    return Pixels().fit(Images.from_arrays(list(references[:, None])), places)


def frames(n, seed=0):
    generator = np.random.default_rng(seed)
    return Images.from_arrays([generator.integers(0, 256, (30, 40, 3), dtype=np.uint8) for _ in range(n)])


def codes(n, n_pixels, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (n, n_pixels), dtype=np.uint8)


def test_a_score_is_minus_the_mean_absolute_difference():
    # |10 - 7| + |0 - 4| + |3 - 3| + |8 - 9| = 8 over four pixels
    assert pixel_sad([[10, 0, 3, 8]]).match(np.array([[7, 4, 3, 9]], np.uint8)).tolist() == [[-2]]


def test_an_image_scores_0_at_its_own_place():
    images = frames(8)
    scores = SAD().fit(images, np.arange(8)).query(images)
    assert np.diagonal(scores).tolist() == [0] * 8


@needs_shared
def test_raw_sad_on_corridor_finds_47_of_111():
    # Regression anchor of the spec (metrics.md): 28x28 INTER_AREA grey, right is within two frames.
    def grey(traverse):
        paths = sorted((SHARED / "data" / "corridor" / traverse).glob("*.jpg"))
        levels = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in paths]
        return np.stack([cv2.resize(level, (28, 28), interpolation=cv2.INTER_AREA).ravel() for level in levels])

    best = pixel_sad(grey("ref")).match(grey("query")).argmax(axis=1)
    assert np.count_nonzero(np.abs(best - np.arange(111)) <= 2) == 47


@pytest.fixture(scope="module")
def ranks() -> np.ndarray:
    """How many places score above the right one, for each query of nordland_64x32."""
    dataset = nordland(
        root=str(SHARED / "data" / "nordland_64x32"),
        references=["winter"],
        stride=1,
        places=2761,
        query_places=2761,
        first_query_place=0,
        frame_multiple=10,
    )
    scores = SAD().fit(dataset.references, dataset.places).query(dataset.queries)
    return np.count_nonzero(scores > np.diagonal(scores)[:, None], axis=1)


@needs_shared
def test_sad_on_nordland_64x32_reaches_the_recall_of_independent_code(ranks):
    # Source of the rates: table "Orientation on real frames" of the VPRTempo rules document.
    rates = [float(np.mean(ranks < n)) for n in (1, 5, 10, 25)]
    assert rates == pytest.approx([0.2503, 0.4006, 0.4636, 0.5531], abs=0.003)


@needs_shared
@pytest.mark.parametrize(("block", "half_width"), [(1, 0.016), (10, 0.028), (50, 0.046), (100, 0.061)])
def test_the_interval_of_sad_on_nordland_64x32_widens_with_the_blocks_as_independent_code_found(
    ranks, block, half_width
):
    found = block_bootstrap(ranks == 0, block)
    assert (found.high - found.low) / 2 == pytest.approx(half_width, abs=0.0015)


@needs_shared
def test_frames_of_nordland_64x32_are_alike_over_many_more_than_ten_and_the_interval_knows(ranks):
    found = share_interval(ranks == 0)
    assert found.kind == "blocks"
    assert 50 < found.block <= 158  # 3 sqrt(2761)
    assert found.high - found.low > 4 * 0.016  # at least twice as wide as without blocks

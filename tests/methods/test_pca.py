"""PCA against numpy's eigenvectors in float64, worked examples and stored projections."""

import numpy as np
import pytest

from vprbench.api.images import Images
from vprbench.methods.pca import PCA
from vprbench.methods.sad import SAD


def slow_scores(references, queries, components, whiten):
    """Cosines of the projections on the eigenvectors of the covariance."""
    mean = references.mean(axis=0)
    variances, directions = np.linalg.eigh(np.cov(references.T.astype(float)))
    projection = directions[:, ::-1][:, :components]
    if whiten:
        projection = projection / np.sqrt(variances[::-1][:components])
    left, right = (queries - mean) @ projection, (references - mean) @ projection
    norms = np.linalg.norm(left, axis=1)[:, None] * np.linalg.norm(right, axis=1)
    return left @ right.T / norms


def frames(n, seed=0, height=6, width=5):
    """Grey frames whose pixels vary together, so that a few components say much."""
    generator = np.random.default_rng(seed)
    scenes = generator.normal(size=(n, 4)) @ np.random.default_rng(9).normal(size=(4, height * width))
    levels = np.clip(128 + 25 * scenes + generator.normal(scale=6, size=scenes.shape), 0, 255)
    return levels.astype(np.uint8).reshape(n, height, width)


def images(levels):
    return Images.from_arrays(list(np.asarray(levels, np.uint8)))


def grey_pca(height=6, width=5, **arguments):
    return PCA(preprocessing="grey", height=height, width=width, **arguments)


def fitted(levels, **arguments):
    return grey_pca(*levels.shape[1:], **arguments).fit(images(levels), np.arange(len(levels)))


@pytest.mark.parametrize(
    ("arguments", "tolerance"),
    [
        ({"components": 1}, 1e-5),
        ({"components": 20}, 1e-5),
        ({"components": 4, "whiten": True}, 1e-5),
    ],
)
def test_scores_equal_those_of_the_covariances_eigenvectors(arguments, tolerance):
    references, queries = frames(50, seed=1), frames(7, seed=2)
    scores = fitted(references, **arguments).query(images(queries))
    whiten = arguments.get("whiten", False)
    expected = slow_scores(references.reshape(50, -1), queries.reshape(7, -1), arguments["components"], whiten)
    assert scores.dtype == np.float32
    assert np.abs(scores - expected).max() < tolerance


@pytest.mark.parametrize(
    ("levels", "found"),
    [
        (np.concatenate([frames(5)] * 3), (30, 4)),  # repeated references
        (frames(50, height=2, width=3), (6, 6)),  # all pixels
        (frames(1), (30, 0)),
        (np.zeros((4, 6, 5), np.uint8), (30, 0)),
    ],
)
def test_components_are_no_more_than_different_references_or_pixels(levels, found):
    method = fitted(levels, components=128, whiten=True)
    assert method._map.projection.shape == found
    assert np.diagonal(method.query(images(levels))) == pytest.approx(float(found[1] > 0), abs=1e-6)
    np.testing.assert_allclose(np.linalg.norm(method._map.references, axis=1), float(found[1] > 0), atol=1e-6)


def test_pixels_are_antialiased_grey_of_rgb_or_patch_normalised_as_those_of_sad():
    image = np.random.default_rng(0).integers(0, 256, (24, 20), dtype=np.uint8)
    means = image.reshape(6, 4, 5, 4).mean(axis=(1, 3))
    assert np.abs(grey_pca().encode(images([image])).reshape(6, 5) - means).max() <= 0.5
    red = np.zeros((6, 5, 3), np.uint8)
    red[:, :, 0] = 200
    assert set(grey_pca().encode(Images.from_arrays([red]))[0].tolist()) == {60}  # 0.299 * 200; 23 from BGR
    picture = images(frames(3, height=40, width=50))
    assert np.array_equal(PCA().encode(picture), SAD().encode(picture))

"""PCA against numpy's eigenvectors in float64, worked examples and stored projections."""

import cv2
import numpy as np
import pytest
from checkout import SHARED

from vprbench.api.images import Images
from vprbench.datasets.folders import folders
from vprbench.errors import BadInput
from vprbench.methods.pca import PCA
from vprbench.methods.sad import SAD

needs_shared = pytest.mark.skipif(
    not (SHARED / "data").is_dir(), reason="the folder shared/ is not beside the checkout"
)


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


@pytest.mark.parametrize("whiten", [False, True])
@pytest.mark.parametrize("components", [1, 4, 20])
def test_scores_equal_those_of_the_covariances_eigenvectors(components, whiten):
    references, queries = frames(50, seed=1), frames(7, seed=2)
    scores = fitted(references, components=components, whiten=whiten).query(images(queries))
    expected = slow_scores(references.reshape(50, -1), queries.reshape(7, -1), components, whiten)
    assert scores.dtype == np.float32
    assert np.abs(scores - expected).max() < 1e-5


def test_the_randomized_solver_finds_the_strong_components():
    references, queries = frames(50, seed=1), frames(7, seed=2)
    scores = fitted(references, components=4, solver="randomized").query(images(queries))
    assert np.abs(scores - slow_scores(references.reshape(50, -1), queries.reshape(7, -1), 4, False)).max() < 1e-3


def test_the_randomized_solver_draws_from_the_seed():
    references, queries = frames(60, seed=1, height=12, width=12), frames(5, seed=2, height=12, width=12)
    first, again, other = (
        fitted(references, components=10, solver="randomized", seed=seed).query(images(queries)) for seed in (0, 0, 1)
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


CROSS = np.array([[[100, 140]], [[100, 60]], [[110, 100]], [[90, 100]]])  # mean (100, 100), mostly along the second


def test_only_what_lies_along_the_first_component_counts():
    # Of the query (130, 110) the deviation is (30, 10), of which the first component sees +10.
    scores = fitted(CROSS, components=1).query(images([[[130, 110]]]))
    assert scores[0] == pytest.approx([1, -1, 0, 0], abs=1e-6)


def test_scores_are_cosines_of_deviations_from_the_references_mean():
    # The deviation (30, 40) has the cosine 40 / 50 with (0, 40) and 30 / 50 with (10, 0).
    scores = fitted(CROSS, components=2).query(images([[[130, 140]]]))
    assert scores[0] == pytest.approx([0.8, -0.8, 0.6, -0.6], abs=1e-6)


def test_whitening_makes_every_component_as_large_as_any():
    # Standard deviations are as 4 to 1: the deviation (10, 40) is (1, 1) then.
    scores = fitted(CROSS, components=2, whiten=True).query(images([[[110, 140]]]))
    assert scores[0] == pytest.approx(np.array([1, -1, 1, -1]) / np.sqrt(2), abs=1e-6)


@pytest.mark.parametrize(
    ("n", "height", "width", "found"), [(5, 6, 5, (30, 4)), (50, 2, 3, (6, 6)), (1, 6, 5, (30, 0))]
)
def test_fewer_references_or_pixels_give_fewer_components(n, height, width, found):
    assert fitted(frames(n, height=height, width=width), components=128).state()["projection"].shape == found


@pytest.mark.parametrize(
    ("references", "query"),
    [(frames(1), frames(3, seed=2)), (np.zeros((4, 6, 5), np.uint8), frames(2)), (CROSS, [[[100, 100]]])],
    ids=["one reference", "all black", "the mean"],
)
@pytest.mark.parametrize("whiten", [False, True])
def test_what_has_no_direction_scores_0(references, query, whiten):
    assert not fitted(references, whiten=whiten).query(images(query)).any()


def test_references_that_repeat_add_no_component():
    levels = np.concatenate([frames(5)] * 3)
    method = fitted(levels, components=128, whiten=True)
    assert method.state()["projection"].shape == (30, 4)
    assert np.diagonal(method.query(images(levels))) == pytest.approx(1, abs=1e-6)


def test_encoding_needs_no_map_and_does_not_change_with_it():
    method, queries = grey_pca(), images(frames(4, seed=2))
    before = method.encode(queries)
    method.fit(images(frames(9)), np.arange(9))
    assert np.array_equal(method.encode(queries), before)


def test_grey_pixels_are_antialiased():
    image = np.random.default_rng(0).integers(0, 256, (24, 20), dtype=np.uint8)
    means = image.reshape(6, 4, 5, 4).mean(axis=(1, 3))
    assert np.abs(grey_pca().encode(images([image])).reshape(6, 5) - means).max() <= 0.5


def test_grey_is_taken_from_rgb():
    red = np.zeros((6, 5, 3), np.uint8)
    red[:, :, 0] = 200
    assert set(grey_pca().encode(Images.from_arrays([red]))[0].tolist()) == {60}  # 0.299 * 200; 23 from BGR


def test_patch_normalised_pixels_are_those_of_sad():
    picture = images(frames(3, height=40, width=50))
    assert np.array_equal(PCA().encode(picture), SAD().encode(picture))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"components": 0}, "method.components=0: give at least 1"),
        ({"height": 0}, "method.height=0, method.width=5: give sizes of at least 1 pixel"),
    ],
)
def test_arguments_without_a_projection_are_refused(arguments, message):
    with pytest.raises(BadInput, match=message):
        grey_pca(**arguments).fit(images(frames(3)), np.arange(3))


@needs_shared
def test_on_corridor_the_recall_is_that_of_the_eigenvectors():
    folder = SHARED / "data" / "corridor"
    dataset = folders("corridor", [str(folder / "ref")], str(folder / "query"), "index", tolerance=2)
    scores = PCA(preprocessing="grey", components=32).fit(dataset.references, dataset.places).query(dataset.queries)

    def small(sequence):
        greys = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in sequence]
        return np.stack([cv2.resize(grey, (28, 28), interpolation=cv2.INTER_AREA).ravel() for grey in greys])

    expected = slow_scores(small(dataset.references), small(dataset.queries), 32, whiten=False)
    assert np.abs(scores - expected).max() < 1e-4

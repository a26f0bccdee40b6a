"""GCL's whitening against the authors' way by singular values."""

import numpy as np
import pytest
from published_networks import unit

from vprbench.api.weights import Weights
from vprbench.errors import BadInput
from vprbench.methods.gcl import GCL, Whitening


def vectors(n, seed, n_dimensions=40):
    """Unit vectors as networks give them: about a mean, with few strong directions and many weak ones."""
    generator = np.random.default_rng(seed)
    basis = np.random.default_rng(0).normal(size=(n_dimensions, n_dimensions)) / np.arange(1, n_dimensions + 1)[:, None]
    return unit(3 + generator.normal(size=(n, n_dimensions)) @ basis).astype(np.float32)


def whitened_slowly(references, vectors, kept):
    """The authors' whitening from singular values, learnt exactly and applied to float16."""
    precise = references.astype(np.float64)
    mean = precise.mean(0)
    _, sizes, directions = np.linalg.svd(precise - mean, full_matrices=False)
    rounded = vectors.astype(np.float16).astype(np.float64)
    components = (rounded - mean) @ directions[kept].T / (sizes[kept] / np.sqrt(2 * len(references)))
    return components / (np.linalg.norm(components, axis=1, keepdims=True) + 1e-6)


def scores(references, queries, n_components):
    method = GCL(weights=Weights("none", "", ""), n_components=n_components)
    return method.fit_descriptors(references, np.arange(len(references))).match(queries)


@pytest.mark.parametrize(("n_references", "n_components"), [(90, None), (90, 10), (90, 40), (25, 24), (5000, 12)])
def test_whitened_scores_are_those_of_singular_values(n_references, n_components):
    references, queries = vectors(n_references, 1), vectors(7, 2)
    left, right = queries, references
    if n_components:
        left, right = (whitened_slowly(references, codes, slice(n_components)) for codes in (queries, references))
    np.testing.assert_allclose(scores(references, queries, n_components), left @ right.T, rtol=0, atol=1e-4)


def test_repeated_references_and_constant_dimensions_add_no_components():
    assert Whitening.learn(vectors(12, 1), 2048).projection.shape == (40, 11)
    references = np.tile(vectors(6, 1), (20, 1))
    references[:, :3] = 0
    assert Whitening.learn(references, 2048).projection.shape == (40, 5)


def test_whitening_needs_a_component():
    with pytest.raises(BadInput, match=r"method.n_components=0"):
        scores(vectors(9, 1), vectors(2, 2), 0)

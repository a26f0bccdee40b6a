"""Vectors brought to unit length."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, import_faiss

_ITERATIONS = 25


def unit(vectors: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Return the rows as unit vectors; a zero row stays what it is."""
    precise = vectors.astype(np.float64)
    norms = np.linalg.norm(precise, axis=1, keepdims=True)
    return (precise / np.where(norms > 0, norms, 1)).astype(np.float32)


def k_means(
    vectors: npt.NDArray[np.float32], n_centres: int, generator: np.random.Generator
) -> npt.NDArray[np.float32]:
    """Return the centres, (n_centres, n_dimensions), of all vectors (n, n_dimensions).

    Raises BadInput if fewer vectors than centres are different.
    """
    n_different = len(np.unique(vectors, axis=0))
    if n_different < n_centres:
        raise BadInput(
            f"the references gave {n_different} different descriptors for method.words={n_centres}: give fewer words, "
            "or more or larger images with more in them"
        )
    found = import_faiss().Kmeans(
        vectors.shape[1],
        n_centres,
        niter=_ITERATIONS,
        seed=int(generator.integers(1 << 31)),
        min_points_per_centroid=1,
        max_points_per_centroid=len(vectors),
    )
    found.train(vectors)
    return np.array(found.centroids, np.float32)

"""Principal components: small frames, compared in the few directions in which the reference images differ most."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
import numpy.typing as npt
from sklearn import decomposition

from vprbench.api import BadInput, Images, Method, NotFittedError, Places, Scores, best_image_of_place, count_operations

from .parts.filters.patches import Preprocessing, pixels


@dataclass(frozen=True)
class Map:
    """The projection that the references teach, and the projected references."""

    mean: npt.NDArray[np.float64]  # (n_pixels,), grey levels
    projection: npt.NDArray[np.float64]  # (n_pixels, n_components)
    references: npt.NDArray[np.float32]  # (n_references, n_components), unit vectors
    places: Places  # (n_references,)


@dataclass
class PCA(Method):
    """Scores a place by the cosine, -1 to 1, between the principal components of its images and the query's.

    The components are learnt from the reference images by scikit-learn's PCA: the first `components`, or fewer, for
    n references differ in n - 1 directions at most and images have height * width pixels. An image that is the mean
    of the references, and every image if all references are equal, scores 0 everywhere.
    `whiten` divides each component by its standard deviation.
    The method of eigenfaces (Turk and Pentland 1991) on whole frames; the defaults are this project's own choice.
    """

    preprocessing: Preprocessing = "C"
    height: int = 28  # pixels
    width: int = 28
    patch: int = 7  # not for grey
    components: int = 128
    whiten: bool = False

    _map: Map | None = field(default=None, init=False, repr=False, compare=False)

    def fit(self, references: Images, places: Places) -> Self:
        """Learn the projection and project the references."""
        if self.components < 1:
            raise BadInput(f"method.components={self.components}: give at least 1")
        levels = self.encode(references)
        mean, projection = self._learn(levels)
        self._map = Map(mean, projection, _project_levels(levels, mean, projection), places.copy())
        return self

    def encode(self, images: Images) -> npt.NDArray[np.uint8]:
        """Return the preprocessed pixels, (n_images, height * width), levels 0..255.

        The projection is learnt from the map, so it belongs to `match`.
        """
        return pixels(images, self.preprocessing, self.height, self.width, self.patch)

    def match(self, codes: npt.NDArray[np.uint8]) -> Scores:
        """Project the pixels and return their cosines with the best reference image of each place."""
        known = self._map
        if known is None:
            raise NotFittedError("PCA has no map yet: call fit(references, places) first")
        count_operations(len(codes) * (known.projection.size + known.references.size))
        similarity = _project_levels(codes, known.mean, known.projection) @ known.references.T
        return best_image_of_place(similarity, known.places)

    def map_bytes(self) -> int | None:
        """Return the bytes of the projection, and of the projected references with their places."""
        return None if self._map is None else sum(array.nbytes for array in vars(self._map).values())

    def _learn(self, levels: npt.NDArray[np.uint8]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return mean (n_pixels,) and projection (n_pixels, n_components)."""
        pixels = levels.astype(np.float64)
        n_components = min(self.components, len(pixels) - 1, pixels.shape[1])
        if (pixels == pixels[0]).all():  # scikit-learn divides by their variance
            return pixels[0], np.empty((pixels.shape[1], 0))
        pca = decomposition.PCA(n_components, svd_solver="full").fit(pixels)
        # Where references repeat, the last components are rounding noise, which whitening would make as large as any.
        rounding = pca.singular_values_[0] * max(pixels.shape) * np.finfo(np.float64).eps
        real = pca.singular_values_ > rounding
        scale = np.sqrt(pca.explained_variance_[real]) if self.whiten else 1.0
        return pca.mean_, np.ascontiguousarray(pca.components_[real].T / scale)


def _project_levels(
    levels: npt.NDArray[np.uint8], mean: npt.NDArray[np.float64], projection: npt.NDArray[np.float64]
) -> npt.NDArray[np.float32]:
    """Return the components as unit vectors, (n_images, n_components); zero if there is nothing but rounding."""
    codes = (levels - mean) @ projection
    norms = np.linalg.norm(codes, axis=1, keepdims=True)
    return (codes / np.where(norms > 1e-12, norms, np.inf)).astype(np.float32)

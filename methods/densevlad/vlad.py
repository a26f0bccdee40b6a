"""VLAD: what an image's local descriptors differ by from their words, and the whitening of such vectors."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

_ROUNDING = 1e-5  # of a residual, per descriptor: a word whose descriptors all equal it has none
_TOGETHER = 1024  # dimensions in double precision at a time
_SMALLEST_VARIANCE = 1e-5  # of the largest; what lies below is rounding


def vlad(blocks: Iterable[Tensor], words: Tensor, word_of_zero: int = 0) -> Tensor:
    """Return the VLAD (n_words * n_dimensions,) of local descriptors (n, n_dimensions) that come in blocks.

    `words` (n_words, n_dimensions) are unit vectors, so the nearest has the largest product; of equally near ones the
    first counts. All are equally near to a zero descriptor, which belongs to `word_of_zero`. The residuals are summed
    and normalised per word, laid out word after word, and normalised together (VLFeat's vl_vlad with
    NormalizeComponents).
    """
    sums = torch.zeros_like(words)
    counts = words.new_zeros(len(words), 1)
    for block in blocks:
        nearest = torch.where(block.any(1), (block @ words.T).argmax(1), word_of_zero)
        chosen = functional.one_hot(nearest, len(words)).to(words)
        sums += chosen.T @ block
        counts += chosen.sum(0)[:, None]
    residuals = sums - counts * words
    norms = residuals.norm(dim=1, keepdim=True)
    residuals = torch.where(norms > _ROUNDING * counts, residuals / norms, 0)
    return functional.normalize(residuals.flatten(), dim=0, eps=1e-12)


def whitening(vlads: npt.NDArray[np.float32], n_components: int) -> npt.NDArray[np.float32]:
    """Learn from vectors (n, n_dimensions) the projection (n_dimensions, at most n_components) that whitens them.

    The directions of largest second moment, each divided by the root of that moment; no mean is subtracted.
    """
    n, n_dimensions = vlads.shape
    products = np.zeros((n, n))
    for first in range(0, n_dimensions, _TOGETHER):
        part = vlads[:, first : first + _TOGETHER].astype(np.float64)
        products += part @ part.T
    moments, vectors = np.linalg.eigh(products / n)
    kept = np.flatnonzero(moments > _SMALLEST_VARIANCE * moments[-1])[::-1][:n_components]
    mixing = vectors[:, kept] / (np.sqrt(n) * moments[kept])
    projection = np.empty((n_dimensions, len(kept)), np.float32)
    for first in range(0, n_dimensions, _TOGETHER):
        own = slice(first, first + _TOGETHER)
        projection[own] = vlads[:, own].astype(np.float64).T @ mixing
    return projection

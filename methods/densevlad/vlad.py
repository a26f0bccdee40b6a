"""Visual words, learnt or published, VLAD of the descriptors around them, and the whitening of such vectors."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from vprbench.api import BadInput, read_mat

from ..parts.vectors import unit
from .dense_sift import DIMENSIONS

PUBLISHED_WORDS = 128
#: The published word, counted from 0, that the authors' kd-tree gives to a zero descriptor, equally far from all.
WORD_OF_ZERO = 60

_ROUNDING = 1e-5  # of a residual, per descriptor: a word whose descriptors all equal it has none
_TOGETHER = 1024  # dimensions in double precision at a time
_SMALLEST_VARIANCE = 1e-5  # of the largest; smaller ones are rounding


def read_words(path: Path, n_words: int) -> npt.NDArray[np.float32]:
    """Return published words made unit vectors, (n_words, 128): the columns of a .mat's CX, or the rows of a .npy.

    Raises BadInput for any other file.
    """
    wanted = f"wanted a CX of {DIMENSIONS}x{n_words} finite numbers in a .mat, or {n_words}x{DIMENSIONS} in a .npy"
    try:
        words = np.load(path, allow_pickle=False) if path.suffix == ".npy" else read_mat(path, ["CX"])["CX"].T
    except (OSError, ValueError, EOFError, KeyError) as error:  # MatFileError is a ValueError
        raise BadInput(f"method.vocabulary={path} holds no words: {wanted}") from error
    if words.shape != (n_words, DIMENSIONS) or words.dtype.kind != "f" or not np.isfinite(words).all():
        raise BadInput(f"method.vocabulary={path} holds {words.dtype} {words.shape}: {wanted}")
    return unit(words)


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


def learn_whitening(vlads: npt.NDArray[np.float32], n_components: int) -> npt.NDArray[np.float32]:
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

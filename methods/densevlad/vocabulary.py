"""The visual words that DenseVLAD's authors published, as their own file or as a copy of the words alone has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, read_mat

from ..parts.vectors import unit
from .dense_sift import DIMENSIONS

PUBLISHED_WORDS = 128
#: The published word, counted from 0, that the authors' kd-tree gives to a zero descriptor, equally far from all.
WORD_OF_ZERO = 60

_SOURCE = (
    "dnscnt_RDSIFT_K128.mat from 247code.zip of http://www.ok.ctrl.titech.ac.jp/~torii/project/247/, or "
    "dnscnt_RDSIFT_K128.cx_norm.npy, the words alone, from github.com/michaelschleiss/densevlad"
)


def wanted_vocabulary(n_words: int) -> str:
    """Return what a file of this number of words has to hold."""
    return (
        f"wanted the variable CX of {DIMENSIONS}x{n_words} numbers in a .mat, or {n_words}x{DIMENSIONS} in a .npy, "
        f"such as {_SOURCE}"
    )


def read_words(path: Path, n_words: int) -> npt.NDArray[np.float32]:
    """Return published words made unit vectors, (n_words, 128): the columns of a .mat's CX, or the rows of a .npy.

    Raises BadInput for any other file.
    """
    wanted = wanted_vocabulary(n_words)
    try:
        centres = np.load(path, allow_pickle=False).T if path.suffix == ".npy" else read_mat(path, ["CX"]).get("CX")
    except (OSError, ValueError, EOFError) as error:  # MatFileError is a ValueError
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise BadInput(f"method.vocabulary={path} could not be read ({reason}): {wanted}") from error
    if not isinstance(centres, np.ndarray):
        raise BadInput(f"method.vocabulary={path} holds no CX: {wanted}")
    if centres.shape != (DIMENSIONS, n_words) or centres.dtype.kind != "f" or not np.isfinite(centres).all():
        shape = "x".join(str(side) for side in centres.shape)
        raise BadInput(f"method.vocabulary={path} holds a CX of {shape} {centres.dtype}: {wanted}, all finite")
    return unit(centres.T)

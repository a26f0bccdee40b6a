"""Vectors brought to unit length."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def unit(vectors: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
    """Return the rows as unit vectors; a zero row stays what it is."""
    precise = vectors.astype(np.float64)
    norms = np.linalg.norm(precise, axis=1, keepdims=True)
    return (precise / np.where(norms > 0, norms, 1)).astype(np.float32)

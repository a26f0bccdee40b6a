"""MATLAB's cell arrays, as scipy writes them."""

import numpy as np


def cells(names):
    """Return MATLAB's cell array of words, (n, 1)."""
    made = np.empty((len(names), 1), dtype=object)
    made[:, 0] = names
    return made

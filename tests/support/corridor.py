"""Corridor, 111 real places seen twice: its frames, and the scores that VPR-Bench (77ad30f) stored of them."""

import numpy as np
import pytest
from checkout import SHARED

from vprbench.api.images import Images

FOLDER = SHARED / "data" / "corridor"
needs_corridor = pytest.mark.real_frames


def corridor(traverse):
    """Return the 111 frames of `ref` or `query`; the n-th of both show one place."""
    return Images.from_files(sorted((FOLDER / traverse).glob("*.jpg")))


def scored(method, every=1):
    """Return the scores of every n-th query, each of 111 references."""
    return method.fit(corridor("ref"), np.arange(111)).query(corridor("query")[::every])


def stored(name):
    """Return the scores of all queries that VPR-Bench stored of one of its methods."""
    with np.load(FOLDER / "vprbench_precomputed.npz") as scores:
        return scores[f"{name}__similarity"]


def right(scores, every=1):
    """Return how many queries find a reference within two frames of their own."""
    return int(np.count_nonzero(np.abs(scores.argmax(1) - np.arange(111)[::every]) <= 2))

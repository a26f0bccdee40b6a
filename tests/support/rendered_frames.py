"""Frames of the rendered datasets, as their tests look at them."""

import hashlib

import numpy as np


def frames_of_traverse(dataset, traverse, places, seed=0):
    """Return the frames of some places of one traverse, (places, height, width, 3)."""
    rendered = dataset(places=max(places) + 10, references=[traverse], query=traverse, seed=seed)
    return np.stack([rendered.references[place] for place in places])


def mean_difference(a, b):
    return np.abs(a.astype(int) - b.astype(int)).mean()


def pixel_digest(dataset, traverses, places):
    """Return the SHA-256 of these frames, which guards identity across machines and library versions.

    Everything is drawn in integers. Where a pinned digest fails without a change to the renderer, a library draws
    differently here; after a change, raise the renderer's version and pin the new digest.
    """
    digest = hashlib.sha256()
    for traverse in traverses:
        digest.update(frames_of_traverse(dataset, traverse, places).tobytes())
    return digest.hexdigest()

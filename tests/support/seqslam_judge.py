"""How alike two traverses are to SeqSLAM's eyes: differences of 64x32 grey frames, normalised patch by patch."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

PLACES = 2761  # of the real frames
PATCH = 8

Frames = npt.NDArray[np.uint8]  # (n, 32, 64)


def evenly(count: int) -> list[int]:
    """Return so many of the places, evenly spaced."""
    return np.linspace(0, PLACES - 1, count).astype(int).tolist()


def small_and_grey(frame: npt.NDArray[np.uint8]) -> Frames:
    """Return a frame as small and grey as the real ones are."""
    return np.asarray(
        cv2.resize(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY), (64, 32), interpolation=cv2.INTER_AREA), np.uint8
    )


def normalised(frames: Frames) -> npt.NDArray[np.float32]:
    """Return each patch of 8x8 pixels minus its mean, over its standard deviation; a flat patch is 0."""
    n, height, width = frames.shape
    patches = frames.astype(np.float32).reshape(n, height // PATCH, PATCH, width // PATCH, PATCH)
    mean, spread = patches.mean((2, 4), keepdims=True), patches.std((2, 4), keepdims=True)
    return ((patches - mean) / np.where(spread > 0, spread, 1)).reshape(n, -1)


def differences(queries: Frames, references: Frames) -> npt.NDArray[np.float32]:
    """Return the mean absolute difference of every query to every reference, (queries, references)."""
    pattern = normalised(references)
    return np.stack([np.abs(pattern - query).mean(axis=1) for query in normalised(queries)])


def recall(queries: Frames, references: Frames) -> float:
    """Return the share of queries i whose most similar reference is i."""
    return float((differences(queries, references).argmin(axis=1) == np.arange(len(queries))).mean())

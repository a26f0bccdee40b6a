"""Frames for the tests of the preprocessing."""

import cv2
import numpy as np


def smooth_frame(height, width, seed=0):
    """A blurred random colour frame, 0..255."""
    coarse = np.random.default_rng(seed).uniform(0, 255, (6, 8, 3))
    frame = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    frame += np.random.default_rng(seed + 1).normal(0, 4, frame.shape)
    return frame.clip(0, 255).round().astype(np.uint8)


def saturated_frame(height, width, seed=0):
    """A frame whose upper third is a sky of one level, as of an overexposed camera."""
    frame = smooth_frame(height, width, seed)
    frame[: height // 3] = 255 if seed % 2 else 203
    return frame

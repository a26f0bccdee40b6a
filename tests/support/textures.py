"""Frames that one method tells apart: a random texture for each place, with noise for another traverse."""

import numpy as np
from PIL import Image


def textures(folder, places, noise=0.0, first=0):
    """Write `0.png`, `1.png` ... into a folder: place k from `first` on, with Gaussian noise of so many levels."""
    folder.mkdir(parents=True)
    for number in range(places):
        of_place = np.random.default_rng(first + number)
        cells = Image.fromarray(of_place.integers(0, 256, (6, 8, 3), np.uint8))
        frame = np.asarray(cells.resize((64, 48), Image.Resampling.BICUBIC), float)
        frame += noise * of_place.standard_normal(frame.shape)
        Image.fromarray(frame.clip(0, 255).astype(np.uint8)).save(folder / f"{number}.png")
    return folder

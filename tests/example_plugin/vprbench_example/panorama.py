"""Views all around a made-up panorama, by day and at dusk."""

import cv2
import numpy as np

from vprbench.api import BadInput, Dataset, Images

_HEIGHT, _WIDTH = 48, 64  # pixels of a view


def panorama(
    name: str = "panorama", places: int = 24, overlap: float = 0.5, dusk: float = 0.4, seed: int = 0
) -> Dataset:
    """Return a turn through `places` directions by day, and one at dusk with some noise.

    Neighbouring views share `overlap` of what they show. Raises BadInput for values that show nothing.
    """
    if places < 2 or not 0 <= overlap < 1 or not 0 < dusk <= 1:
        raise BadInput(
            f"dataset.places={places}, dataset.overlap={overlap}, dataset.dusk={dusk}: give two places or more, "
            "an overlap from 0 to below 1 and a dusk above 0 and up to 1"
        )
    generator = np.random.default_rng(seed)
    step = round(_WIDTH * (1 - overlap))
    coarse = generator.integers(0, 256, (6, places * step // 8 + 1, 3), dtype=np.uint8)
    scene = cv2.resize(coarse, (places * step, _HEIGHT), interpolation=cv2.INTER_CUBIC)

    def view(place: int, light: float, noise: float) -> np.ndarray:
        columns = np.arange(place * step, place * step + _WIDTH) % scene.shape[1]  # it goes all around
        drawn = np.random.default_rng([seed, place, round(1000 * light)])
        shown = light * scene[:, columns] + noise * drawn.standard_normal((_HEIGHT, _WIDTH, 3))
        return np.clip(shown, 0, 255).astype(np.uint8)

    def traverse(word: str, light: float, noise: float) -> Images:
        stamp = f"panorama 1 {places} {overlap} {light} {noise} {seed}".encode()  # a changed drawing needs another
        return Images(
            lambda place: view(place, light, noise),
            [f"{word}-{place:03}" for place in range(places)],
            stamp=lambda place: stamp + b" %d" % place,
            content=lambda place: stamp + b" %d" % place,
        )

    return Dataset(
        name,
        references=traverse("day", 1.0, 0.0),
        places=np.arange(places),
        queries=traverse("dusk", dusk, 6.0),
        positives=tuple(np.array([place]) for place in range(places)),
        protocol={
            "references": ["day"],
            "query": "dusk",
            "places": places,
            "overlap": overlap,
            "dusk": dusk,
            "seed": seed,
        },
    )

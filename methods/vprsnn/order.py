"""Which places each of VPRSNN's modules learns."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt


def modules(
    n_places: int,
    places_per_module: int,
    order: Literal["contiguous", "shuffled"],
    seed: int,
    calibration_places: int,
) -> list[npt.NDArray[np.int64]]:
    """Return the places of each module, (places_per_module,) or fewer in the last.

    `contiguous` takes them as they come along the route, whatever `seed` and `calibration_places` are. `shuffled` draws
    what QVPR/VPRSNN draws once it has set `calibration_places` others aside: it shuffles those, then permutes all of
    them for nothing, then shuffles the `n_places` that are left.
    """
    places = np.arange(n_places)
    if order == "shuffled":
        generator = np.random.RandomState(seed)
        generator.shuffle(np.arange(calibration_places))
        generator.permutation(n_places + calibration_places)
        generator.shuffle(places)
    return [places[first : first + places_per_module] for first in range(0, n_places, places_per_module)]

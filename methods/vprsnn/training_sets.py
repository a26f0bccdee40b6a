"""Which places each of VPRSNN's modules learns, what it is shown in which order, and how it responds at the end."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from .model import Model


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


@dataclass(frozen=True)
class Lesson:
    """What one module is shown in each epoch, in this order, and the places that it learns."""

    number: int  # of the module, which chooses its random numbers
    levels: npt.NDArray[np.uint8]  # (n_images, n_inputs)
    labels: npt.NDArray[np.int64]  # (n_images,) which of the places each shows
    places: npt.NDArray[np.int64]  # (n_labels,)

    def images(self, first: int, presentations: int) -> Iterator[npt.NDArray[np.uint8]]:
        """Yield the image (n_inputs,) of each presentation from `first` on, epoch after epoch."""
        return (self.levels[number % len(self.levels)] for number in range(first, presentations))


def lesson(
    number: int, members: npt.NDArray[np.int64], levels: npt.NDArray[np.uint8], places: npt.NDArray[np.int64]
) -> Lesson:
    """Return what the module of the places `members` is shown: their first images in order, then their second ones.

    `levels` (n_references, n_inputs) and `places` (n_references,) are of all references.
    """
    shown = sorted(
        (time, label, image)
        for label, place in enumerate(members.tolist())
        for time, image in enumerate(np.flatnonzero(places == place).tolist())
    )
    _, labels, images = np.array(shown).T
    return Lesson(number, levels[images], labels, members)


class Recorder:
    """The spikes of a module in its last presentations, summed by place."""

    def __init__(self, model: Model, shown: Lesson) -> None:
        """Begin with none."""
        self.presentations = model.epochs * len(shown.levels)
        self.first = max(0, self.presentations - model.recorded_presentations)
        self._labels, self._places = shown.labels, shown.places
        self._sums = np.zeros((model.n_excitatory, len(shown.places)), np.float32)
        self._shown = np.zeros(len(shown.places), np.int64)

    def add(self, presentation: int, counts: npt.NDArray[np.integer]) -> None:
        """Take the spikes (n_neurons,) of a presentation, where it is one of the last."""
        if presentation >= self.first:
            label = self._labels[presentation % len(self._labels)]
            self._sums[:, label] += counts
            self._shown[label] += 1

    def arrays(self) -> Mapping[str, npt.NDArray[Any]]:
        """Return the sums, how many presentations are in each, and the places."""
        return {"sums": self._sums, "shown": self._shown, "places": self._places}

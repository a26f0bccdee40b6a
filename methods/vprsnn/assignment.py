"""Which place each of VPRSNN's neurons speaks for, by what it responded to in training."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Learnt:
    """What the neurons of one or more modules responded to; a module's labels number its own places from 0."""

    sums: npt.NDArray[np.float32]  # (n_modules, n_neurons, n_labels) spikes in the presentations of a label
    shown: npt.NDArray[np.int64]  # (n_modules, n_labels) those presentations
    places: npt.NDArray[np.int64]  # (n_modules, n_labels) the place of each label; -1: the module has fewer


def labels(learnt: Learnt) -> npt.NDArray[np.int64]:
    """Return the place to which each neuron gave most spikes a presentation, (n_modules, n_neurons); -1: it gave none.

    Of equals it is the module's first.
    """
    means = learnt.sums / np.maximum(learnt.shown, 1)[:, None, :]
    best = means.argmax(axis=2)
    fired = means.max(axis=2) > 0
    return np.where(fired, np.take_along_axis(learnt.places, best, axis=1), -1)

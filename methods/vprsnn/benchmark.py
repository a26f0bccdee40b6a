"""What a benchmark of speed asks of VPRSNN's training: its spikes, and where the time of a presentation goes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from copy import copy
from typing import Any, Literal

from . import model, training
from .synapses import sum_arrivals

Part = Literal["input", "normalising", "arrivals", "without learning", "with learning"]
Lap = Callable[[], AbstractContextManager[list[float]]]

LOOKED = 7  # every so many presentations; coprime to the images of an epoch, so that each has its turn
_PARTS: tuple[Part, ...] = ("input", "normalising", "arrivals", "without learning", "with learning")
_HOMES = {"spike_train": model, "normalise": training, "show": training}


class Watch:
    """Counts the spikes of a training, and times the parts of every seventh presentation.

    Its functions stand in for those that a training calls; they do the same. For each timed presentation, first the
    arrivals are summed alone, then the presentation is shown to a copy of the state without learning.
    """

    def __init__(self, lap: Lap) -> None:
        """Take what times a block: it yields a list, to which the seconds are added at the end."""
        self.presentations = self.input_spikes = self.excitatory_spikes = 0
        self.laps: dict[Part, list[float]] = {part: [] for part in _PARTS}
        self.own = {name: getattr(home, name) for name, home in _HOMES.items()}
        self._lap = lap

    def spike_train(self, *arguments: Any) -> Any:
        """Draw the input of a presentation."""
        with self._part("input"):
            train = self.own["spike_train"](*arguments)
        self.input_spikes += len(train.step)
        return train

    def normalise(self, *arguments: Any) -> None:
        """Scale the weights of a presentation."""
        with self._part("normalising"):
            self.own["normalise"](*arguments)

    def show(self, module: Any, train: Any) -> None:
        """Show an image that is learnt, with the rest that follows."""
        if self._looking:
            unchanged = copy(module)
            unchanged.state, unchanged.learning = type(module.state)(*(array.copy() for array in module.state)), False
            with self._part("arrivals"):
                sum_arrivals(module.synapses, train, module.scratch.drive)
            with self._part("without learning"):
                self.own["show"](unchanged, train)
        with self._part("with learning"):
            self.own["show"](module, train)
        self.excitatory_spikes += int(module.state.counts.sum())
        self.presentations += 1

    @property
    def _looking(self) -> bool:
        return self.presentations % LOOKED == 0

    @contextmanager
    def _part(self, part: Part) -> Iterator[None]:
        with self._lap() as lap:
            yield
        if self._looking:
            self.laps[part] += lap


@contextmanager
def watched(lap: Lap) -> Iterator[Watch]:
    """Watch the trainings of single modules inside the block; `lap` times a block and yields a list of its seconds."""
    watch = Watch(lap)
    for name, home in _HOMES.items():
        setattr(home, name, getattr(watch, name))
    try:
        yield watch
    finally:
        for name, home in _HOMES.items():
            setattr(home, name, watch.own[name])

"""A module of VPRSNN that is shown one image after the other."""

from __future__ import annotations

from dataclasses import dataclass

from .arrays import Scratch, State, Synapses, Train
from .physics import Physics, Traces
from .simulation import present
from .synapses import find_largest, sum_arrivals


@dataclass
class Module:
    """A module with its state at step `now`, and whether it learns from what it is shown."""

    physics: Physics
    traces: Traces
    synapses: Synapses
    state: State
    now: int
    scratch: Scratch
    learning: bool


def show(module: Module, train: Train, resting: bool = True) -> None:
    """Show one image and, if `resting`, the rest that follows; `module.state` then has the counts."""
    physics, scratch = module.physics, module.scratch
    end = physics.shown + physics.rest if resting else physics.shown
    sum_arrivals(module.synapses, train, scratch.drive)
    if module.learning:
        find_largest(module.synapses.weights, scratch.largest)
    present(module.synapses, module.state, train, scratch, physics, module.traces, module.now, module.learning, resting)
    module.now += end

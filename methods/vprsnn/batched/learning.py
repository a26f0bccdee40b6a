"""The learning of many VPRSNN modules in PyTorch: the weights of the neurons that fired lately, window by window."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..arrays import NEVER
from ..physics import Physics, Traces
from .arrivals import Arrivals, Spikes

_AT_ONCE = 2**24  # synapses that are worked on at once: bounds the memory


class Window(NamedTuple):
    """Steps in which no neuron fires twice, and the input spikes that can arrive in them."""

    first: int
    n_steps: int
    spikes: Tensor  # (n_most, n_groups, n_inputs) steps, rising
    earlier: Tensor  # (n_groups, n_inputs) the step of the last spike before those


class Pairs(NamedTuple):
    """Some neurons of some groups, with the weights from the input to each."""

    group: Tensor  # (n_pairs,)
    neuron: Tensor  # (n_pairs,)
    weights: Tensor  # (n_pairs, n_inputs)


class Learning:
    """Spike-timing-dependent plasticity of groups that are modules; steps count from the presentation's first."""

    def __init__(self, arrivals: Arrivals, physics: Physics, traces: Traces) -> None:
        """Take the synapses, which are to change."""
        device = arrivals.weights.device
        self._arrivals, self._physics = arrivals, physics
        # Nothing is left of a trace after its last value: 0 stands for all later steps.
        self._pre, self._post = (torch.tensor(np.append(trace, 0.0), device=device) for trace in traces)
        shape = arrivals.n_modules, arrivals.n_inputs
        self._heard = torch.full(shape, NEVER, device=device)  # the step of each input's last spike
        self._changing = torch.zeros((arrivals.n_modules, arrivals.n_neurons), dtype=torch.bool, device=device)
        self._unless_fired: list[Pairs] = []  # neurons whose weights change, with those after the window

    def begin(self, fired: Tensor) -> None:
        """Begin a presentation; `fired` (n_groups, n_neurons) are the steps of the last spikes.

        Weights change that belong to a neuron that fired lately, or stand above their limit until something arrives.
        """
        above = self._arrivals.weights.amax(dim=1) > self._physics.weight_max
        self._changing = above | (fired > 1 - len(self._post))

    def end(self, spikes: Spikes, shown: int, n_steps: int) -> None:
        """End a presentation of `n_steps` steps, the rest included."""
        self._heard = spikes.last_before(shown, self._heard.view(-1)).view_as(self._heard) - n_steps

    def window(self, spikes: Spikes, first: int, n_steps: int) -> Window:
        """Return the next steps."""
        lately = first - self._arrivals.longest
        near = spikes.of_cells(lately, first + n_steps).view(-1, *self._heard.shape)
        return Window(first, n_steps, near, spikes.last_before(lately, self._heard.view(-1)).view_as(self._heard))

    def follow(self, window: Window, fired: Tensor, arrived: Tensor) -> None:
        """Correct what arrives, (n_steps, n_groups, n_neurons), at neurons whose weights change, as if none fired."""
        self._unless_fired = []
        for pairs in self._pairs(self._changing):
            before = fired[pairs.group, pairs.neuron]
            sums, weights, _ = self._hear(window, pairs, before, window.first, window.first + window.n_steps)
            arrived[:, pairs.group, pairs.neuron] = sums
            self._unless_fired.append(pairs._replace(weights=weights))

    def learn(self, window: Window, fires: Tensor, at: Tensor, fired: Tensor) -> list[tuple[Tensor, Tensor, Tensor]]:
        """Change the weights in a window that was followed, in which the neurons `fires` fired in the steps `at`.

        Both and `fired`, the steps of the spikes before, are (n_groups, n_neurons). Returns the groups and numbers of
        neurons that fired, and what arrived at them, (n_steps, n_pairs).
        """
        learnt, arrived = [], []
        for pairs in self._pairs(fires):
            group, neuron, _ = pairs
            now, before = at[group, neuron], fired[group, neuron]
            sums, weights, last = self._hear(window, pairs, before, window.first, now + 1)
            weights = self._fire(weights, now, before, last)
            pairs = pairs._replace(weights=weights)
            later, weights, _ = self._hear(window, pairs, now, now + 1, window.first + window.n_steps)
            learnt.append(pairs._replace(weights=weights))
            arrived.append((group, neuron, sums + later))
        for group, neuron, weights in self._unless_fired + learnt:
            self._arrivals.weights[group, :, neuron] = weights
        self._changing |= fires
        return arrived

    def _fire(self, weights: Tensor, now: Tensor, before: Tensor, last: Tensor) -> Tensor:
        """Return weights after a spike: changed by the slow trace of the spike before, and that of the last arrival."""
        physics = self._physics
        slow = physics.post_rate * torch.exp((before - now).double() * (physics.step_ms / physics.slow_post_tau))
        change = slow[:, None] * self._pre[(now[:, None] - last).clamp(0, len(self._pre) - 1)]
        return (weights + change).clamp(0, physics.weight_max)

    def _hear(
        self, window: Window, pairs: Pairs, fired: Tensor, first: Tensor | int, until: Tensor | int
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Let arrive at neurons that fired in the steps `fired` what arrives from step `first` to `until` - 1.

        An arrival adds the trace of the neuron's spike to the weight by which it has just acted. Returns what arrives,
        (n_steps of the window, n_pairs), the weights and the step of each synapse's last arrival, (n_pairs, n_inputs).
        """
        weights, fired = pairs.weights, fired[:, None]
        first, until = (step[:, None] if isinstance(step, Tensor) else step for step in (first, until))
        delays = self._arrivals.delays[pairs.group, :, pairs.neuron].long()
        last = window.earlier[pairs.group] + delays
        sums = last.new_zeros(len(weights), window.n_steps + 1)
        for steps in window.spikes:
            arrival = steps[pairs.group] + delays
            heard = arrival < until
            last = torch.where(heard, arrival, last)
            heard &= arrival >= first
            slot = torch.where(heard, arrival - window.first, window.n_steps)  # the last: at other times
            sums.scatter_add_(1, slot, self._arrivals.in_whole(weights))
            trace = self._post[(arrival - fired).clamp(0, len(self._post) - 1)]
            weights = torch.where(heard, (weights + trace).clamp(0, self._physics.weight_max), weights)
        return self._arrivals.in_parts(sums[:, : window.n_steps].mT), weights, last

    def _pairs(self, which: Tensor) -> Iterator[Pairs]:
        """Yield the neurons that are `which` (n_groups, n_neurons), not too many at once."""
        group, neuron = which.nonzero(as_tuple=True)
        few = max(1, _AT_ONCE // self._arrivals.n_inputs)
        for begin in range(0, len(group), few):
            g, j = group[begin : begin + few], neuron[begin : begin + few]
            yield Pairs(g, j, self._arrivals.weights[g, :, j])

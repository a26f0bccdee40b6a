"""The input of many VPRSNN modules in PyTorch: its spikes, and what arrives at the neurons in each step."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ..arrays import Train

_NOT_YET = 1 << 60  # the step of what will not happen
_AT_ONCE = 2**24  # arrivals that are summed at once: bounds the memory


class Spikes:
    """The input spikes of a presentation, by step and by cell: an input of a train."""

    def __init__(self, trains: Sequence[Train], n_inputs: int, shown: int, device: torch.device) -> None:
        """Take trains of `shown` steps, all of as many inputs."""
        cells = np.concatenate([train.source + number * n_inputs for number, train in enumerate(trains)])
        steps = torch.from_numpy(np.concatenate([train.step for train in trains])).to(device).long()
        self.step, order = steps.sort()
        self.cell = torch.from_numpy(cells).to(device).long()[order]
        self.n_trains, self._shown = len(trains), shown
        self._first: list[int] = torch.searchsorted(self.step, torch.arange(shown + 1, device=device)).tolist()
        self._begins = torch.arange(len(trains) * n_inputs, device=device) * (shown + 1)
        self._by_cell = (self.cell * (shown + 1) + self.step).sort().values
        self._steps = torch.cat([self._by_cell % (shown + 1), self._by_cell.new_zeros(1)])  # one more, of no spike

    def within(self, first: int, until: int) -> tuple[int, int]:
        """Return where in `step` and `cell` the spikes of steps `first` to `until` - 1 begin and end."""
        return self._first[min(first, self._shown)], self._first[min(until, self._shown)]

    def of_cells(self, first: int, until: int) -> Tensor:
        """Return the steps from `first` to `until` - 1 in which each cell spikes, (n_most, n_cells), rising.

        Where a cell spikes less often than another, the steps that are missing are later than all.
        """
        begin, end = self._before(first), self._before(until)
        at = begin + torch.arange(int((end - begin).max()), device=begin.device)[:, None]
        return torch.where(at < end, self._steps[at.clamp(max=len(self._steps) - 1)], _NOT_YET)

    def last_before(self, step: int, earlier: Tensor) -> Tensor:
        """Return the step of each cell's last spike before `step`, or `earlier` (n_cells,) where it has none."""
        before = self._before(step)
        return torch.where(before > self._before(0), self._steps[before - 1], earlier)

    def _before(self, step: int) -> Tensor:
        """Return how many spikes precede those of each cell from `step` on, in the order of cells."""
        return torch.searchsorted(self._by_cell, self._begins + min(max(step, 0), self._shown))


class Arrivals:
    """The synapses from the input of each group; group g is module g modulo the number of modules.

    What arrives is summed in whole numbers. So the sum is the same in whatever order threads add, and whichever groups
    are simulated together.
    """

    def __init__(
        self,
        weights: npt.NDArray[np.float64],
        delays: npt.NDArray[np.integer],
        n_groups: int,
        n_steps: int,
        limit: float,
        device: torch.device,
    ) -> None:
        """Take (n_modules, n_inputs, n_neurons) weights, whose sums stay below `limit`, and delays.

        What arrives is asked for at most `n_steps` steps at once.
        """
        self.weights = torch.tensor(weights, dtype=torch.float64, device=device)
        self.delays = torch.tensor(delays, dtype=torch.int16, device=device)
        self.n_modules, self.n_inputs, self.n_neurons = weights.shape
        self.longest = int(delays.max())
        self._whole = 2.0 ** (62 - math.ceil(math.log2(max(limit, 1.0))))
        self._later = self.delays.long() * (n_groups * self.n_neurons) + torch.arange(self.n_neurons, device=device)
        shape = n_steps + self.longest, n_groups, self.n_neurons
        self._sums = torch.zeros(shape, dtype=torch.int64, device=device)  # of each step from the next one on

    def in_whole(self, weights: Tensor) -> Tensor:
        """Return weights as the whole numbers that are summed."""
        return (weights * self._whole).round_().long()

    def in_parts(self, sums: Tensor) -> Tensor:
        """Return sums of whole numbers as those of weights."""
        return sums.double() / self._whole

    def normalise(self, total: float) -> None:
        """Scale the weights of each neuron to the sum `total`; a neuron without weights stays without."""
        sums = self.weights.sum(dim=1, keepdim=True)
        self.weights *= torch.where(sums > 0, total / sums, 1.0)

    def begin(self) -> None:
        """Let nothing be on its way: a presentation begins."""
        self._sums.zero_()

    def sum(self, spikes: Spikes, first: int, arrived: Tensor) -> None:
        """Write what arrives in the next steps, of which `first` is the first, by the weights as they are now.

        `arrived` is (n_steps, n_groups, n_neurons). Each train goes to as many groups, one after the other.
        """
        n_steps, n_groups, n_neurons = arrived.shape
        fed = torch.arange(n_groups // spikes.n_trains, device=arrived.device)
        weights, later = self.weights.view(-1, n_neurons), self._later.view(-1, n_neurons)
        begin, end = spikes.within(first, first + n_steps)
        few = max(1, _AT_ONCE // (len(fed) * n_neurons))
        for spike in range(begin, end, few):
            some = slice(spike, min(spike + few, end))
            step, cell = spikes.step[some, None], spikes.cell[some, None]
            group = cell // self.n_inputs * len(fed) + fed
            row = (group % self.n_modules * self.n_inputs + cell % self.n_inputs).view(-1)
            now = ((step - first) * n_groups + group).view(-1, 1) * n_neurons
            self._sums.view(-1).scatter_add_(0, (now + later[row]).view(-1), self.in_whole(weights[row]).view(-1))
        arrived.copy_(self._sums[:n_steps]).div_(self._whole)
        rest = self._sums[n_steps:].clone()
        self._sums.zero_()
        self._sums[: len(rest)] = rest

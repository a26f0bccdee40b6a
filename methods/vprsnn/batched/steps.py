"""The steps of many VPRSNN modules in PyTorch: what `module.show` does, window by window.

A window is so short that a neuron which fires in it cannot fire in it again, and acts through its one spike alone. So
the steps know neither of learning nor of refractory periods: what arrives is summed before them, and a neuron that
fires is left out until they are done. Then its weights, what arrived at it and its potential are worked out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from ..arrays import NEVER, State, Train
from ..physics import Physics
from .arrivals import Arrivals, Spikes
from .learning import Learning

ARRAYS = 6  # of 8 bytes for each step of a window, group and neuron
_WINDOW = 250  # steps, at most: a published presentation is 14 windows, the rest after it 6


def window_of(physics: Physics) -> int:
    """Return steps in which no neuron fires twice, nor one fires that was refractory when they began."""
    return min(_WINDOW, physics.e_interval - _left_out(physics) + 1)


def _left_out(physics: Physics) -> int:
    """Return the steps, that of the spike included, in which a neuron that fires is left out."""
    return max(physics.e_refractory, 1)


class Modules:
    """Groups of neurons: modules, or modules each with several images; what it holds is (..., n_groups, n_neurons).

    Steps count from the beginning of the presentation.
    """

    def __init__(self, physics: Physics, arrivals: Arrivals, n_groups: int, learning: Learning | None = None) -> None:
        """Make room; where there is `learning`, each presentation changes weights and thresholds."""
        self._physics, self._arrivals, self._learning = physics, arrivals, learning
        self._device, self._n_steps = arrivals.weights.device, window_of(physics)
        self._theta_keep = 1.0 if learning is None else physics.theta_keep  # thresholds decay while there is learning
        self._i_rest = torch.tensor(physics.i_rest, dtype=torch.float64, device=self._device)

        def room(n: int, dtype: torch.dtype = torch.float64) -> Tensor:
            return torch.zeros((n, n_groups, arrivals.n_neurons), dtype=dtype, device=self._device)

        # Of each step of a window
        self._ge, self._gi = room(self._n_steps + 1), room(self._n_steps + 1)  # before it, and after the last
        self._factor, self._term = room(self._n_steps), room(self._n_steps)  # v becomes factor * v + term, but for gi
        self._limits = room(self._n_steps)  # mV; infinite for neurons that may not fire
        self._fires, self._fires_i = room(self._n_steps, torch.bool), room(self._n_steps, torch.bool)
        # Of now
        self._v, self.theta, self._v_i, self._ge_i = room(4)  # v: not a number from a spike to the window's end
        self._fired, self._ready_i = room(2, torch.int64)  # `_ready_i`: the step of the window in which v_i moves again
        self.counts, self._late = room(2, torch.int32), room(2, torch.int32)  # of excitatory and inhibitory neurons
        self._graph: torch.cuda.CUDAGraph | None = None

    def begin(self, theta: npt.NDArray[np.float64], start: State, now: int) -> None:
        """Make every group as `start` is at step `now`, silent for ever, with thresholds `theta` (n_groups, n)."""
        physics, n = self._physics, self._arrivals.n_neurons
        relaxed = (1 - physics.i_gain) ** np.maximum(now - 1 - start.left_i, 0)
        self._v[:] = torch.from_numpy(start.v[:n])
        self._v_i[:] = torch.from_numpy((physics.i_rest + (start.v_i - physics.i_rest) * relaxed)[:n])
        self.theta[:] = torch.from_numpy(theta)
        for silent in (self._ge[0], self._gi[0], self._ge_i, self._ready_i, self._late):
            silent.zero_()
        self._fired.fill_(NEVER)

    def present(self, trains: Sequence[Train], resting: bool) -> None:
        """Show one image to each group; each train goes to as many groups, one after the other.

        Fills `counts`; spikes of the rest that follows are counted for the next image. Where not `resting`, the
        simulation ends with the presentation.
        """
        physics, learning = self._physics, self._learning
        end = physics.shown + physics.rest if resting else physics.shown
        spikes = Spikes(trains, self._arrivals.n_inputs, physics.shown, self._device)
        self.counts.copy_(self._late)
        self._late.zero_()
        self._arrivals.begin()
        if learning is not None:
            learning.begin(self._fired)
        for first, n_steps in self._windows(end):
            if first >= physics.shown + self._arrivals.longest and self._calm(first, end):
                self._relax(end - first)
                break
            self._pass(spikes, first, n_steps)
        if learning is not None:
            learning.end(spikes, physics.shown, end)
        self._fired -= end

    def _windows(self, end: int) -> Iterator[tuple[int, int]]:
        """Yield the first step of each window and their number; a window begins with the rest."""
        for begin, until in ((0, self._physics.shown), (self._physics.shown, end)):
            for first in range(begin, until, self._n_steps):
                yield first, min(self._n_steps, until - first)

    def _pass(self, spikes: Spikes, first: int, n_steps: int) -> None:
        """Let all groups pass a window, and learn."""
        learning, arrived = self._learning, self._ge[1 : n_steps + 1]
        self._arrivals.sum(spikes, first, arrived)
        if learning is not None:
            window = learning.window(spikes, first, n_steps)
            learning.follow(window, self._fired, arrived)
        self._set_limits(first, n_steps)
        self._advance(n_steps)

        fires = self._fires[:n_steps].any(dim=0)
        at = first + self._fires[:n_steps].view(torch.uint8).argmax(dim=0)
        counts = self.counts if first < self._physics.shown else self._late
        counts[0] += fires
        counts[1] += self._fires_i[:n_steps].sum(dim=0)
        if learning is not None:
            for group, neuron, sums in learning.learn(window, fires, at, self._fired):
                ge, keep = self._ge[0, group, neuron], torch.full_like(sums, self._physics.ge_keep)
                self._ge[1 : n_steps + 1, group, neuron] = _followed(keep, sums, ge)
            self.theta *= self._theta_keep**n_steps
            self.theta += fires * self._theta_kept(first + n_steps - 1 - at) * self._physics.theta_plus
        self._fired = torch.where(fires, at, self._fired)
        self._resume(first, n_steps)
        self._ge[0], self._gi[0] = self._ge[n_steps], self._gi[n_steps]
        self._ready_i -= n_steps

    def _set_limits(self, first: int, n_steps: int) -> None:
        """Set the thresholds in each step of a window."""
        steps, limits = torch.arange(n_steps, device=self._device)[:, None, None], self._limits[:n_steps]
        torch.mul(self.theta, self._theta_kept(steps + 1), out=limits).add_(self._physics.e_threshold)
        limits.masked_fill_(self._fired + self._physics.e_interval - first > steps, math.inf)

    def _theta_kept(self, steps: Tensor) -> Tensor:
        return torch.pow(self._theta_keep, steps.double())

    def _advance(self, n_steps: int) -> None:
        """Take the steps of a window; on a GPU those of a whole one are recorded once and then replayed."""
        if self._graph is not None and n_steps == self._n_steps:
            self._graph.replay()
            return
        self._take(n_steps)
        if self._device.type == "cuda" and n_steps == self._n_steps:
            self._graph = torch.cuda.CUDAGraph()
            with torch.cuda.device(self._device), torch.cuda.graph(self._graph):
                self._take(n_steps)  # it does nothing yet

    def _take(self, n_steps: int) -> None:
        """Take the steps of a window: few kernels for each, in place, and nothing that the host waits for."""
        physics, v, v_i, ge_i, ge = self._physics, self._v, self._v_i, self._ge_i, self._ge[: n_steps + 1]
        factor, term = self._factor[:n_steps], self._term[:n_steps]
        for t in range(n_steps):
            ge[t + 1].add_(ge[t], alpha=physics.ge_keep)
        torch.mul(ge[:-1], -physics.e_gain, out=factor).add_(1 - physics.e_gain)
        torch.mul(ge[:-1], physics.e_gain * physics.excitation, out=term).add_(physics.e_gain * physics.e_rest)
        for t in range(n_steps):
            fires, fires_i, gi = self._fires[t], self._fires_i[t], self._gi[t + 1]

            # Excitatory neurons
            pull = physics.e_inhibition - v
            torch.addcmul(term[t], factor[t], v, out=v)
            v.addcmul_(self._gi[t], pull, value=physics.e_gain)
            torch.gt(v, self._limits[t], out=fires)
            v.masked_fill_(fires, math.nan)

            # Inhibitory neurons
            pull = physics.excitation - v_i
            moved = torch.lerp(v_i, self._i_rest, physics.i_gain).addcmul_(ge_i, pull, value=physics.i_gain)
            torch.where(self._ready_i <= t, moved, v_i, out=v_i)
            torch.gt(v_i, physics.i_threshold, out=fires_i)
            v_i.masked_fill_(fires_i, physics.i_reset)
            self._ready_i.masked_fill_(fires_i, t + physics.i_refractory)

            # From one to one, and from each to all others
            ge_i.mul_(physics.ge_keep).add_(fires, alpha=physics.e_to_i)
            torch.mul(self._gi[t], physics.gi_keep, out=gi)
            gi.add_(fires_i.sum(dim=1, keepdim=True), alpha=physics.i_to_e).add_(fires_i, alpha=-physics.i_to_e)

    def _resume(self, first: int, n_steps: int) -> None:
        """Let neurons that were left out pass the window from the step on in which they are no longer refractory."""
        physics, again = self._physics, self._fired + _left_out(self._physics) - first
        group, neuron = (again > 0).nonzero(as_tuple=True)
        ge, gi = self._ge[:n_steps, group, neuron], self._gi[:n_steps, group, neuron]
        moves = torch.arange(n_steps, device=self._device)[:, None] >= again[group, neuron]
        factor = torch.where(moves, 1 - physics.e_gain * (1 + ge + gi), 1.0)
        pull = physics.e_rest + physics.excitation * ge + physics.e_inhibition * gi
        term = torch.where(moves, physics.e_gain * pull, 0.0)
        self._v[group, neuron] = _followed(factor, term, torch.full_like(factor[0], physics.e_reset))[-1]

    def _calm(self, step: int, end: int) -> bool:
        """Tell whether nothing acts on any neuron, and none reaches its threshold by itself until `end`."""
        physics, kept = self._physics, self._theta_keep ** (end - step)
        most = torch.stack([acting.max() for acting in (self._ge[0], self._gi[0], self._ge_i)]).max()
        waiting = (self._fired + self._physics.e_interval > step).any() | (self._ready_i > 0).any()
        near = self._v.max().clamp(min=physics.e_rest) >= self.theta.min() * kept + physics.e_threshold
        return not bool((most >= physics.nothing) | waiting | near)

    def _relax(self, n_steps: int) -> None:
        """Let neurons on which nothing acts relax for so many steps, as that many Euler steps would."""
        physics = self._physics
        for v, rest, gain in ((self._v, physics.e_rest, physics.e_gain), (self._v_i, physics.i_rest, physics.i_gain)):
            v.sub_(rest).mul_((1 - gain) ** n_steps).add_(rest)
        for silent in (self._ge[0], self._gi[0], self._ge_i):
            silent.zero_()
        self.theta *= self._theta_keep**n_steps


def _followed(factor: Tensor, term: Tensor, begin: Tensor) -> Tensor:
    """Return x after each step, (n_steps, n), where a step makes it factor * x + term; `begin` (n,) is x before them.

    Steps are joined, two and two, then four and four, and so on: a few large operations.
    """
    term = torch.cat([term[:1] + factor[:1] * begin, term[1:]])
    joined = 1
    while joined < len(term):
        term = torch.cat([term[:joined], term[joined:] + factor[joined:] * term[:-joined]])
        factor = torch.cat([factor[:joined], factor[joined:] * factor[:-joined]])
        joined *= 2
    return term

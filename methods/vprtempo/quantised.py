"""A trained VPRTempo network asked in 8 bits: weights as int8, activations as uint8, sums as int32."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
import numpy.typing as npt
import torch

from vprbench.api import Scores, takes

from .compiled import compiled
from .network import Network
from .query import Amplitudes, linear_layer
from .rules import Rules

_LEVELS = np.float32(255)  # of an activation
_STEPS = np.float32(127)  # of a weight to either side of 0
MOST_INPUTS = 2**31 // (255 * 127)  # of a neuron, whose sums 32 bits hold
_FEWEST_INPUTS = 16  # below which PyTorch's 8-bit product is not to be trusted
_MANY = 8  # queries that are answered as a matrix product


class _Layer:
    """An affine map by rows of 127 steps to either side of 0; the sums are exact, for one input as for many."""

    def __init__(self, weights: npt.NDArray[np.float32], bias: npt.NDArray[np.float32], most: np.float32) -> None:
        """Quantise `weights` (n_out, n_in), a row at a time, for inputs from 0 to `most`; `bias` is (n_out,)."""
        step = np.maximum(np.abs(weights).max(1), np.finfo(np.float32).tiny) / _STEPS
        self._steps = np.ascontiguousarray(np.rint(weights / step[:, None]), np.int8)
        self._factor = step * (most / _LEVELS)  # of a sum of steps times levels
        self._bias = bias
        self._right = torch.from_numpy(self._steps).T
        # Many inputs are shifted to int8; this is what the shift takes from the sums.
        self._shift = 128 * self._steps.sum(1, dtype=np.int32)

    def __call__(self, levels: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
        """Return (n_queries, n_out) of the input's levels (n_queries, n_in)."""
        takes(len(levels) * self._steps.size, kind="int8")
        if len(levels) < _MANY or self._steps.shape[1] < _FEWEST_INPUTS or not _sums_are_exact():
            sums = np.empty((len(levels), len(self._bias)), np.int32)
            _multiply(self._steps, levels, sums)
        else:
            shifted = torch.from_numpy((levels ^ np.uint8(128)).view(np.int8))
            sums = torch._int_mm(shifted, self._right).numpy() + self._shift
        return np.asarray(sums * self._factor + self._bias, np.float32)


@cache
def _sums_are_exact() -> bool:
    """Tell whether PyTorch's 8-bit product is exact here: on x86 without VNNI it saturates in 16 bits on the way."""
    left, right = (torch.tensor([[-128], [127]], dtype=torch.int8).repeat(8, 64) for _ in range(2))
    return torch.equal(torch._int_mm(left, right.T), (left.int() @ right.T.int()))


class Int8LinearQuery:
    """The public code's query in 8 bits: one matrix."""

    def __init__(self, members: Sequence[Network]) -> None:
        """Quantise the product of both layers, or the mean of several."""
        weights, bias = linear_layer(members)
        self._layer = _Layer(weights.cpu().numpy(), bias.cpu().numpy(), np.float32(1))

    def scores(self, spikes: npt.NDArray[np.float32]) -> Scores:
        """Return the state of every place's output neuron."""
        return self._layer(_levels(spikes, np.float32(1)))


class Int8SpikingQuery:
    """The paper's query in 8 bits: both layers as in Eq. 1, feature spikes in 255 steps up to the clip."""

    def __init__(self, network: Network, rules: Rules) -> None:
        """Quantise both layers, a neuron at a time."""
        self._clip = np.float32(rules.clip)
        self._silent_winner = rules.silent_winner
        bias = (network.constant - network.feature_thresholds).flatten()
        self._features = _Layer(network.features.flatten(0, 1).cpu().numpy(), bias.cpu().numpy(), np.float32(1))
        self._outputs = [
            _Layer(weights.T.cpu().numpy(), -thresholds.cpu().numpy(), self._clip)
            for weights, thresholds in zip(network.outputs, network.output_thresholds, strict=True)
        ]
        self._n_features = network.features.shape[1]
        self._first_module = len(network.output_thresholds[0])

    def scores(self, spikes: npt.NDArray[np.float32]) -> Scores:
        """Return the state of every place's output neuron."""
        return self._fired(self._feature_levels(spikes))

    def layers(self, spikes: npt.NDArray[np.float32]) -> tuple[Amplitudes, Amplitudes]:
        """Return the spikes of the feature neurons, all modules side by side, and of the output neurons."""
        levels = self._feature_levels(spikes)
        return levels * (self._clip / _LEVELS), self._fired(levels)

    def _feature_levels(self, spikes: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
        """Return the feature spikes of all modules, (n_queries, modules * n_features), in steps up to the clip."""
        return _levels(self._features(_levels(spikes, np.float32(1))), self._clip)

    def _fired(self, levels: npt.NDArray[np.uint8]) -> Scores:
        """Return the activation of Eq. 1 of all output neurons, (n_queries, n_places), for the feature spikes."""
        features = levels.reshape(len(levels), len(self._outputs), self._n_features)
        parts = [layer(np.ascontiguousarray(features[:, module])) for module, layer in enumerate(self._outputs)]
        above = np.concatenate(parts, axis=1)
        scores = np.clip(above, 0, self._clip)
        if self._silent_winner:
            silent = np.flatnonzero((scores == 0).all(1))
            scores[silent, above[silent, : self._first_module].argmax(1)] = 0.5
        return scores


def _levels(activation: npt.NDArray[np.float32], most: np.float32) -> npt.NDArray[np.uint8]:
    """Return activations as the nearest of 256 levels from 0 to `most`; values outside are clipped."""
    levels = np.empty(activation.shape, np.uint8)
    _write_levels(activation.ravel(), _LEVELS / most, levels.ravel())
    return levels


@compiled
def _write_levels(activation, factor, levels):  # type: ignore[no-untyped-def]
    for i in range(len(levels)):
        levels[i] = np.uint8(min(max(np.rint(activation[i] * factor), np.float32(0)), np.float32(255)))


@compiled
def _multiply(steps, levels, sums):  # type: ignore[no-untyped-def]
    """Write levels @ steps.T, (n_queries, n_out)."""
    for query in range(len(levels)):
        own = levels[query]
        for row in range(len(steps)):
            weights = steps[row]
            total = np.int32(0)
            for i in range(len(own)):
                total = np.int32(total + np.int32(np.int32(weights[i]) * np.int32(own[i])))  # else numba takes 64 bits
            sums[query, row] = total


def _compile() -> None:
    """Compile both loops, or read them from the cache, so that no query waits for it."""
    _write_levels(np.zeros(1, np.float32), _LEVELS, np.zeros(1, np.uint8))
    _multiply(np.zeros((1, 1), np.int8), np.zeros((1, 1), np.uint8), np.zeros((1, 1), np.int32))


_compile()

"""A trained VPRTempo network asked in 8 bits: weights as int8, activations as uint8, sums as int32."""

from __future__ import annotations

import platform
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
import numpy.typing as npt
import torch

from vprbench.api import Scores, count_operations

from . import vnni
from .layer import compiled
from .network import Network
from .query import Amplitudes, find_synapses, multiply_layers
from .rules import Rules

_LEVELS = np.float32(255)  # of an activation
_STEPS = np.float32(127)  # of a weight to either side of 0
MOST_INPUTS = 2**31 // (255 * 127)  # of a neuron, whose sums 32 bits hold
_HAS_ONEDNN = torch.backends.mkldnn.is_available() and platform.machine() in ("x86_64", "AMD64")  # type: ignore[no-untyped-call]
_WORTH_THREADS = 16  # queries: fewer are answered before a thread has started


Levels = npt.NDArray[np.uint8]  # (n_queries, n)
Floats = npt.NDArray[np.float32]  # (n_out,), or (n_queries, n_out)
Map = Callable[[Levels, Floats], None]  # writes the net input (n_queries, n_out) of levels (n_queries, n_in)


class _Layer:
    """An affine map by rows of 127 steps to either side of 0; the sums are exact, for one input as for many."""

    def __init__(self, weights: Floats, bias: Floats, most: np.float32) -> None:
        """Quantise `weights` (n_out, n_in), a row at a time, for inputs from 0 to `most`; `bias` is (n_out,)."""
        step = np.maximum(np.abs(weights).max(1), np.finfo(np.float32).tiny) / _STEPS
        steps = np.ascontiguousarray(np.rint(weights / step[:, None]), np.int8)
        self.n_out = len(steps)
        self.n_weights = steps.size  # of synapses that exist or not
        factor = np.asarray(step * (most / _LEVELS), np.float32)  # of a sum of steps times levels
        self._map = _make_map(steps, factor, bias)

    def __call__(self, levels: Levels, net: Floats | None = None) -> Floats:
        """Return (n_queries, n_out) of the input's levels (n_queries, n_in), written to `net` if it is given."""
        written = np.empty((len(levels), self.n_out), np.float32) if net is None else net
        self._map(levels, written)
        return written


def _make_map(steps: npt.NDArray[np.int8], factor: Floats, bias: Floats) -> Map:
    """Return the map by `steps` (n_out, n_in), times `factor`, plus `bias`, in the fastest way that is exact here."""
    if (synapses := find_synapses(steps)) is not None:
        return lambda levels, net: _add_synapses(*synapses, factor, bias, levels, net)
    if vnni.AVAILABLE:
        return vnni.make_affine_map(steps, factor, bias)
    if _HAS_ONEDNN:
        return _map_by_onednn(steps, factor, bias, _count_parts())
    return lambda levels, net: _multiply(steps, levels, factor, bias, net)


def _map_by_onednn(steps: npt.NDArray[np.int8], factor: Floats, bias: Floats, parts: int) -> Map:
    """Return oneDNN's map by steps, each in so many parts, which read the same level."""
    shares = [steps] if parts == 1 else [steps // 2, steps - steps // 2]
    packed = torch.ops.onednn.qlinear_prepack(torch.from_numpy(np.concatenate(shares, axis=1)), None)
    scales = torch.tensor(factor), torch.zeros(len(steps), dtype=torch.int32), torch.tensor(bias)
    rest: tuple[object, ...] = (packed, *scales, 1.0, 0, torch.float32, "none", [], "")

    def write(levels: Levels, net: Floats) -> None:
        given = torch.from_numpy(np.concatenate([levels] * parts, axis=1))
        net[:] = torch.ops.onednn.qlinear_pointwise(given, 1.0, 0, *rest).numpy()

    return write


@cache
def _count_parts() -> int:
    """Return in how many parts oneDNN multiplies a step exactly: 1 with any VNNI, of AVX too.

    Without VNNI x86 adds pairs of products in 16 bits, which hold those of half steps alone.
    """
    steps, levels = np.full((16, 64), 127, np.int8), np.full((8, 64), 255, np.uint8)
    net = np.empty((8, 16), np.float32)
    _map_by_onednn(steps, np.ones(16, np.float32), np.zeros(16, np.float32), 1)(levels, net)
    return 1 if (net == 64 * 127 * 255).all() else 2


class Int8LinearQuery:
    """The public code's query in 8 bits: one matrix."""

    def __init__(self, members: Sequence[Network]) -> None:
        """Quantise the product of both layers, or the mean of several."""
        weights, bias = multiply_layers(members)
        self._layer = _Layer(weights.cpu().numpy(), bias.cpu().numpy(), np.float32(1))

    def scores(self, spikes: npt.NDArray[np.float32]) -> Scores:
        """Return the state of every place's output neuron."""
        count_operations(len(spikes) * self._layer.n_weights, kind="int8")
        scores = np.empty((len(spikes), self._layer.n_out), np.float32)
        _score_in_threads(lambda own, written: self._layer(_quantise(own, np.float32(1)), written), spikes, scores)
        return scores


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
        self._n_features, self._n_places = network.features.shape[1], network.n_places

    def scores(self, spikes: npt.NDArray[np.float32]) -> Scores:
        """Return the state of every place's output neuron."""
        weights = sum(layer.n_weights for layer in (self._features, *self._outputs))
        count_operations(len(spikes) * weights, kind="int8")
        scores = np.empty((len(spikes), self._n_places), np.float32)
        _score_in_threads(lambda own, written: self._fire(self._fire_features(own), written), spikes, scores)
        return scores

    def layers(self, spikes: npt.NDArray[np.float32]) -> tuple[Amplitudes, Amplitudes]:
        """Return the spikes of the feature neurons, all modules side by side, and of the output neurons."""
        levels, scores = self._fire_features(spikes), np.empty((len(spikes), self._n_places), np.float32)
        self._fire(levels, scores)
        return levels * (self._clip / _LEVELS), scores

    def _fire_features(self, spikes: npt.NDArray[np.float32]) -> Levels:
        """Return the feature spikes of all modules, (n_queries, modules * n_features), in steps up to the clip."""
        return _quantise(self._features(_quantise(spikes, np.float32(1))), self._clip)

    def _fire(self, levels: Levels, scores: Scores) -> None:
        """Write the activation of Eq. 1 of all output neurons, (n_queries, n_places), for the feature spikes."""
        features, start = levels.reshape(len(levels), len(self._outputs), self._n_features), 0
        for module, layer in enumerate(self._outputs):
            layer(np.ascontiguousarray(features[:, module]), scores[:, start : start + layer.n_out])
            start += layer.n_out
        _activate(scores, self._clip, self._outputs[0].n_out if self._silent_winner else 0)


def _score_in_threads(write: Callable[[Amplitudes, Scores], object], spikes: Amplitudes, scores: Scores) -> None:
    """Let `write` answer input spikes with scores (n_queries, n_places), in all threads if it computes in its own."""
    threads = torch.get_num_threads() if vnni.AVAILABLE and len(spikes) >= _WORTH_THREADS else 1
    if threads == 1:
        write(spikes, scores)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(write, np.array_split(spikes, threads), np.array_split(scores, threads)))


def _quantise(activation: npt.NDArray[np.float32], most: np.float32) -> Levels:
    """Return activations as the nearest of 256 levels from 0 to `most`; values outside are clipped."""
    levels = np.empty(activation.shape, np.uint8)
    _write_levels(activation.ravel(), _LEVELS / most, levels.ravel())
    return levels


@compiled
def _write_levels(activation, factor, levels):  # type: ignore[no-untyped-def]
    for i in range(len(levels)):
        levels[i] = np.uint8(min(max(np.rint(activation[i] * factor), np.float32(0)), np.float32(255)))


@compiled
def _activate(scores, clip, n_first):  # type: ignore[no-untyped-def]
    """Cut the net input above threshold, (n_queries, n), to 0 and the clip.

    Where no neuron fires, the best of the `n_first` first ones does.
    """
    for query in range(len(scores)):
        own = scores[query]
        fires = False
        for i in range(len(own)):
            fires |= own[i] > 0
        winner = 0
        for i in range(0 if fires else n_first):
            winner = i if own[i] > own[winner] else winner
        for i in range(len(own)):
            own[i] = min(max(own[i], np.float32(0)), clip)
        if n_first and not fires:
            own[winner] = 0.5


@compiled
def _multiply(steps, levels, factor, bias, net):  # type: ignore[no-untyped-def]
    """Write the net input and the bias of neurons, (n_queries, n_out), by all steps (n_out, n_in)."""
    for query in range(len(levels)):
        own = levels[query]
        for row in range(len(steps)):
            weights = steps[row]
            total = np.int32(0)
            for i in range(len(own)):
                total = np.int32(total + np.int32(np.int32(weights[i]) * np.int32(own[i])))  # else numba takes 64 bits
            net[query, row] = np.float32(total) * factor[row] + bias[row]


@compiled
def _add_synapses(steps, columns, factor, bias, levels, net):  # type: ignore[no-untyped-def]
    """Write the net input and the bias of neurons, (n_queries, n_out), by their synapses, (most of a neuron, n_out)."""
    total, read = np.empty(len(bias), np.int32), np.empty(len(bias), np.uint8)
    for query in range(len(levels)):
        own, written = levels[query], net[query]
        total[:] = 0
        for k in range(len(steps)):
            step, column = steps[k], columns[k]
            for neuron in range(len(bias)):
                read[neuron] = own[column[neuron]]
            for neuron in range(len(bias)):
                total[neuron] += np.int32(step[neuron]) * np.int32(read[neuron])
        for neuron in range(len(bias)):
            written[neuron] = np.float32(total[neuron]) * factor[neuron] + bias[neuron]


def _compile() -> None:
    """Compile the loops, or read them from the cache, so that no query waits for it."""
    _write_levels(np.zeros(1, np.float32), _LEVELS, np.zeros(1, np.uint8))
    row, steps, levels = np.zeros(1, np.float32), np.zeros((1, 1), np.int8), np.zeros((1, 1), np.uint8)
    _add_synapses(steps, np.zeros((1, 1), np.int32), row, row, levels, row[None].copy())
    net = row[None].copy()
    _activate(net, np.float32(1), 0)
    _multiply(steps, levels, row, row, net)


_compile()

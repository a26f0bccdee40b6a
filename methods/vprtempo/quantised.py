"""A trained VPRTempo network asked in 8 bits: weights as int8, activations as uint8, sums as int32."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numpy as np
import numpy.typing as npt
import torch

from vprbench.api import Scores, count_operations

from . import vnni
from .compiled import compiled
from .network import Network
from .query import Amplitudes, linear_layer, sparse
from .rules import Rules

_LEVELS = np.float32(255)  # of an activation
_STEPS = np.float32(127)  # of a weight to either side of 0
MOST_INPUTS = 2**31 // (255 * 127)  # of a neuron, whose sums 32 bits hold
_WORTH_THREADS = 16  # queries: fewer are answered before a thread has started
_FEW = 0.02  # of the synapses, up to which those that exist are read alone


class _Layer:
    """An affine map by rows of 127 steps to either side of 0; the sums are exact, for one input as for many."""

    def __init__(self, weights: npt.NDArray[np.float32], bias: npt.NDArray[np.float32], most: np.float32) -> None:
        """Quantise `weights` (n_out, n_in), a row at a time, for inputs from 0 to `most`; `bias` is (n_out,)."""
        step = np.maximum(np.abs(weights).max(1), np.finfo(np.float32).tiny) / _STEPS
        steps = np.ascontiguousarray(np.rint(weights / step[:, None]), np.int8)
        self.n_out = len(steps)
        self.n_weights = steps.size  # of synapses that exist or not
        factor = np.asarray(step * (most / _LEVELS), np.float32)  # of a sum of steps times levels
        self._map = _by_synapses(steps, factor, bias) or _affine_map(steps, factor, bias)

    def __call__(self, levels: Levels, net: Floats | None = None) -> Floats:
        """Return (n_queries, n_out) of the input's levels (n_queries, n_in), written to `net` if it is given."""
        written = np.empty((len(levels), self.n_out), np.float32) if net is None else net
        self._map(levels, written)
        return written


Levels = npt.NDArray[np.uint8]  # (n_queries, n)
Floats = npt.NDArray[np.float32]  # (n_out,), or (n_queries, n_out)
Map = Callable[[Levels, Floats], None]  # writes what levels (n_queries, n_in) give to (n_queries, n_out)


def _by_synapses(steps: npt.NDArray[np.int8], factor: Floats, bias: Floats) -> Map | None:
    """Return the map that reads the synapses that exist; None if they are many."""
    synapses = sparse(steps, _FEW)
    if synapses is None:
        return None

    return lambda levels, net: _add_synapses(*synapses, factor, bias, levels, net)


def _affine_map(steps: npt.NDArray[np.int8], factor: Floats, bias: Floats) -> Map:
    """Return the map by `steps` (n_out, n_in), times `factor`, plus `bias`, in the fastest way that is exact here.

    Without AVX-512 VNNI it is oneDNN's 8-bit product, exact with another VNNI. Without any, x86 adds pairs of products
    in 16 bits, which hold those of half steps: each step is then two halves, which read the same level.
    """
    if vnni.AVAILABLE:
        return vnni.affine_map(steps, factor, bias)
    parts = 1 if _is_exact(1) else 2 if _is_exact(2) else 0
    return _by_onednn(steps, factor, bias, parts) if parts else _by_loops(steps, factor, bias)


def _by_loops(steps: npt.NDArray[np.int8], factor: Floats, bias: Floats) -> Map:
    """Return the map by sums of our own."""

    def by_loops(levels: Levels, net: Floats) -> None:
        sums = np.empty((len(levels), len(steps)), np.int32)
        _multiply(steps, levels, sums)
        net[:] = sums * factor + bias

    return by_loops


def _by_onednn(steps: npt.NDArray[np.int8], factor: Floats, bias: Floats, parts: int) -> Map:
    """Return oneDNN's map by steps, each in so many parts; raises RuntimeError where PyTorch has none."""
    halves = [steps] if parts == 1 else [steps // 2, steps - steps // 2]
    n_out = len(steps)
    packed = torch.ops.onednn.qlinear_prepack(torch.from_numpy(np.concatenate(halves, axis=1)), None)
    scales = torch.tensor(factor), torch.zeros(n_out, dtype=torch.int32), torch.tensor(bias)
    rest: tuple[object, ...] = (packed, *scales, 1.0, 0, torch.float32, "none", [], "")

    def by_onednn(levels: Levels, net: Floats) -> None:
        given = torch.from_numpy(levels if parts == 1 else np.concatenate([levels] * parts, axis=1))
        net[:] = torch.ops.onednn.qlinear_pointwise(given, 1.0, 0, *rest).numpy()

    return by_onednn


@cache
def _is_exact(parts: int) -> bool:
    """Tell whether oneDNN's product by steps in so many parts is exact here, for the largest values there are."""
    steps, levels = np.full((16, 64), 127, np.int8), np.full((8, 64), 255, np.uint8)
    steps[::2] = -127
    try:
        product = _by_onednn(steps, np.ones(16, np.float32), np.zeros(16, np.float32), parts)
    except (AttributeError, RuntimeError):  # a PyTorch without oneDNN
        return False
    for some in (levels[:1], levels):
        found = np.empty((len(some), 16), np.float32)
        product(some, found)
        if not np.array_equal(found, some.astype(int) @ steps.T.astype(int)):
            return False
    return True


class Int8LinearQuery:
    """The public code's query in 8 bits: one matrix."""

    def __init__(self, members: Sequence[Network]) -> None:
        """Quantise the product of both layers, or the mean of several."""
        weights, bias = linear_layer(members)
        self._layer = _Layer(weights.cpu().numpy(), bias.cpu().numpy(), np.float32(1))

    def scores(self, spikes: npt.NDArray[np.float32]) -> Scores:
        """Return the state of every place's output neuron."""
        count_operations(len(spikes) * self._layer.n_weights, kind="int8")
        scores = np.empty((len(spikes), self._layer.n_out), np.float32)
        _in_threads(lambda own, written: self._layer(_levels(own, np.float32(1)), written), spikes, scores)
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
        _in_threads(lambda own, written: self._fire(self._feature_levels(own), written), spikes, scores)
        return scores

    def layers(self, spikes: npt.NDArray[np.float32]) -> tuple[Amplitudes, Amplitudes]:
        """Return the spikes of the feature neurons, all modules side by side, and of the output neurons."""
        levels, scores = self._feature_levels(spikes), np.empty((len(spikes), self._n_places), np.float32)
        self._fire(levels, scores)
        return levels * (self._clip / _LEVELS), scores

    def _feature_levels(self, spikes: npt.NDArray[np.float32]) -> Levels:
        """Return the feature spikes of all modules, (n_queries, modules * n_features), in steps up to the clip."""
        return _levels(self._features(_levels(spikes, np.float32(1))), self._clip)

    def _fire(self, levels: Levels, scores: Scores) -> None:
        """Write the activation of Eq. 1 of all output neurons, (n_queries, n_places), for the feature spikes."""
        features, start = levels.reshape(len(levels), len(self._outputs), self._n_features), 0
        for module, layer in enumerate(self._outputs):
            layer(np.ascontiguousarray(features[:, module]), scores[:, start : start + layer.n_out])
            start += layer.n_out
        _activate(scores, self._clip, self._outputs[0].n_out if self._silent_winner else 0)


def _in_threads(write: Callable[[Amplitudes, Scores], object], spikes: Amplitudes, scores: Scores) -> None:
    """Let `write` answer input spikes with scores (n_queries, n_places), in all threads if it computes in its own."""
    threads = torch.get_num_threads() if vnni.AVAILABLE and len(spikes) >= _WORTH_THREADS else 1
    if threads == 1:
        write(spikes, scores)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(write, np.array_split(spikes, threads), np.array_split(scores, threads)))


def _levels(activation: npt.NDArray[np.float32], most: np.float32) -> Levels:
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
    _multiply(steps, levels, np.zeros((1, 1), np.int32))


_compile()

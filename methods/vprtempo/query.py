"""Asking a trained VPRTempo network: one query at a time at the speed of memory, many at once as matrix products."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from vprbench.api import Circuit, Scores, count_operations

from .layer import compiled
from .network import Network
from .rules import Rules

Amplitudes = npt.NDArray[np.float32]  # (n_queries, n_neurons), 0: silent

_BLOCK, _BLOCK_ON_GPU = 256, 4096  # queries whose feature spikes are held together
_LEAST_SPREAD = 0.01  # of the mean spread
_FEW = 0.02  # of the synapses, up to which those that exist are read alone
_SIDE_BY_SIDE = 8  # features whose output weights are added in one pass over the scores


class Query(Protocol):
    """Answers input spikes (n_queries, n_pixels) with the scores of all places (n_queries, n_places)."""

    def scores(self, spikes: npt.NDArray[np.float32]) -> Scores:
        """Return the state of every place's output neuron."""


class LinearQuery:
    """The public code's query: without thresholds a network, or the mean of several, is a single matrix."""

    def __init__(self, members: Sequence[Network]) -> None:
        """Multiply the layers of every module."""
        self._matrix, self._bias = multiply_layers(members)
        self._layer = _make_layer(self._matrix, self._bias)

    def scores(self, spikes: npt.NDArray[np.float32]) -> Scores:
        """Return the state of every place's output neuron."""
        count_operations(len(spikes) * self._matrix.numel())
        x = torch.tensor(spikes, device=self._matrix.device)
        scores = torch.addmv(self._bias, self._matrix, x[0])[None] if len(x) == 1 else self._layer(x)
        return np.asarray(scores.cpu().numpy(), np.float32)


class MeanQuery:
    """The mean score of networks of the same places; scores of a calibrated network are standardised first."""

    def __init__(self, members: Sequence[Network], queries: Sequence[Query]) -> None:
        """Ask each network by its query."""
        self._queries = queries
        self._calibrations = [
            member.calibration and [part.cpu().numpy() for part in member.calibration] for member in members
        ]

    def scores(self, spikes: npt.NDArray[np.float32]) -> Scores:
        """Return the mean state of every place's output neurons."""
        total = self._member_scores(0, spikes)
        for member in range(1, len(self._queries)):
            total += self._member_scores(member, spikes)
        return total / np.float32(len(self._queries))

    def _member_scores(self, member: int, spikes: npt.NDArray[np.float32]) -> Scores:
        """Return the scores of one network, in spreads above the mean that the references gave each place."""
        scores = self._queries[member].scores(spikes)
        if calibration := self._calibrations[member]:
            mean, spread = calibration
            scores -= mean
            scores /= spread
        return scores


class SpikingQuery:
    """The paper's query: both layers as in Eq. 1.

    A single query is bound by reading the weights, so the output weights of silent features are never read.
    """

    def __init__(self, network: Network, rules: Rules) -> None:
        """Lay the weights out for both ways of asking."""
        self._rules = rules
        features = network.features.flatten(0, 1)  # (modules * n_features, n_pixels)
        bias = (network.constant - network.feature_thresholds).flatten()
        self._device = features.device
        self._weights = features.numel() + sum(weights.numel() for weights in network.outputs)  # existing or not
        self._synapses = find_synapses(features.numpy()) if self._device.type == "cpu" else None
        self._feature_layer = _make_layer(features, bias) if self._synapses is None else self._read_synapses
        self._output_layers = [
            _make_layer(weights.T, -thresholds)
            for weights, thresholds in zip(network.outputs, network.output_thresholds, strict=True)
        ]
        self._ends = np.cumsum([0, *(len(thresholds) for thresholds in network.output_thresholds)])
        if self._device.type == "cpu":
            self._rows = features.numpy(), bias.numpy()
        self._columns = [weights.cpu().numpy() for weights in network.outputs]
        self._thresholds = torch.cat(network.output_thresholds).cpu().numpy()

    def scores(self, spikes: npt.NDArray[np.float32]) -> Scores:
        """Return the state of every place's output neuron."""
        count_operations(len(spikes) * self._weights)
        if len(spikes) == 1 and self._device.type == "cpu":
            return self._activate(self._sum_one(np.ascontiguousarray(spikes[0]))).numpy()
        scores = np.empty((len(spikes), self._ends[-1]), np.float32)
        together = _BLOCK if self._device.type == "cpu" else _BLOCK_ON_GPU
        for start in range(0, len(spikes), together):
            block = torch.tensor(spikes[start : start + together], device=self._device)
            scores[start : start + together] = self._activate(self._sum_above(self._fire_features(block))).cpu().numpy()
        return scores

    def _sum_one(self, x: npt.NDArray[np.float32]) -> Tensor:
        """Return the net input above threshold of all output neurons, (1, n_places), for one input (n_pixels,)."""
        above = np.empty(self._ends[-1], np.float32)
        weights, bias = self._rows
        spikes = np.empty(len(bias), np.float32)
        if self._synapses is None:
            _fire_all_features(weights, bias, x, np.float32(self._rules.clip), spikes)
        else:
            _add_synapses(*self._synapses, bias, x[None], spikes[None])
            np.clip(spikes, 0, np.float32(self._rules.clip), out=spikes)
        n_features = len(spikes) // len(self._columns)
        for module, columns in enumerate(self._columns):
            active = spikes[module * n_features : (module + 1) * n_features]
            add_active(columns, active, above[self._ends[module] : self._ends[module + 1]])
        above -= self._thresholds
        return torch.from_numpy(above)[None]

    def layers(self, spikes: npt.NDArray[np.float32]) -> tuple[Amplitudes, Amplitudes]:
        """Return the spikes of the feature neurons, all modules side by side, and of the output neurons."""
        features = self._fire_features(torch.tensor(spikes, device=self._device))
        outputs = self._activate(self._sum_above(features))
        return features.cpu().numpy(), outputs.cpu().numpy()

    def _read_synapses(self, x: Tensor) -> Tensor:
        """Return the net input above threshold of all features, (n, n_neurons), reading the synapses that exist."""
        assert self._synapses is not None
        net = np.empty((len(x), len(self._rows[1])), np.float32)
        _add_synapses(*self._synapses, self._rows[1], x.numpy(), net)
        return torch.from_numpy(net)

    def _fire_features(self, x: Tensor) -> Tensor:
        """Return the feature spikes of all modules, (n, modules * n_features), for inputs (n, n_pixels)."""
        return self._feature_layer(x).clamp_(0, self._rules.clip)

    def _sum_above(self, features: Tensor) -> Tensor:
        """Return the net input above threshold of all output neurons, (n, n_places), for the feature spikes."""
        own = features.view(len(features), len(self._output_layers), -1)
        return torch.cat([layer(own[:, m].contiguous()) for m, layer in enumerate(self._output_layers)], dim=1)

    def _activate(self, above: Tensor) -> Tensor:
        """Return the activation of Eq. 1; of silent queries that of the first module's least inhibited neuron."""
        scores = above.clamp(0, self._rules.clip)
        if self._rules.silent_winner:
            silent = torch.nonzero((scores == 0).all(1))[:, 0]
            scores[silent, above[silent, : self._ends[1]].argmax(1)] = 0.5
        return scores


def make_query(
    members: Sequence[Network],
    rules: Rules,
    linear: Callable[[Sequence[Network]], Query] = LinearQuery,
    spiking: Callable[[Network, Rules], Query] = SpikingQuery,
) -> Query:
    """Return the query of networks of the same places by the query rule; the scores of several are averaged."""
    if rules.query_rule == "linear":
        return linear(members)
    queries = [spiking(member, rules) for member in members]
    return queries[0] if len(members) == 1 and members[0].calibration is None else MeanQuery(members, queries)


def calibrate_network(network: Network, spikes: Tensor, rules: Rules) -> Network:
    """Return the network with the mean and the spread of the scores that the references give each place."""
    query = make_query([network], rules)
    total = total_of_squares = torch.zeros(network.n_places, dtype=torch.float64)
    for block in torch.split(spikes, _BLOCK):
        scores = torch.from_numpy(query.scores(block.cpu().numpy())).double()
        total = total + scores.sum(0)
        total_of_squares = total_of_squares + scores.square().sum(0)
    mean = total / len(spikes)
    spread = (total_of_squares / len(spikes) - mean.square()).clamp(min=0).sqrt()
    # A place that hardly answers to any reference must not shout at the first query that it answers to.
    spread = spread.clamp(min=float(_LEAST_SPREAD * spread.mean()) or 1.0)
    device = network.features.device
    return replace(network, calibration=(mean.float().to(device), spread.float().to(device)))


def _make_layer(weights: Tensor, bias: Tensor) -> Callable[[Tensor], Tensor]:
    """Return the affine map of inputs (n, n_in) by `weights` (n_out, n_in) and `bias` (n_out,)."""
    packable = weights.device.type == "cpu" and torch.backends.mkldnn.is_available()  # type: ignore[no-untyped-call]
    if not packable:
        return lambda x: functional.linear(x, weights, bias)
    # oneDNN's own format: twice as fast on processors with AVX-512 that are not Intel's
    packed = weights.to_mkldnn(), bias.to_mkldnn()
    return lambda x: functional.linear(x.to_mkldnn(), *packed).to_dense()


def multiply_layers(members: Sequence[Network]) -> tuple[Tensor, Tensor]:
    """Return the product of both layers, (n_places, n_pixels), and its bias, (n_places,); means over the members."""
    weights, biases = [], []
    for member in members:
        product = torch.cat([outputs.T @ member.features[module] for module, outputs in enumerate(member.outputs)])
        bias = product.new_zeros(len(product))
        if member.calibration is not None:
            mean, spread = member.calibration
            product /= spread[:, None]
            bias -= mean / spread
        weights.append(product)
        biases.append(bias)
    return sum(weights[1:], weights[0]) / len(members), sum(biases[1:], biases[0]) / len(members)


def make_circuit(members: Sequence[Network], rules: Rules) -> Circuit:
    """Return the layers of networks of the same places, whose features lie side by side; scores are their mean."""
    spiking = rules.query_rule == "spiking"
    features = torch.cat([member.features.flatten(0, 1) for member in members])
    above = torch.cat([(member.constant - member.feature_thresholds).flatten() for member in members])
    outputs, biases = [], []
    for member in members:
        weights = torch.block_diag(*(own.T for own in member.outputs))  # type: ignore[no-untyped-call]
        bias = -torch.cat(member.output_thresholds) * spiking
        if member.calibration is not None:
            mean, spread = member.calibration
            weights, bias = weights / spread[:, None], -mean / spread
        outputs.append(weights / len(members))
        biases.append(bias / len(members))
    layers = (features, above * spiking), (torch.cat(outputs, dim=1), torch.stack(biases).sum(0))
    return Circuit(
        tuple((weights.cpu().numpy(), bias.cpu().numpy()) for weights, bias in layers), rules.clip if spiking else None
    )


def find_synapses(weights: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], npt.NDArray[np.int32]] | None:
    """Return the values and the inputs of synapses of weights (n, n_inputs), each (most of a neuron, n).

    Neurons with fewer synapses have more of value 0. None if so many synapses exist that reading all is faster.
    """
    if np.count_nonzero(weights) > _FEW * weights.size:
        return None
    neurons, inputs = np.nonzero(weights)
    number = np.arange(len(neurons)) - np.searchsorted(neurons, neurons)  # among those of its neuron
    shape = (number.max(initial=0) + 1, len(weights))
    values, columns = np.zeros(shape, weights.dtype), np.zeros(shape, np.int32)
    values[number, neurons], columns[number, neurons] = weights[neurons, inputs], inputs
    return values, columns


@compiled
def _add_synapses(values, columns, bias, x, net):  # type: ignore[no-untyped-def]
    """Write the net input and the bias of neurons, (n, n_neurons), for inputs (n, n_inputs), by their synapses."""
    for query in range(len(x)):
        own, total = x[query], net[query]
        total[:] = 0
        for k in range(len(values)):
            value, column = values[k], columns[k]
            for neuron in range(len(bias)):
                total[neuron] += value[neuron] * own[column[neuron]]
        for neuron in range(len(bias)):
            total[neuron] += bias[neuron]


@compiled
def _fire_all_features(weights, bias, x, clip, spikes):  # type: ignore[no-untyped-def]
    """Write the spikes of feature neurons (n,) for one input (n_pixels,), `weights` (n, n_pixels)."""
    for neuron in range(len(spikes)):
        net = np.float32(0)
        row = weights[neuron]
        for i in range(len(x)):
            net += row[i] * x[i]
        spikes[neuron] = min(max(net + bias[neuron], np.float32(0)), clip)


@compiled
def add_active(weights, spikes, net):  # type: ignore[no-untyped-def]
    """Write the net input of output neurons (n_places,), `weights` (n_features, n_places), reading active rows only."""
    net[:] = 0
    active = np.flatnonzero(spikes)
    whole = len(active) - len(active) % _SIDE_BY_SIDE
    for start in range(0, whole, _SIDE_BY_SIDE):
        a, b, c, d, e, f, g, h = active[start : start + _SIDE_BY_SIDE]
        for place in range(len(net)):
            net[place] += (
                spikes[a] * weights[a, place]
                + spikes[b] * weights[b, place]
                + spikes[c] * weights[c, place]
                + spikes[d] * weights[d, place]
                + spikes[e] * weights[e, place]
                + spikes[f] * weights[f, place]
                + spikes[g] * weights[g, place]
                + spikes[h] * weights[h, place]
            )
    for feature in active[whole:]:
        for place in range(len(net)):
            net[place] += spikes[feature] * weights[feature, place]


def _compile() -> None:
    """Compile the loops of a single query, or read it from the cache, so that no query waits for it."""
    weights, row = np.zeros((1, 1), np.float32), np.zeros(1, np.float32)
    _fire_all_features(weights, row, row, np.float32(1), row.copy())
    _add_synapses(weights, np.zeros((1, 1), np.int32), row, weights, weights.copy())
    add_active(weights, row, row.copy())


_compile()

"""The training of VPRTempo neuron by neuron: the same rules as `layer`, compiled, each weight row in the cache.

What a neuron learns depends on no other neuron of its layer. So a neuron goes through its whole training while its
weights stay in the processor's cache, and threads share the neurons. One pass over the row does a step's update,
limits and homeostasis together with the next step's net input.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from numba import njit
from torch import Tensor

from .layer import LARGEST, SMALLEST, Layer
from .rules import Rules
from .training import Schedule

Row = npt.NDArray[np.float32]

_NEURONS_PER_TASK = 16
_SPIKE, _AMPLITUDE, _DECAY = 0, 1, 2
_THRESHOLD_RULES = {"spike": _SPIKE, "amplitude": _AMPLITUDE, "decay": _DECAY}
_SMALL_SHARE = np.float32(SMALLEST / LARGEST)


_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"reassoc", "contract", "arcp", "nsz"},  # sums may be reordered; infinities still count
}


def _compiled(function: Callable[..., None]) -> Callable[..., Any]:
    """Compile `function`, and keep the result where a folder can be written."""
    try:
        compiled: Callable[..., Any] = njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:
        compiled = njit(**_OPTIONS)(function)
    return compiled


def train_features(
    layer: Layer,
    spikes: Tensor,
    schedule: Schedule,
    rates: Tensor,
    stdp: float,
    itp: float,
    rules: Rules,
    report: Callable[[float], None],
) -> None:
    """Train a feature layer in place, as `training.train_features` does."""
    shown = spikes.numpy()
    for module in range(len(layer.thresholds)):
        factor = np.ascontiguousarray(schedule.factor[:, module])
        arguments = (
            *_rows(layer, module),
            shown,
            np.ascontiguousarray(schedule.image[:, module]),
            np.float32(stdp) * factor,
            np.float32(itp) * factor,
            rates.numpy(),
            np.float32(rules.homeostasis_gain),
            np.float32(rules.clip),
            _THRESHOLD_RULES[rules.threshold_rule],
            rules.stdp_divided_by_rate,
        )
        _in_threads(_learn_features, arguments, layer.thresholds.shape[1], report)


def train_places(
    layer: Layer,
    features: Layer,
    spikes: Tensor,
    schedule: Schedule,
    rates: Tensor,
    stdp: float,
    rules: Rules,
    report: Callable[[float], None],
) -> None:
    """Train an output layer in place, as `training.train_places` does."""
    inverse_rates = 1 / rates.numpy()
    for module in range(len(layer.thresholds)):
        image, seen = np.unique(schedule.image[:, module].numpy(), return_inverse=True)
        net = torch.addmm(features.constant[module], spikes[image], features.weights[module].T)
        shown = (net - features.thresholds[module]).clamp_(0, rules.clip).numpy()
        arguments = (
            *_rows(layer, module),
            shown,
            seen,
            np.ascontiguousarray(schedule.neuron[:, module]),
            np.float32(stdp) * np.ascontiguousarray(schedule.factor[:, module]),
            inverse_rates,
            np.float32(rules.homeostasis_gain),
            np.float32(rules.clip),
            np.float32(1.0 if rules.error_to_each_sign else 0.5),
            rules.output_thresholds_learn,
        )
        _in_threads(_learn_places, arguments, layer.thresholds.shape[1], report)


def _rows(layer: Layer, module: int) -> tuple[Row, ...]:
    """Return a module's weights, their upper limits (one row for all where all synapses exist), thresholds and C."""
    full = np.full((1, layer.excitation.shape[2]), LARGEST, np.float32)
    limits = [
        full if pair is None else pair[1][module].numpy() for pair in (layer.excitation_limits, layer.inhibition_limits)
    ]
    return (
        layer.excitation[module].numpy(),
        layer.inhibition[module].numpy(),
        *limits,
        layer.thresholds[module].numpy(),
        layer.constant[module].numpy(),
    )


def _in_threads(
    learn: Callable[..., None], arguments: tuple[Any, ...], n_neurons: int, report: Callable[[float], None]
) -> None:
    """Call `learn(*arguments, first, last)` for blocks of neurons, in as many threads as PyTorch may use."""
    starts = range(0, n_neurons, _NEURONS_PER_TASK)
    with ThreadPoolExecutor(torch.get_num_threads()) as threads:
        tasks = [
            threads.submit(learn, *arguments, start, min(start + _NEURONS_PER_TASK, n_neurons)) for start in starts
        ]
        try:
            for done, task in enumerate(tasks):
                task.result()
                report((done + 1) / len(tasks))
        finally:
            threads.shutdown(cancel_futures=True)


@_compiled
def _net_input(excitation, inhibition, x):  # type: ignore[no-untyped-def]
    total = np.float32(0)
    for i in range(len(x)):
        total += (excitation[i] - inhibition[i]) * x[i]
    return total


@_compiled
def _learn_features(  # type: ignore[no-untyped-def]
    excitations,
    inhibitions,
    excitation_limits,
    inhibition_limits,
    thresholds,
    constants,
    spikes,
    order,
    stdp,
    itp,
    rates,
    gain,
    clip,
    threshold_rule,
    divided_by_rate,
    first,
    last,
):
    """Take neurons `first` to `last` through the whole training of a feature layer."""
    for neuron in range(first, last):
        excitation, inhibition = excitations[neuron], inhibitions[neuron]
        most_excitation = excitation_limits[neuron % len(excitation_limits)]
        most_inhibition = inhibition_limits[neuron % len(inhibition_limits)]
        constant, rate, threshold = constants[neuron], rates[neuron], thresholds[neuron]
        net = _net_input(excitation, inhibition, spikes[order[0]]) + constant
        for step in range(len(order)):
            x = spikes[order[step]]
            following = spikes[order[min(step + 1, len(order) - 1)]]
            y = min(max(net - threshold, np.float32(0)), clip)
            fired = y > 0
            post = stdp[step] * (np.float32(0.5) - y) if fired else np.float32(0)
            if divided_by_rate:
                post /= rate
            scale = max(np.float32(1) + gain * stdp[step] * net, np.float32(0))
            if threshold_rule == _SPIKE:
                threshold += itp[step] * (np.float32(fired) - rate)
            elif threshold_rule == _AMPLITUDE:
                threshold += itp[step] * (y - rate)
            else:
                threshold -= itp[step] * rate
            threshold = max(threshold, np.float32(0))
            total = np.float32(0)
            for i in range(len(x)):
                change = post if x[i] > 0 else np.float32(0)
                e = min(max(excitation[i] + change, most_excitation[i] * _SMALL_SHARE), most_excitation[i])
                h = min(max(inhibition[i] + change, most_inhibition[i] * _SMALL_SHARE), most_inhibition[i]) * scale
                excitation[i] = e
                inhibition[i] = h
                total += (e - h) * following[i]
            net = total + constant
        thresholds[neuron] = threshold


@_compiled
def _learn_places(  # type: ignore[no-untyped-def]
    excitations,
    inhibitions,
    excitation_limits,
    inhibition_limits,
    thresholds,
    constants,
    spikes,
    order,
    forced,
    stdp,
    inverse_rates,
    gain,
    clip,
    share,
    thresholds_learn,
    first,
    last,
):
    """Take neurons `first` to `last` through the whole training of an output layer."""
    for neuron in range(first, last):
        excitation, inhibition = excitations[neuron], inhibitions[neuron]
        most_excitation = excitation_limits[neuron % len(excitation_limits)]
        most_inhibition = inhibition_limits[neuron % len(inhibition_limits)]
        constant, threshold = constants[neuron], thresholds[neuron]
        net = _net_input(excitation, inhibition, spikes[order[0]]) + constant
        for step in range(len(order)):
            x = spikes[order[step]]
            following = spikes[order[min(step + 1, len(order) - 1)]]
            target = np.float32(0.5) if forced[step] == neuron else np.float32(0)
            error = target - min(max(net - threshold, np.float32(0)), clip)
            if thresholds_learn:
                threshold = max(threshold - np.sign(error) * stdp[step] / np.float32(5), np.float32(0))
            post = share * stdp[step] * error
            scale = max(np.float32(1) + gain * stdp[step] * net, np.float32(0))
            total = np.float32(0)
            for i in range(len(x)):
                change = post * x[i] * inverse_rates[i]
                e = min(max(excitation[i] + change, most_excitation[i] * _SMALL_SHARE), most_excitation[i])
                h = min(max(inhibition[i] - change, most_inhibition[i] * _SMALL_SHARE), most_inhibition[i]) * scale
                excitation[i] = e
                inhibition[i] = h
                total += (e - h) * following[i]
            net = total + constant
        thresholds[neuron] = threshold


def _compile() -> None:
    """Compile both kernels, or read them from the cache, so that no training waits for it."""
    weights, row = np.ones((1, 1), np.float32), np.zeros(1, np.float32)
    order, one = np.zeros(1, np.int64), np.float32(1)
    layer = (weights, weights, weights, weights, row, row, weights, order)
    _learn_features(*layer, row, row, row, one, one, _SPIKE, False, 0, 0)
    _learn_places(*layer, order, row, row, one, one, one, False, 0, 0)


_compile()

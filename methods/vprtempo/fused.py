"""The training of VPRTempo neuron by neuron: the same rules as `layer`, compiled, each weight row in the cache.

What a neuron learns depends on no other neuron of its layer. So a neuron goes through its whole training while its
weights stay in the processor's cache, and threads share the neurons of all modules. One pass over the row does a
step's update, limits and homeostasis together with the next step's net input; where a neuron is silent nothing but
its inhibition changes, and the pass is shorter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from .compiled import compiled
from .layer import LARGEST, SMALLEST, Layer
from .rules import Rules
from .training import Schedule

Row = npt.NDArray[np.float32]

# Neurons that go through the training together share the reading of the images; their weights fit into an L2 cache.
_SIDE_BY_SIDE = 32
_SPIKE, _AMPLITUDE, _DECAY = 0, 1, 2
_THRESHOLD_RULES = {"spike": _SPIKE, "amplitude": _AMPLITUDE, "decay": _DECAY}
_LEAST, _MOST = np.float32(SMALLEST), np.float32(LARGEST)
# Stands for a synapse that exists with weight 0, until the next limit lifts it: 0 is a synapse that does not exist.
_NEARLY_NOTHING = 1e-30


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
        with _rows(layer, module, rules) as rows:
            arguments = (
                *rows,
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
    inverse_rates = (1 / rates).numpy()
    for module in range(len(layer.thresholds)):
        image, seen = np.unique(schedule.image[:, module].numpy(), return_inverse=True)
        net = torch.addmm(features.constant[module], spikes[image], features.weights[module].T)
        shown = net.sub_(features.thresholds[module]).clamp_(0, rules.clip)
        with _rows(layer, module, rules) as rows:
            arguments = (
                *rows,
                shown.numpy(),
                inverse_rates,
                seen,
                np.ascontiguousarray(schedule.neuron[:, module]),
                np.float32(stdp) * np.ascontiguousarray(schedule.factor[:, module]),
                np.float32(rules.homeostasis_gain),
                np.float32(rules.clip),
                np.float32(1.0 if rules.error_to_each_sign else 0.5),
                rules.output_thresholds_learn,
            )
            _in_threads(_learn_places, arguments, layer.thresholds.shape[1], report)


@contextmanager
def _rows(layer: Layer, module: int, rules: Rules) -> Iterator[tuple[Any, ...]]:
    """Lend a module's weights to a kernel: excitation, inhibition, thresholds, C and whether both are one array.

    Where a synapse has one sign only, its signed weight is all there is to pass over. A synapse that exists is lent
    as more than 0.
    """
    excitation, inhibition = layer.excitation[module], layer.inhibition[module]
    for weights, limits in ((excitation, layer.excitation_limits), (inhibition, layer.inhibition_limits)):
        exists = limits[1][module] > 0 if limits else torch.ones_like(weights, dtype=torch.bool)
        weights[exists & (weights == 0)] = _NEARLY_NOTHING
    rest = (layer.thresholds[module].numpy(), layer.constant[module].numpy())
    if rules.one_sign_per_synapse:
        signed = excitation - inhibition
        yield signed.numpy(), signed.numpy(), *rest, True
        torch.clamp(signed, min=0, out=excitation)
        torch.clamp(signed.neg_(), min=0, out=inhibition)
    else:
        yield excitation.numpy(), inhibition.numpy(), *rest, False


def _in_threads(
    learn: Callable[..., None], arguments: tuple[Any, ...], n_neurons: int, report: Callable[[float], None]
) -> None:
    """Call `learn(*arguments, first, last)` for blocks of neurons, in as many threads as PyTorch may use."""
    n_threads = torch.get_num_threads()
    size = max(1, min(_SIDE_BY_SIDE, n_neurons // (4 * n_threads)))  # with many threads none is to be idle at the end
    with ThreadPoolExecutor(n_threads) as threads:
        starts = range(0, n_neurons, size)
        tasks = [threads.submit(learn, *arguments, start, min(start + size, n_neurons)) for start in starts]
        try:
            for done, task in enumerate(tasks):
                task.result()
                report((done + 1) / len(tasks))
        finally:
            threads.shutdown(cancel_futures=True)


# The passes over a neuron's row: learn one step, and return the net input of the next image without C.
# `signed` holds W+ - W- of synapses that have one sign each.


@compiled
def _net_input(excitation, inhibition, one_sign, x):  # type: ignore[no-untyped-def]
    total = np.float32(0)
    if one_sign:
        for i in range(len(x)):
            total += excitation[i] * x[i]
    else:
        for i in range(len(x)):
            total += (excitation[i] - inhibition[i]) * x[i]
    return total


@compiled
def _balance(excitation, inhibition, scale, following):  # type: ignore[no-untyped-def]
    total = np.float32(0)
    for i in range(len(following)):
        h = inhibition[i]
        h = min(max(h, _LEAST), _MOST) * scale if h > 0 else np.float32(0)
        inhibition[i] = h
        total += (excitation[i] - h) * following[i]
    return total


@compiled
def _balance_signed(signed, scale, following):  # type: ignore[no-untyped-def]
    total = np.float32(0)
    for i in range(len(following)):
        w = signed[i]
        w = max(min(w, -_LEAST), -_MOST) * scale if w < 0 else w
        signed[i] = w
        total += w * following[i]
    return total


@compiled
def _stdp(excitation, inhibition, x, post, scale, following):  # type: ignore[no-untyped-def]
    total = np.float32(0)
    for i in range(len(following)):
        change = post if x[i] > 0 else np.float32(0)
        e, h = excitation[i], inhibition[i]
        e = min(max(e + change, _LEAST), _MOST) if e > 0 else np.float32(0)
        h = min(max(h + change, _LEAST), _MOST) * scale if h > 0 else np.float32(0)
        excitation[i] = e
        inhibition[i] = h
        total += (e - h) * following[i]
    return total


@compiled
def _stdp_signed(signed, x, post, scale, following):  # type: ignore[no-untyped-def]
    total = np.float32(0)
    for i in range(len(following)):
        change = post if x[i] > 0 else np.float32(0)
        w = signed[i]
        magnitude = min(max(abs(w) + change, _LEAST), _MOST)
        w = magnitude if w > 0 else (-magnitude * scale if w < 0 else np.float32(0))
        signed[i] = w
        total += w * following[i]
    return total


@compiled
def _force(excitation, inhibition, x, inverse_rates, post, scale, following):  # type: ignore[no-untyped-def]
    total = np.float32(0)
    for i in range(len(following)):
        change = post * (x[i] * inverse_rates[i])
        e = min(max(excitation[i] + change, _LEAST), _MOST)
        h = min(max(inhibition[i] - change, _LEAST), _MOST) * scale
        excitation[i] = e
        inhibition[i] = h
        total += (e - h) * following[i]
    return total


@compiled
def _force_signed(signed, x, inverse_rates, post, scale, following):  # type: ignore[no-untyped-def]
    total = np.float32(0)
    for i in range(len(following)):
        w = signed[i]
        moved = w + post * (x[i] * inverse_rates[i])
        excited = min(max(moved, _LEAST), _MOST)
        inhibited = max(min(moved, -_LEAST), -_MOST) * scale
        w = excited if w > 0 else (inhibited if w < 0 else np.float32(0))
        signed[i] = w
        total += w * following[i]
    return total


@compiled
def _mark_diverged(excitations, inhibitions, diverged, first):  # type: ignore[no-untyped-def]
    """Show in its weights that a neuron's net input once was no number, for limits and masks hide it there."""
    for number in range(len(diverged)):
        if diverged[number]:
            excitations[first + number] = np.nan
            inhibitions[first + number] = np.nan


@compiled
def _learn_features(  # type: ignore[no-untyped-def]
    excitations,
    inhibitions,
    thresholds,
    constants,
    one_sign,
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
    """Take neurons `first` to `last`, side by side, through the whole training of a feature layer."""
    net = np.empty(last - first, np.float32)
    diverged = np.zeros(last - first, np.bool_)
    for neuron in range(first, last):
        net[neuron - first] = (
            _net_input(excitations[neuron], inhibitions[neuron], one_sign, spikes[order[0]]) + constants[neuron]
        )
    for step in range(len(order)):
        x = spikes[order[step]]
        following = spikes[order[min(step + 1, len(order) - 1)]]
        for neuron in range(first, last):
            excitation, inhibition = excitations[neuron], inhibitions[neuron]
            own, rate, threshold = net[neuron - first], rates[neuron], thresholds[neuron]
            y = min(max(own - threshold, np.float32(0)), clip)
            fired = y > 0
            post = stdp[step] * (np.float32(0.5) - y) if fired else np.float32(0)
            if divided_by_rate:
                post /= rate
            scale = max(np.float32(1) + gain * stdp[step] * own, np.float32(_NEARLY_NOTHING))
            if threshold_rule == _SPIKE:
                threshold += itp[step] * (np.float32(fired) - rate)
            elif threshold_rule == _AMPLITUDE:
                threshold += itp[step] * (y - rate)
            else:
                threshold -= itp[step] * rate
            thresholds[neuron] = max(threshold, np.float32(0))
            learns = post != 0 or step == 0  # the first step brings every weight within its limits
            if one_sign:
                if learns:
                    own = _stdp_signed(excitation, x, post, scale, following)
                else:
                    own = _balance_signed(excitation, scale, following)
            elif learns:
                own = _stdp(excitation, inhibition, x, post, scale, following)
            else:
                own = _balance(excitation, inhibition, scale, following)
            net[neuron - first] = own + constants[neuron]
            diverged[neuron - first] |= not np.isfinite(own)
    _mark_diverged(excitations, inhibitions, diverged, first)


@compiled
def _learn_places(  # type: ignore[no-untyped-def]
    excitations,
    inhibitions,
    thresholds,
    constants,
    one_sign,
    spikes,
    inverse_rates,
    order,
    forced,
    stdp,
    gain,
    clip,
    share,
    thresholds_learn,
    first,
    last,
):
    """Take neurons `first` to `last`, side by side, through the whole training of an output layer."""
    net = np.empty(last - first, np.float32)
    diverged = np.zeros(last - first, np.bool_)
    for neuron in range(first, last):
        net[neuron - first] = (
            _net_input(excitations[neuron], inhibitions[neuron], one_sign, spikes[order[0]]) + constants[neuron]
        )
    for step in range(len(order)):
        x = spikes[order[step]]
        following = spikes[order[min(step + 1, len(order) - 1)]]
        for neuron in range(first, last):
            excitation, inhibition = excitations[neuron], inhibitions[neuron]
            own, threshold = net[neuron - first], thresholds[neuron]
            target = np.float32(0.5) if forced[step] == neuron else np.float32(0)
            error = target - min(max(own - threshold, np.float32(0)), clip)
            if thresholds_learn:
                thresholds[neuron] = max(threshold - np.sign(error) * stdp[step] / np.float32(5), np.float32(0))
            post = share * stdp[step] * error
            scale = max(np.float32(1) + gain * stdp[step] * own, np.float32(_NEARLY_NOTHING))
            learns = post != 0 or step == 0  # the first step brings every weight within its limits
            if one_sign:
                if learns:
                    own = _force_signed(excitation, x, inverse_rates, post, scale, following)
                else:
                    own = _balance_signed(excitation, scale, following)
            elif learns:
                own = _force(excitation, inhibition, x, inverse_rates, post, scale, following)
            else:
                own = _balance(excitation, inhibition, scale, following)
            net[neuron - first] = own + constants[neuron]
            diverged[neuron - first] |= not np.isfinite(own)
    _mark_diverged(excitations, inhibitions, diverged, first)


def _compile() -> None:
    """Compile both kernels, or read them from the cache, so that no training waits for it."""
    weights, row = np.ones((1, 1), np.float32), np.zeros(1, np.float32)
    order, one = np.zeros(1, np.int64), np.float32(1)
    layer = (weights, weights, row, row, False, weights)
    _learn_features(*layer, order, row, row, row, one, one, _SPIKE, False, 0, 0)
    _learn_places(*layer, row, order, order, row, one, one, one, False, 0, 0)


_compile()

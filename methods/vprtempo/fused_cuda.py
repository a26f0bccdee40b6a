"""The training of VPRTempo on a GPU: the same rules as `layer`, in Triton, each neuron's weights in registers.

What a neuron learns depends on no other neuron of its layer. So one program takes one neuron of one module through
many steps, and reads nothing in a step but the row that all neurons of its module read; between launches a neuron
is its weights and its threshold. The host queues launches and never waits for one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
import triton
import triton.language as tl
from torch import Tensor

from .layer import LARGEST, NEARLY_NOTHING, SMALLEST, Layer
from .training import Schedule, Training

_STEPS_PER_LAUNCH = 1000
_VALUES_HELD = 2**28  # of the rows that one launch shows, 1 GiB
_SYNAPSES_PER_THREAD = 16
_LEAST, _MOST = tl.constexpr(SMALLEST), tl.constexpr(LARGEST)
_NEARLY_NOTHING = tl.constexpr(NEARLY_NOTHING)


def train_features(layer: Layer, schedule: Schedule, training: Training, report: Callable[[float], None]) -> None:
    """Train a feature layer in place, as `training.train_features` does, all modules at once."""
    rules = training.rules
    for image, _, factor in _split_launches(schedule, training.spikes.shape[1], report):
        _launch(
            _learn_features,
            layer,
            training.spikes[image],
            (training.stdp * factor, training.itp * factor, training.rates, rules.homeostasis_gain, rules.clip),
            (False, rules.threshold_rule, rules.stdp_divided_by_rate),
        )


def train_places(
    layer: Layer, features: Layer, schedule: Schedule, training: Training, report: Callable[[float], None]
) -> None:
    """Train an output layer in place, as `training.train_places` does, all modules at once."""
    weights, rules = features.weights.mT, training.rules
    share = 1.0 if rules.error_to_each_sign else 0.5
    for image, neuron, factor in _split_launches(schedule, sum(weights.shape[1:]), report):
        net = torch.baddbmm(features.constant[:, None], training.spikes[image], weights)
        stdp = training.output_stdp * factor
        _launch(
            _learn_places,
            layer,
            net.sub_(features.thresholds[:, None]).clamp_(0, rules.clip),
            (neuron, stdp, 1 / training.rates, rules.homeostasis_gain, rules.clip, share),
            (not rules.one_sign_per_synapse, rules.output_thresholds_learn),
        )


def _split_launches(
    schedule: Schedule, values: int, report: Callable[[float], None]
) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Yield image, neuron and factor, each (modules, n_steps), of the steps of one launch after another.

    `values` is how many numbers the caller holds per step and module.
    """
    total, modules = schedule.image.shape
    most = max(1, min(_STEPS_PER_LAUNCH, _VALUES_HELD // (modules * values)))
    for start in range(0, total, most):
        steps = slice(start, min(start + most, total))
        image, neuron, factor = (
            part[steps].T.contiguous() for part in (schedule.image, schedule.neuron, schedule.factor)
        )
        yield image, neuron, factor
        report(steps.stop / total)


def _launch(
    kernel: triton.JITFunction,
    layer: Layer,
    shown: Tensor,
    arguments: tuple[Tensor | float, ...],
    choices: tuple[object, ...],
) -> None:
    """Queue a kernel that learns from the rows `shown` (modules, n_steps, n_pre), one program per neuron."""
    modules, n_post, n_pre = layer.excitation.shape
    width = triton.next_power_of_2(n_pre)
    # Its weights, limits and two rows take a thread 4 to 6 registers per synapse: with 16 synapses it stays clear of
    # spilling, and wider layers get more warps. With fewer synapses each, more warps would wait for the sum's barrier.
    warps = min(max(width // (32 * _SYNAPSES_PER_THREAD), 1), 16)
    # Triton launches on the current device, wherever the tensors are.
    with torch.cuda.device_of(shown):  # type: ignore[no-untyped-call]
        kernel[n_post, modules](
            # A view can't be had of what isn't contiguous, and the kernels know no strides.
            *(part.view(-1) for part in (layer.excitation, layer.inhibition)),
            *(part.view(-1) for part in (layer.thresholds, layer.constant, shown)),
            shown.shape[1],
            *arguments,
            *choices,
            n_pre,
            width,
            num_warps=warps,
        )


# The largest magnitude of a synapse that does not exist is 0, which wins over the smallest. It is one number where all
# synapses exist, so that nothing is then kept per synapse. A weight that is no number stays one, for
# `training.check_weights` to see.


@triton.jit
def _within(values, least, most):  # type: ignore[no-untyped-def]
    values = tl.maximum(values, least, propagate_nan=tl.PropagateNan.ALL)
    return tl.minimum(values, most, propagate_nan=tl.PropagateNan.ALL)


@triton.jit  # type: ignore[untyped-decorator]
def _largest(weights, ALL_EXIST: tl.constexpr):  # type: ignore[no-untyped-def]
    if ALL_EXIST:
        return _MOST
    else:  # noqa: RET505 (Triton would compile what follows the branch, too)
        return tl.where(weights > 0, _MOST, 0.0)


@triton.jit
def _homeostasis(gain, stdp, net):  # type: ignore[no-untyped-def]
    return tl.maximum(1 + gain * stdp * net, _NEARLY_NOTHING, propagate_nan=tl.PropagateNan.ALL)


@triton.jit
def _net_input(excitation, inhibition, x, constant):  # type: ignore[no-untyped-def]
    return tl.sum((excitation - inhibition) * x) + constant


# Not specialised: a last launch with fewer steps needs no compilation of its own.
@triton.jit(do_not_specialize=["n_steps"])  # type: ignore[untyped-decorator]
def _learn_features(  # type: ignore[no-untyped-def]
    excitations,
    inhibitions,
    thresholds,
    constants,
    shown,
    n_steps,
    stdps,
    itps,
    rates,
    gain,
    clip,
    ALL_EXIST: tl.constexpr,
    THRESHOLD_RULE: tl.constexpr,
    DIVIDED_BY_RATE: tl.constexpr,
    N_PRE: tl.constexpr,
    WIDTH: tl.constexpr,
):
    """Take one neuron of a feature layer through `n_steps` steps."""
    neuron, module = tl.program_id(0), tl.program_id(1).to(tl.int64)
    row = module * tl.num_programs(0) + neuron
    synapse = tl.arange(0, WIDTH)
    inside = synapse < N_PRE
    at = row * N_PRE + synapse
    excitation, inhibition = tl.load(excitations + at, inside, 0.0), tl.load(inhibitions + at, inside, 0.0)
    most_excitation, most_inhibition = _largest(excitation, ALL_EXIST), _largest(inhibition, ALL_EXIST)
    threshold, constant, rate = tl.load(thresholds + row), tl.load(constants + row), tl.load(rates + neuron)
    first = module * n_steps
    x = tl.load(shown + first * N_PRE + synapse, inside, 0.0)
    following = tl.load(shown + (first + tl.minimum(1, n_steps - 1)) * N_PRE + synapse, inside, 0.0)
    net = _net_input(excitation, inhibition, x, constant)
    for step in range(n_steps):
        stdp, itp = tl.load(stdps + first + step), tl.load(itps + first + step)
        y = _within(net - threshold, 0.0, clip)
        fired = (y > 0).to(tl.float32)
        post = stdp * (0.5 - y) * fired
        if DIVIDED_BY_RATE:
            post /= rate
        change = tl.where(x > 0, post, 0.0)
        excitation = _within(excitation + change, _LEAST, most_excitation)
        inhibition = _within(inhibition + change, _LEAST, most_inhibition) * _homeostasis(gain, stdp, net)
        if THRESHOLD_RULE == "spike":
            threshold += itp * (fired - rate)
        elif THRESHOLD_RULE == "amplitude":
            threshold += itp * (y - rate)
        else:
            threshold -= itp * rate
        threshold = tl.maximum(threshold, 0.0)
        x = following
        # Asked for before the sum, so that it arrives during the next step.
        following = tl.load(shown + (first + tl.minimum(step + 2, n_steps - 1)) * N_PRE + synapse, inside, 0.0)
        net = _net_input(excitation, inhibition, x, constant)
    tl.store(excitations + at, excitation, inside)
    tl.store(inhibitions + at, inhibition, inside)
    tl.store(thresholds + row, threshold)


@triton.jit(do_not_specialize=["n_steps"])  # type: ignore[untyped-decorator]
def _learn_places(  # type: ignore[no-untyped-def]
    excitations,
    inhibitions,
    thresholds,
    constants,
    shown,
    n_steps,
    forced,
    stdps,
    rates_inverted,
    gain,
    clip,
    share,
    ALL_EXIST: tl.constexpr,
    THRESHOLDS_LEARN: tl.constexpr,
    N_PRE: tl.constexpr,
    WIDTH: tl.constexpr,
):
    """Take one neuron of an output layer through `n_steps` steps."""
    neuron, module = tl.program_id(0), tl.program_id(1).to(tl.int64)
    row = module * tl.num_programs(0) + neuron
    synapse = tl.arange(0, WIDTH)
    inside = synapse < N_PRE
    at = row * N_PRE + synapse
    excitation, inhibition = tl.load(excitations + at, inside, 0.0), tl.load(inhibitions + at, inside, 0.0)
    most_excitation, most_inhibition = _largest(excitation, ALL_EXIST), _largest(inhibition, ALL_EXIST)
    threshold, constant = tl.load(thresholds + row), tl.load(constants + row)
    by_rate = tl.load(rates_inverted + synapse, inside, 0.0)
    first = module * n_steps
    x = tl.load(shown + first * N_PRE + synapse, inside, 0.0)
    following = tl.load(shown + (first + tl.minimum(1, n_steps - 1)) * N_PRE + synapse, inside, 0.0)
    net = _net_input(excitation, inhibition, x, constant)
    for step in range(n_steps):
        stdp = tl.load(stdps + first + step)
        target = tl.where(tl.load(forced + first + step) == neuron, 0.5, 0.0)
        error = target - _within(net - threshold, 0.0, clip)
        if THRESHOLDS_LEARN:
            sign = (error > 0).to(tl.float32) - (error < 0).to(tl.float32)
            threshold = tl.maximum(threshold - sign * stdp / 5, 0.0)
        change = share * stdp * error * (x * by_rate)
        excitation = _within(excitation + change, _LEAST, most_excitation)
        inhibition = _within(inhibition - change, _LEAST, most_inhibition) * _homeostasis(gain, stdp, net)
        x = following
        following = tl.load(shown + (first + tl.minimum(step + 2, n_steps - 1)) * N_PRE + synapse, inside, 0.0)
        net = _net_input(excitation, inhibition, x, constant)
    tl.store(excitations + at, excitation, inside)
    tl.store(inhibitions + at, inhibition, inside)
    tl.store(thresholds + row, threshold)

"""The compiled loops of `fused`: each takes a block of neurons through the whole training of a layer."""

from __future__ import annotations

import numpy as np

from .layer import LARGEST, NEARLY_NOTHING, SMALLEST, compiled

SPIKE, AMPLITUDE, DECAY = 0, 1, 2  # the rules of thresholds
_LEAST, _MOST = np.float32(SMALLEST), np.float32(LARGEST)

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
def learn_features(  # type: ignore[no-untyped-def]
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
            scale = max(np.float32(1) + gain * stdp[step] * own, np.float32(NEARLY_NOTHING))
            if threshold_rule == SPIKE:
                threshold += itp[step] * (np.float32(fired) - rate)
            elif threshold_rule == AMPLITUDE:
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
def learn_places(  # type: ignore[no-untyped-def]
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
            scale = max(np.float32(1) + gain * stdp[step] * own, np.float32(NEARLY_NOTHING))
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
    learn_features(*layer, order, row, row, row, one, one, SPIKE, False, 0, 0)
    learn_places(*layer, row, order, order, row, one, one, one, False, 0, 0)


_compile()

"""A slow float64 VPRTempo, one readable line per rule, that judges the fast implementation."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Ints = npt.NDArray[np.int64] | Sequence[int]

SMALLEST, LARGEST = 1e-6, 10.0  # of a weight's magnitude
TRAINING_CLIP = 0.9
HOMEOSTASIS_GAIN = 50.0
FORCED_ACTIVITY = 0.5


def feature_rates(n: int) -> Floats:
    """Return the fixed ramp of target rates, (n,), of the public code QVPR/VPRTempo 64154e5."""
    return np.array([0.2 + 0.7 * (i + 1) / n for i in range(n)])


def learning_rates_reference(n_steps: int, total: int, initial: float) -> Floats:
    """Return the rate in force during each step, (n_steps,), as in the public code QVPR/VPRTempo 64154e5."""
    rate, in_force = initial, []
    for t in range(n_steps):
        in_force.append(rate)
        if t % 100 == 0:
            rate = initial * ((total - t) / total) ** 2
    return np.array(in_force)


def learning_rates_v1(epochs: int, steps_per_epoch: int, initial: float) -> Floats:
    """Return the rate in force during each step, (epochs * steps_per_epoch,), as in v1.0.0 a3b07b2."""
    rate, in_force = initial, []
    for _ in range(epochs):
        for t in range(steps_per_epoch):
            in_force.append(rate)  # an epoch's first step still has the rate the last epoch left
            if t % 10 == 0:
                rate = initial * ((steps_per_epoch - t) / steps_per_epoch) ** 2
    return np.array(in_force)


def train_reference_feature(
    weights: Floats,  # (n_post, n_pre), signed
    positive_mask: Bools,  # (n_post, n_pre)
    negative_mask: Bools,  # (n_post, n_pre)
    thresholds: Floats,  # (n_post,)
    rates: Floats,  # (n_post,)
    inputs: Floats,  # (n_images, n_pre)
    order: Ints,  # (n_steps,) image of each step
    total_steps: int,  # T of the annealing
    stdp_rate: float = 0.005,
    itp_rate: float = 0.15,
) -> tuple[Floats, Floats]:
    """Return weights (n_post, n_pre) and thresholds (n_post,), public code QVPR/VPRTempo 64154e5."""
    w, theta = np.array(weights, dtype=np.float64), np.array(thresholds, dtype=np.float64)
    etas = learning_rates_reference(len(order), total_steps, stdp_rate)
    itp_etas = learning_rates_reference(len(order), total_steps, itp_rate)
    for image, eta, itp_eta in zip(order, etas, itp_etas, strict=True):
        x = np.asarray(inputs[image], dtype=np.float64)
        a = w @ x
        y = np.clip(a - theta, 0.0, TRAINING_CLIP)
        both_spike = np.outer(y > 0, x > 0)
        change = eta * (0.5 - y)[:, None]
        w = np.where(positive_mask & both_spike, w + change, w)
        w = np.where(negative_mask & both_spike, w - change, w)
        w = _limit_signed(w, positive_mask, negative_mask)
        theta = np.maximum(theta + itp_eta * (0.0 - rates), 0.0)  # the code's spike state is always 0
        w = np.where(w < 0, w + HOMEOSTASIS_GAIN * eta * a[:, None] * w, w)
    return w, theta


def train_reference_output(
    weights: Floats,  # (n_post, n_pre), signed
    positive_mask: Bools,  # (n_post, n_pre)
    negative_mask: Bools,  # (n_post, n_pre)
    pre_rates: Floats,  # (n_pre,)
    inputs: Floats,  # (n_images, n_pre), clipped feature spikes
    labels: Ints,  # (n_images,) output neuron
    order: Ints,  # (n_steps,) image of each step
    total_steps: int,  # T of the annealing
    stdp_rate: float = 0.005,
) -> Floats:
    """Return weights (n_post, n_pre), trained as in the public code QVPR/VPRTempo 64154e5."""
    w = np.array(weights, dtype=np.float64)
    etas = learning_rates_reference(len(order), total_steps, stdp_rate)
    for image, eta in zip(order, etas, strict=True):
        x = np.asarray(inputs[image], dtype=np.float64)
        a = w @ x
        y = np.clip(a, 0.0, TRAINING_CLIP)  # output thresholds are 0
        target = np.zeros(len(y))
        target[labels[image]] = FORCED_ACTIVITY
        change = eta * np.outer(target - y, x / pre_rates)
        w = np.where(positive_mask | negative_mask, w + change, w)
        w = _limit_signed(w, positive_mask, negative_mask)
        w = np.where(w < 0, w + HOMEOSTASIS_GAIN * eta * a[:, None] * w, w)
    return w


def train_separate_feature(
    excitation: Floats,  # (n_post, n_pre), magnitudes
    inhibition: Floats,  # (n_post, n_pre), magnitudes
    excitation_mask: Bools,  # (n_post, n_pre)
    inhibition_mask: Bools,  # (n_post, n_pre)
    constant: Floats,  # (n_post,)
    thresholds: Floats,  # (n_post,)
    rates: Floats,  # (n_post,)
    inputs: Floats,  # (n_images, n_pre)
    order: Ints,  # (n_steps,) image of each step
    stdp_rates: Floats,  # (n_steps,) in force during each step
    itp_rates: Floats,  # (n_steps,) in force during each step
    heaviside: bool,  # Eq. 5 with spikes (VPRTempo paper) or with amplitudes (v1.0.0 a3b07b2)
) -> tuple[Floats, Floats, Floats]:
    """Return excitation and inhibition (n_post, n_pre), thresholds; VPRTempo paper or v1.0.0 a3b07b2."""
    plus, minus = np.array(excitation, dtype=np.float64), np.array(inhibition, dtype=np.float64)
    theta = np.array(thresholds, dtype=np.float64)
    for image, eta, itp_eta in zip(order, stdp_rates, itp_rates, strict=True):
        x = np.asarray(inputs[image], dtype=np.float64)
        a = plus @ x - minus @ x + constant
        y = np.clip(a - theta, 0.0, TRAINING_CLIP)
        both_spike = np.outer(y > 0, x > 0)
        change = (eta * (0.5 - y))[:, None]
        plus = np.where(excitation_mask & both_spike, plus + change, plus)
        minus = np.where(inhibition_mask & both_spike, minus + change, minus)
        plus, minus = _limit_magnitude(plus), _limit_magnitude(minus)
        activity = (y > 0).astype(np.float64) if heaviside else y
        theta = np.maximum(theta + itp_eta * (activity - rates), 0.0)
        minus = _homeostasis_of_magnitude(minus, eta, a)
    return plus, minus, theta


def train_separate_output(
    excitation: Floats,  # (n_post, n_pre), magnitudes
    inhibition: Floats,  # (n_post, n_pre), magnitudes
    excitation_mask: Bools,  # (n_post, n_pre)
    inhibition_mask: Bools,  # (n_post, n_pre)
    thresholds: Floats,  # (n_post,)
    pre_rates: Floats,  # (n_pre,)
    inputs: Floats,  # (n_images, n_pre), clipped feature spikes
    labels: Ints,  # (n_images,) output neuron
    order: Ints,  # (n_steps,) image of each step
    stdp_rates: Floats,  # (n_steps,) in force during each step
    output_thresholds_learn: bool,  # only v1.0.0 a3b07b2
    share: float = 1.0,  # of the step in each matrix: 1 in v1.0.0, 1/2 where Eq. 6 moves their difference
) -> tuple[Floats, Floats, Floats]:
    """Return excitation and inhibition (n_post, n_pre), thresholds; VPRTempo paper or v1.0.0 a3b07b2."""
    plus, minus = np.array(excitation, dtype=np.float64), np.array(inhibition, dtype=np.float64)
    theta = np.array(thresholds, dtype=np.float64)
    for image, eta in zip(order, stdp_rates, strict=True):
        x = np.asarray(inputs[image], dtype=np.float64)
        a = plus @ x - minus @ x
        y = np.clip(a - theta, 0.0, TRAINING_CLIP)
        target = np.zeros(len(y))
        target[labels[image]] = FORCED_ACTIVITY
        if output_thresholds_learn:
            theta = np.maximum(theta - 2.0 * np.sign(target - y) * eta / 10.0, 0.0)
        change = share * eta * np.outer(target - y, x / pre_rates)
        plus = np.where(excitation_mask, plus + change, plus)
        minus = np.where(inhibition_mask, minus - change, minus)  # the signed weight is -minus
        plus, minus = _limit_magnitude(plus), _limit_magnitude(minus)
        minus = _homeostasis_of_magnitude(minus, eta, a)
    return plus, minus, theta


def _limit_signed(w: Floats, positive_mask: Bools, negative_mask: Bools) -> Floats:
    """Keep sign and size of signed weights (n_post, n_pre), public code QVPR/VPRTempo 64154e5."""
    w = np.where(positive_mask, np.clip(w, SMALLEST, LARGEST), w)
    return np.where(negative_mask, np.clip(w, -LARGEST, -SMALLEST), w)


def _limit_magnitude(w: Floats) -> Floats:
    """Keep sign and size of magnitudes (n_post, n_pre), v1.0.0 a3b07b2."""
    w = np.where(w < 0, SMALLEST, w)
    return np.where(w > LARGEST, LARGEST, w)


def _homeostasis_of_magnitude(minus: Floats, eta: float, a: Floats) -> Floats:
    """Scale inhibition (n_post, n_pre) by net input (n_post,) and undo sign changes, v1.0.0 a3b07b2."""
    minus = minus * (1.0 + HOMEOSTASIS_GAIN * eta * a[:, None])
    return np.where(minus < 0, SMALLEST, minus)

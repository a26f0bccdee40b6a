"""A slow float64 VPRTempo: QVPR/VPRTempo 64154e5 (signed weights), the paper and v1.0.0 a3b07b2 (magnitudes)."""

# Weights and masks are (n_post, n_pre), thresholds and target rates (n_post,), inputs (n_images, n_pre), `order` the
# image and `labels[image]` the output neuron of each step.

import numpy as np

SMALLEST, LARGEST = 1e-6, 10.0  # of a weight's magnitude
TRAINING_CLIP = 0.9
HOMEOSTASIS_GAIN = 50.0
FORCED_ACTIVITY = 0.5


def feature_rates(n):
    """Return the fixed ramp of target rates, (n,)."""
    return 0.2 + 0.7 * np.arange(1, n + 1) / n


def learning_rates_reference(n_steps, total, initial):
    """Return the rate in force during each step, (n_steps,), of the public code: renewed after every 100th."""
    since = np.maximum(np.arange(n_steps) - 1, 0) // 100 * 100
    return np.where(np.arange(n_steps) == 0, initial, initial * ((total - since) / total) ** 2)


def learning_rates_v1(epochs, steps_per_epoch, initial):
    """Return the rate in force during each step, (epochs * steps_per_epoch,), as in v1.0.0 a3b07b2."""
    rate, in_force = initial, []
    for _ in range(epochs):
        for t in range(steps_per_epoch):
            in_force.append(rate)  # an epoch's first step still has the rate the last epoch left
            if t % 10 == 0:
                rate = initial * ((steps_per_epoch - t) / steps_per_epoch) ** 2
    return np.array(in_force)


def train_reference_feature(w, positive, negative, theta, rates, inputs, order, total, stdp_rate=0.005, itp_rate=0.15):
    """Return signed weights and thresholds after training with `total` steps of annealing."""
    etas, itp_etas = (learning_rates_reference(len(order), total, rate) for rate in (stdp_rate, itp_rate))
    for image, eta, itp_eta in zip(order, etas, itp_etas, strict=True):
        x = np.asarray(inputs[image], dtype=np.float64)
        a = w @ x
        y = np.clip(a - theta, 0.0, TRAINING_CLIP)
        both_spike = np.outer(y > 0, x > 0)
        change = eta * (0.5 - y)[:, None]
        w = np.where(positive & both_spike, w + change, w)
        w = np.where(negative & both_spike, w - change, w)
        w = _limit_signed(w, positive, negative)
        theta = np.maximum(theta + itp_eta * (0.0 - rates), 0.0)  # the code's spike state is always 0
        w = np.where(w < 0, w + HOMEOSTASIS_GAIN * eta * a[:, None] * w, w)
    return w, theta


def train_reference_output(w, positive, negative, pre_rates, inputs, labels, order, total, stdp_rate=0.005):
    """Return signed weights; inputs are clipped feature spikes of the target rates `pre_rates`, (n_pre,)."""
    etas = learning_rates_reference(len(order), total, stdp_rate)
    for image, eta in zip(order, etas, strict=True):
        x = np.asarray(inputs[image], dtype=np.float64)
        a = w @ x
        y = np.clip(a, 0.0, TRAINING_CLIP)  # output thresholds are 0
        change = eta * np.outer(_target(y, labels[image]) - y, x / pre_rates)
        w = np.where(positive | negative, w + change, w)
        w = _limit_signed(w, positive, negative)
        w = np.where(w < 0, w + HOMEOSTASIS_GAIN * eta * a[:, None] * w, w)
    return w


def train_separate_feature(
    plus, minus, has_plus, has_minus, constant, theta, rates, inputs, order, stdp_rates, itp_rates, heaviside, divided
):
    """Return excitation, inhibition and thresholds; Eq. 5 counts spikes (`heaviside`) or adds amplitudes (v1.0.0).

    Eq. 2 has its factor 1/f_j where it is `divided`.
    """
    for image, eta, itp_eta in zip(order, stdp_rates, itp_rates, strict=True):
        x = np.asarray(inputs[image], dtype=np.float64)
        a = plus @ x - minus @ x + constant
        y = np.clip(a - theta, 0.0, TRAINING_CLIP)
        both_spike = np.outer(y > 0, x > 0)
        change = (eta * (0.5 - y) / (rates if divided else 1))[:, None]
        plus = _limit_magnitude(np.where(has_plus & both_spike, plus + change, plus))
        minus = _limit_magnitude(np.where(has_minus & both_spike, minus + change, minus))
        activity = (y > 0).astype(np.float64) if heaviside else y
        theta = np.maximum(theta + itp_eta * (activity - rates), 0.0)
        minus = _homeostasis_of_magnitude(minus, eta, a)
    return plus, minus, theta


def train_separate_output(
    plus, minus, has_plus, has_minus, theta, rates, inputs, labels, order, etas, output_thresholds_learn, share=1.0
):
    """Return excitation, inhibition and thresholds; `share` of a step goes into each matrix (1/2: Eq. 6, 1: v1.0.0)."""
    for image, eta in zip(order, etas, strict=True):
        x = np.asarray(inputs[image], dtype=np.float64)
        a = plus @ x - minus @ x
        y = np.clip(a - theta, 0.0, TRAINING_CLIP)
        wanted = _target(y, labels[image]) - y
        if output_thresholds_learn:
            theta = np.maximum(theta - 2.0 * np.sign(wanted) * eta / 10.0, 0.0)
        change = share * eta * np.outer(wanted, x / rates)
        plus = _limit_magnitude(np.where(has_plus, plus + change, plus))
        minus = _limit_magnitude(np.where(has_minus, minus - change, minus))  # the signed weight is -minus
        minus = _homeostasis_of_magnitude(minus, eta, a)
    return plus, minus, theta


def _target(y, label):
    return np.where(np.arange(len(y)) == label, FORCED_ACTIVITY, 0.0)


def _limit_signed(w, positive, negative):
    w = np.where(positive, np.clip(w, SMALLEST, LARGEST), w)
    return np.where(negative, np.clip(w, -LARGEST, -SMALLEST), w)


def _limit_magnitude(w):
    return np.minimum(np.where(w < 0, SMALLEST, w), LARGEST)


def _homeostasis_of_magnitude(minus, eta, a):
    """Scale inhibition by net input (n_post,) and undo sign changes."""
    minus = minus * (1.0 + HOMEOSTASIS_GAIN * eta * a[:, None])
    return np.where(minus < 0, SMALLEST, minus)

"""A slow VPRSNN module in Brian2's order of rules, from the description of QVPR/VPRSNN (Diehl and Cook, 2015) alone."""

from collections import namedtuple

import numpy as np

#: What a module did and has become: whether cells spike, (n_steps, n_cells) each; counts (n_presentations, n_neurons)
#: from the end of one image to the end of the next; potentials (n_steps, n_neurons) after each step, in mV.
Run = namedtuple("Run", "excitatory inhibitory counts potentials weights theta ge gi v_i ge_i")
_LONG_AGO = -(10**9)


def simulate(
    weights,  # (n_inputs, n_neurons)
    delays,  # (n_inputs, n_neurons) steps
    theta,  # (n_neurons,) mV
    images,  # of each presentation: (n_steps, n_inputs) input spikes
    constants,
    learning,
    weight_sum=None,
):
    """Return what a module that was silent for ever does when images are shown, each followed by its rest.

    With a `weight_sum` the weights are normalised before every presentation.
    """
    c, dt = constants, constants.time_step_ms
    n_inputs, n = weights.shape
    w, theta = weights.copy(), theta.copy()
    shown, rest = round(c.presentation_ms / dt), round(c.rest_ms / dt)
    refractory, refractory_i = round(c.excitatory_refractory_ms / dt), round(c.inhibitory_refractory_ms / dt)
    n_steps, longest = len(images) * (shown + rest), int(delays.max())
    emitted = np.zeros((longest + n_steps, n_inputs), np.bool_)
    for number, image in enumerate(images):
        begin = longest + number * (shown + rest)
        emitted[begin : begin + shown] = image

    v, v_i = np.full(n, c.excitatory_rest_mv), np.full(n, c.inhibitory_rest_mv)
    ge, gi, ge_i, post1, post2 = np.zeros((5, n))
    timer, timer_limit = np.full(n, np.inf), 0.1 * c.excitatory_minimum_interval_ms / 1000  # seconds
    last, last_i = np.full(n, _LONG_AGO), np.full(n, _LONG_AGO)
    prees = np.zeros((n_inputs, n))  # a trace at each synapse: its delay decides when it has been reached
    taus = c.pre_trace_tau_ms, c.post_trace_tau_ms, c.slow_post_trace_tau_ms
    pre_decay, post1_decay, post2_decay = np.exp(-dt / np.array(taus))
    excitatory, inhibitory = np.zeros((2, n_steps, n), np.bool_)
    potentials = np.empty((n_steps, n))

    for t in range(n_steps):
        if weight_sum is not None and t % (shown + rest) == 0:
            w *= weight_sum / w.sum(axis=0)

        # State update
        integrates = t - last >= refractory
        dv = ((c.excitatory_rest_mv - v) + ge * (c.excitation_reversal_mv - v)) * dt / c.excitatory_tau_ms
        dv += gi * (c.excitatory_inhibition_reversal_mv - v) * dt / c.excitatory_tau_ms
        v = np.where(integrates, v + dv, v)
        ge = ge - ge * dt / c.excitation_tau_ms
        gi = gi - gi * dt / c.inhibition_tau_ms
        timer = timer + 0.1 * dt / 1000
        if learning:
            theta = theta - theta * dt / c.theta_tau_ms
        integrates_i = t - last_i >= refractory_i
        dv_i = ((c.inhibitory_rest_mv - v_i) + ge_i * (c.excitation_reversal_mv - v_i)) * dt / c.inhibitory_tau_ms
        v_i = np.where(integrates_i, v_i + dv_i, v_i)
        ge_i = ge_i - ge_i * dt / c.excitation_tau_ms
        prees, post1, post2 = prees * pre_decay, post1 * post1_decay, post2 * post2_decay

        # Thresholds
        fires = (v > theta + c.excitatory_threshold_mv) & (timer > timer_limit) & integrates
        fires_i = (v_i > c.inhibitory_threshold_mv) & integrates_i
        excitatory[t], inhibitory[t] = fires, fires_i

        # Synapses, presynaptic spikes
        arrives = emitted[longest + t - delays, np.arange(n_inputs)[:, None]]
        ge = ge + np.where(arrives, w, 0).sum(axis=0)
        prees[arrives] = 1
        if learning:
            w = np.where(arrives, np.clip(w + c.pre_rate * post1, 0, c.weight_max), w)
        ge_i = ge_i + c.excitatory_to_inhibitory_weight * fires
        gi = gi + c.inhibitory_to_excitatory_weight * (fires_i.sum() - fires_i)  # all but the own partner

        # Synapses, postsynaptic spikes
        if learning and fires.any():
            w = np.where(fires, np.clip(w + c.post_rate * prees * post2, 0, c.weight_max), w)
        post1[fires] = post2[fires] = 1

        # Resets
        v[fires] = c.excitatory_reset_mv
        timer[fires] = 0
        if learning:
            theta[fires] += c.theta_plus_mv
        v_i[fires_i] = c.inhibitory_reset_mv
        last[fires] = last_i[fires_i] = t
        potentials[t] = v

    counted = np.concatenate([np.zeros((1, n), np.int64), excitatory.cumsum(axis=0)])
    image_ends = counted[[shown + number * (shown + rest) for number in range(len(images))]]
    counts = np.diff(image_ends, axis=0, prepend=0)
    return Run(excitatory, inhibitory, counts, potentials, w, theta, ge, gi, v_i, ge_i)

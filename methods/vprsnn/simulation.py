"""A module of VPRSNN for one image after the other: exact in time, and compiled.

Between spikes of the excitatory neurons nothing but the input acts on them, and the input of a whole presentation is
known when it begins. So the input of each neuron in each step is summed first, synapse by synapse, and one light
pass a step does the rest. Only a neuron that fired lately has weights that change with its input. Its input is summed
in stretches, each weight as it is by then; should it fire within a stretch, that stretch is summed again.
"""

from __future__ import annotations

import math

import numpy as np

from vprbench.api import compiled

from .arrays import SIDE, STRETCH, TILE


@compiled()
def normalise_weights(weights, total):  # type: ignore[no-untyped-def]
    """Scale the weights of each neuron to the sum `total`, in place; one without weights stays without."""
    for block in range(weights.shape[0]):
        sums = np.zeros(SIDE)
        for i in range(weights.shape[1]):
            for k in range(SIDE):
                sums[k] += weights[block, i, k]
        for k in range(SIDE):
            sums[k] = total / sums[k] if sums[k] > 0 else 1.0
        for i in range(weights.shape[1]):
            for k in range(SIDE):
                weights[block, i, k] *= sums[k]


@compiled()
def sum_arrivals(synapses, train, drive):  # type: ignore[no-untyped-def]
    """Fill `drive` (n_blocks, n_steps, SIDE) with the weights that arrive at each neuron in each step."""
    for block in range(len(drive)):
        weights, delays, arriving = synapses.weights[block], synapses.delays[block], drive[block]
        arriving[:] = 0
        for spike in range(len(train.step)):
            step, source = np.uint64(train.step[spike]), np.uint64(train.source[spike])
            for k in range(SIDE):
                arriving[step + np.uint64(delays[source, k]), k] += weights[source, k]


@compiled()
def find_largest(weights, largest):  # type: ignore[no-untyped-def]
    """Write the largest weight of each neuron."""
    for block in range(weights.shape[0]):
        most = largest[block * SIDE : (block + 1) * SIDE]
        most[:] = 0.0
        for i in range(weights.shape[1]):
            for k in range(SIDE):
                most[k] = weights[block, i, k] if weights[block, i, k] > most[k] else most[k]


@compiled()
def _arrive(steps, sources, delays, first, until, row, change, weights, most):  # type: ignore[no-untyped-def]
    """Sum in `row` the input of a neuron from step `first` to `until` - 1, and change each weight that has acted."""
    begin, length = np.uint64(first), np.uint64(until - first)
    for spike in range(len(steps)):
        source = np.uint64(sources[spike])
        arrives = np.uint64(steps[spike]) + np.uint64(delays[source])
        if arrives - begin < length:  # unsigned: neither earlier nor later
            weight = weights[source]
            row[arrives] += weight
            weight += change[arrives]
            weight = weight if weight > 0.0 else 0.0
            weights[source] = weight if weight < most else most


@compiled()
def _hear(synapses, train, scratch, post, since_spike, physics, j, first, until):  # type: ignore[no-untyped-def]
    """Sum the input of neuron `j` from step `first` to `until` - 1, and change the weights by which it arrives.

    An arrival adds the trace `post` of the neuron's last spike, `since_spike` steps before the presentation, to the
    weight by which it has just acted.
    """
    row, change = scratch.row, scratch.change
    row[first:until] = 0.0
    over = min(max(len(post) - since_spike, first), until)
    change[first:over] = post[since_spike + first : since_spike + over]
    change[over:until] = 0.0
    longest = len(row) - physics.shown
    begin, end = np.searchsorted(train.step, first - longest), np.searchsorted(train.step, until)
    delays = synapses.delays[j // SIDE, :, j % SIDE].copy()
    steps, sources = train.step[begin:end], train.source[begin:end]
    _arrive(steps, sources, delays, first, until, row, change, scratch.running[j], physics.weight_max)


@compiled()
def _sum_stretch(synapses, train, scratch, post, since_spike, physics, j, first, until):  # type: ignore[no-untyped-def]
    """Replace the input that arrives at neuron `j` from step `first` to `until` - 1, each weight as it is by then."""
    scratch.settled[j] = scratch.running[j]
    scratch.since[j] = first
    scratch.until[j] = max(first, until)
    if first < until:
        _hear(synapses, train, scratch, post, since_spike, physics, j, first, until)
        arriving = scratch.drive[j // SIDE, :, j % SIDE]
        for step in range(first, until):
            arriving[step] = scratch.row[step]
        for step in range(first, min(first - first % TILE + TILE, until)):
            scratch.tile[step % TILE, j] = scratch.row[step]


@compiled()
def _lay_out(scratch, first, until):  # type: ignore[no-untyped-def]
    """Lay out the input of steps `first` to `until` - 1 for one pass over all neurons a step."""
    drive, tile = scratch.drive, scratch.tile
    for block in range(len(drive)):
        for step in range(first, until):
            for k in range(SIDE):
                tile[step - first, block * SIDE + k] = drive[block, step, k]


@compiled()
def _learn(synapses, train, scratch, physics, pre, now, j, t, since_spike):  # type: ignore[no-untyped-def]
    """Change the weights of neuron `j`, which fires in step `t`, for the first time since `since_spike` before `now`.

    By post_rate, times the trace `pre` of each synapse's last arrival, times the slow trace of the spike before.
    """
    slow = physics.post_rate * math.exp(-(since_spike + t) * physics.step_ms / physics.slow_post_tau)
    delays, weights = synapses.delays[j // SIDE, :, j % SIDE], scratch.running[j]
    for i in range(len(weights)):
        scratch.last[i] = scratch.passed[i] + delays[i] - now
    longest = len(scratch.row) - physics.shown
    begin, end = np.searchsorted(train.step, t - longest), np.searchsorted(train.step, t + 1)
    for spike in range(begin, end):
        source = train.source[spike]
        if train.step[spike] + delays[source] <= t:
            scratch.last[source] = train.step[spike] + delays[source]
    for i in range(len(weights)):
        since = t - scratch.last[i]
        change = slow * pre[since] if since < len(pre) else 0.0
        weights[i] = min(max(weights[i] + change, 0.0), physics.weight_max)


@compiled()
def _release(state, scratch, physics, step, n_waiting):  # type: ignore[no-untyped-def]
    """Let fire again in `step` those neurons that have waited long enough; returns how many wait on."""
    m = 0
    while m < n_waiting:
        j = scratch.waiting[m]
        if step - state.fired[j] < physics.e_interval:
            m += 1
        else:
            scratch.limits[j] = state.theta[j]
            n_waiting -= 1
            scratch.waiting[m] = scratch.waiting[n_waiting]
    return n_waiting


@compiled()
def _inhibit(state, scratch, physics, now, t, n_inhibiting):  # type: ignore[no-untyped-def]
    """Take inhibitory neurons through step `t`; those that fire act on all excitatory neurons but their partner.

    Returns on how many of them something still acts, and whether any fired.
    """
    fires = False
    m = 0
    while m < n_inhibiting:
        j = scratch.inhibiting[m]
        if now + t - state.fired_i[j] >= physics.i_refractory:
            x = state.v_i[j]
            x += physics.i_gain * ((physics.i_rest - x) + state.ge_i[j] * (physics.excitation - x))
            if x > physics.i_threshold:
                for other in range(len(state.gi)):
                    if other != j:
                        state.gi[other] += physics.i_to_e
                fires = True
                x = physics.i_reset
                state.fired_i[j] = now + t
                if t < physics.shown:
                    state.counts_i[j] += 1
                else:
                    state.late_i[j] += 1
            state.v_i[j] = x
        state.ge_i[j] *= physics.ge_keep
        if state.ge_i[j] < physics.nothing and now + t - state.fired_i[j] >= physics.i_refractory:
            state.ge_i[j] = 0.0
            state.left_i[j] = now + t
            n_inhibiting -= 1
            scratch.inhibiting[m] = scratch.inhibiting[n_inhibiting]
        else:
            m += 1
    return n_inhibiting, fires


@compiled()
def _calm(state, limits, decayed, physics):  # type: ignore[no-untyped-def]
    """Tell whether nothing acts on any neuron, and none reaches its threshold, which will have `decayed`, by itself."""
    if max(state.ge.max(), state.gi.max()) >= physics.nothing or state.ge_i.max() > 0:
        return False
    return max(state.v.max(), physics.e_rest) < limits.min() * decayed + physics.e_threshold


@compiled()
def _relax(state, physics, steps):  # type: ignore[no-untyped-def]
    """Let excitatory neurons on which nothing acts relax for so many steps, as that many Euler steps would."""
    kept = (1 - physics.e_gain) ** steps
    for j in range(len(state.v)):
        state.v[j] = physics.e_rest + (state.v[j] - physics.e_rest) * kept
        state.ge[j] = 0.0
        state.gi[j] = 0.0


@compiled()
def present(synapses, state, train, scratch, physics, traces, now, learning, resting):  # type: ignore[no-untyped-def]
    """Show one image, which begins at step `now`: change the state and, if `learning`, the weights, in place.

    `scratch` holds the input by the weights as they are and, if `learning`, the largest weight of each neuron. Fills
    `state.counts`; spikes of the rest that follows are counted for the next image. If not `resting`, the simulation
    ends with the presentation. Order within a step (the default of Brian2): state update, thresholds, synapses
    (presynaptic, then postsynaptic), resets.
    """
    v, ge, gi, limits, fired = state.v, state.ge, state.gi, scratch.limits, state.fired
    n = len(v)
    end = physics.shown + physics.rest if resting else physics.shown
    longest = len(scratch.row) - physics.shown
    arriving = min(len(scratch.row), end)  # past the presentation for as long as delays last
    state.counts[:] = state.late
    state.counts_i[:] = state.late_i
    state.late[:] = 0
    state.late_i[:] = 0
    scratch.passed[:] = state.heard
    n_passed = 0
    scratch.until[:] = 0
    next_stretch = arriving
    none = np.int64(0)  # of a plain 0 the compiler would make a second copy of each function that takes it
    n_changing = n_waiting = n_inhibiting = none
    for j in range(n):
        limits[j] = state.theta[j]
        if now - fired[j] < physics.e_interval:
            limits[j] = np.inf
            scratch.waiting[n_waiting] = j
            n_waiting += 1
        if learning and (now - fired[j] < len(traces.post) or scratch.largest[j] > physics.weight_max):
            scratch.running[j] = synapses.weights[j // SIDE, :, j % SIDE]
            _sum_stretch(synapses, train, scratch, traces.post, now - fired[j], physics, j, none, arriving)
            scratch.changing[n_changing] = j
            n_changing += 1
        if state.ge_i[j] > 0:
            scratch.inhibiting[n_inhibiting] = j
            n_inhibiting += 1
    inhibited = gi.max() > 0
    decayed = 1.0  # of theta since the presentation began

    t = none
    while t < end:
        if t == next_stretch and t < arriving:
            next_stretch = arriving
            for m in range(n_changing):
                j = scratch.changing[m]
                if scratch.until[j] == t:
                    until = min(t + STRETCH, arriving)
                    _sum_stretch(synapses, train, scratch, traces.post, now - fired[j], physics, j, t, until)
                next_stretch = min(next_stretch, scratch.until[j])
        if t % TILE == 0 and t < arriving:
            _lay_out(scratch, t, min(t + TILE, arriving))
        n_waiting = _release(state, scratch, physics, now + t, n_waiting)

        # Excitatory neurons: state update and what arrives
        if learning:
            decayed *= physics.theta_keep
        hot = 0  # neurons past their thresholds
        if inhibited or t >= arriving:
            for j in range(n):
                x, g, h = v[j], ge[j], gi[j]
                slope = (physics.e_rest - x) + g * (physics.excitation - x) + h * (physics.e_inhibition - x)
                v[j] = x + physics.e_gain * slope
                ge[j] = g * physics.ge_keep
                gi[j] = h * physics.gi_keep
                hot += v[j] > limits[j] * decayed + physics.e_threshold
            if t < arriving:
                drive = scratch.tile[t % TILE]
                for j in range(n):
                    ge[j] += drive[j]
        else:
            drive = scratch.tile[t % TILE]
            for j in range(n):
                x, g = v[j], ge[j]
                v[j] = x + physics.e_gain * ((physics.e_rest - x) + g * (physics.excitation - x))
                ge[j] = g * physics.ge_keep + drive[j]
                hot += v[j] > limits[j] * decayed + physics.e_threshold
        for m in range(n_waiting):
            j = scratch.waiting[m]
            if now + t - fired[j] < physics.e_refractory:
                v[j] = physics.e_reset

        # Their thresholds
        n_firing = 0
        if hot > 0:
            for j in range(n):
                if v[j] > limits[j] * decayed + physics.e_threshold:
                    scratch.firing[n_firing] = j
                    n_firing += 1

        n_inhibiting, inhibits = _inhibit(state, scratch, physics, now, t, n_inhibiting)
        inhibited |= inhibits

        # What follows from the spikes of excitatory neurons
        if learning and n_firing > 0:
            while n_passed < len(train.step) and train.step[n_passed] < t - longest:
                scratch.passed[train.source[n_passed]] = now + train.step[n_passed]
                n_passed += 1
        for m in range(n_firing):
            j = scratch.firing[m]
            if learning:
                if scratch.until[j] == 0:
                    scratch.running[j] = synapses.weights[j // SIDE, :, j % SIDE]
                    scratch.changing[n_changing] = j
                    n_changing += 1
                elif scratch.until[j] > t + 1:
                    scratch.running[j] = scratch.settled[j]
                    first = scratch.since[j]
                    _hear(synapses, train, scratch, traces.post, now - fired[j], physics, j, first, t + 1)
                _learn(synapses, train, scratch, physics, traces.pre, now, j, t, now - fired[j])
                until = min(t + 1 + STRETCH, arriving)
                _sum_stretch(synapses, train, scratch, traces.post, -t, physics, j, t + 1, until)
                next_stretch = min(next_stretch, scratch.until[j])
                state.theta[j] += physics.theta_plus / decayed
            fired[j] = now + t
            limits[j] = np.inf
            scratch.waiting[n_waiting] = j
            n_waiting += 1
            if state.ge_i[j] == 0:
                relaxed = (1 - physics.i_gain) ** (now + t - state.left_i[j])
                state.v_i[j] = physics.i_rest + (state.v_i[j] - physics.i_rest) * relaxed
                scratch.inhibiting[n_inhibiting] = j
                n_inhibiting += 1
            state.ge_i[j] += physics.e_to_i
            v[j] = physics.e_reset
            if t < physics.shown:
                state.counts[j] += 1
            else:
                state.late[j] += 1

        t += 1
        if t % TILE == 0:
            if inhibited and gi.max() < physics.nothing:
                gi[:] = 0.0
                inhibited = False
            if t >= max(arriving, physics.shown) and n_waiting == 0:
                at_end = decayed * physics.theta_keep ** (end - t) if learning else decayed
                if _calm(state, limits, at_end, physics):
                    _relax(state, physics, end - t)
                    decayed = at_end
                    t = end

    for m in range(n_changing):
        j = scratch.changing[m]
        for i in range(synapses.weights.shape[1]):
            synapses.weights[j // SIDE, i, j % SIDE] = scratch.running[j, i]
    for j in range(n):
        state.theta[j] *= decayed
    for spike in range(len(train.step)):
        state.heard[train.source[spike]] = now + train.step[spike]

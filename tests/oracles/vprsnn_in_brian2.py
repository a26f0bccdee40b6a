"""A module of VPRSNN in Brian2, its authors' simulator: `python vprsnn_in_brian2.py GIVEN.npz FOUND.npz`."""

import importlib.machinery
import sys

import numpy as np

MODULE_OF_UNITS = "brian2.units.fundamentalunits"

EXCITATORY = """
dv/dt = ((-65*mV - v) + ge*(0*mV - v) + gi*(-100*mV - v))/(100*ms) : volt (unless refractory)
dge/dt = -ge/(1.0*ms) : 1
dgi/dt = -gi/(0.5*ms) : 1
dtimer/dt = 0.1 : second
"""
INHIBITORY = """
dv/dt = ((-60*mV - v) + ge*(0*mV - v) + gi*(-85*mV - v))/(10*ms) : volt (unless refractory)
dge/dt = -ge/(1.0*ms) : 1
dgi/dt = -gi/(0.5*ms) : 1
"""
THRESHOLD = "v > theta - 20*mV - 52*mV and timer > 5*ms"
RESET = "v = -65*mV; timer = 0*ms"
LEARNT_THETA = "dtheta/dt = -theta/(1e7*ms) : volt"
FROZEN_THETA = "theta : volt (constant)"

TRACES = """
w : 1
post2before : 1
dprees/dt = -prees/(20*ms) : 1 (event-driven)
dpost1/dt = -post1/(20*ms) : 1 (event-driven)
dpost2/dt = -post2/(40*ms) : 1 (event-driven)
"""
AT_ARRIVAL = """
ge_post += w
prees = 1
w = clip(w + 1e-4*post1, 0, 1)
"""
AT_POSTSYNAPTIC_SPIKE = """
post2before = post2
w = clip(w + 0.01*prees*post2before, 0, 1)
post1 = 1
post2 = 1
"""


class Mended(importlib.machinery.SourceFileLoader):
    """Brian2 2.9 names a method of arrays that NumPy 2.4 has no more; its next version does without it."""

    def get_code(self, fullname):
        return self.source_to_code(self.get_data(self.path).replace(b"np.ndarray.ptp", b"np.ptp"), self.path)

    @classmethod
    def find_spec(cls, name, path, target=None):
        if name != MODULE_OF_UNITS:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec is not None:
            spec.loader = cls(name, str(spec.origin))
        return spec


def simulate(given):
    """Return spikes (n_spikes, 2), steps and neurons, and the final state of one module, after 500 ms of silence.

    `weight_sum` is 0 where nothing is to be learnt; `weights` and `delays` (steps) are (n_inputs, n_neurons).
    """
    import brian2
    from brian2 import ms, mV

    brian2.prefs.codegen.target = "numpy"  # needs no compiler
    brian2.defaultclock.dt = 0.1 * ms
    n_inputs, n_neurons = given["weights"].shape
    learning = given["weight_sum"] > 0

    source = brian2.SpikeGeneratorGroup(n_inputs, given["sources"], given["steps"] * 0.1 * ms)
    excitatory = brian2.NeuronGroup(
        n_neurons,
        EXCITATORY + (LEARNT_THETA if learning else FROZEN_THETA),
        threshold=THRESHOLD,
        reset=RESET + ("; theta += 0.05*mV" if learning else ""),
        refractory=5 * ms,
        method="euler",
    )
    inhibitory = brian2.NeuronGroup(
        n_neurons, INHIBITORY, threshold="v > -40*mV", reset="v = -45*mV", refractory=2 * ms, method="euler"
    )
    excitatory.v, inhibitory.v, excitatory.theta = given["v"] * mV, given["v_i"] * mV, given["theta"] * mV

    if learning:
        synapses = brian2.Synapses(source, excitatory, TRACES, on_pre=AT_ARRIVAL, on_post=AT_POSTSYNAPTIC_SPIKE)
    else:
        synapses = brian2.Synapses(source, excitatory, "w : 1", on_pre="ge_post += w")
    synapses.connect()
    pairs = np.array(synapses.i), np.array(synapses.j)
    synapses.w = given["weights"][pairs]
    synapses.pre.delay = given["delays"][pairs] * 0.1 * ms
    to_partner = brian2.Synapses(excitatory, inhibitory, on_pre="ge_post += 10.4")
    to_partner.connect(j="i")
    to_others = brian2.Synapses(inhibitory, excitatory, on_pre="gi_post += 17.0")
    to_others.connect(condition="i != j")

    monitors = {"excitatory": brian2.SpikeMonitor(excitatory), "inhibitory": brian2.SpikeMonitor(inhibitory)}
    network = brian2.Network(source, excitatory, inhibitory, synapses, to_partner, to_others, *monitors.values())
    network.run(500 * ms)
    weights = given["weights"].copy()
    for _ in range(given["presentations"]):
        if learning:
            weights[pairs] = synapses.w
            weights *= given["weight_sum"] / weights.sum(axis=0)
            synapses.w = weights[pairs]
        network.run(500 * ms)
    weights[pairs] = synapses.w

    found = {
        name: np.stack([np.rint(spikes.t / (0.1 * ms)).astype(np.int64), np.array(spikes.i, np.int64)], axis=1)
        for name, spikes in monitors.items()
    }
    return found | {"weights": weights, "theta": excitatory.theta / mV, "v": excitatory.v / mV}


if __name__ == "__main__":
    sys.meta_path.insert(0, Mended)
    np.savez(sys.argv[2], **simulate(dict(np.load(sys.argv[1]))))

"""Graphs of NIR simulated by what their metadata says: in plain NumPy, in snnTorch, and in Brian2's own Python."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import nir
import numpy as np

Simulate = Callable[[nir.NIRGraph, np.ndarray], np.ndarray]  # inputs (n, n_in) -> mean of the steps (n, n_out)


def chain(graph):
    after, name, nodes = dict(graph.edges), "input", []
    while (name := after[name]) != "output":
        nodes.append(graph.nodes[name])
    return nodes


def scores(graph, simulate, inputs):
    """Return the answers of a graph, limited as it says."""
    told = graph.metadata
    return np.clip(simulate(graph, inputs), told.get("output_min", -np.inf), told.get("output_max", np.inf))


def knows_the_neurons(graph, simulate):
    """Tell whether a simulation answers the check vector of the file as the file says."""
    answer = simulate(graph, graph.metadata["check_input"][None])[0]
    return bool(np.abs(answer - graph.metadata["check_output"]).max() <= graph.metadata["check_tolerance"])


def plain(graph, inputs, steps=0, reset="subtract", kept=1):
    """Simulate in double precision; of a potential the share `kept` is left after each step, 1 without a leak."""
    nodes = chain(graph)
    steps = steps or int(graph.metadata["steps"])
    potential, total = 0.0, 0.0
    for _ in range(steps):
        x = inputs.astype(np.float64)
        for node in nodes:
            if isinstance(node, nir.IF):
                potential = kept * potential + node.r * x
                x = (potential > node.v_threshold).astype(np.float64)
                potential = potential - (node.v_threshold if reset == "subtract" else potential) * x
            else:
                x = x @ node.weight.astype(np.float64).T + node.bias
        total = total + x
    return total / steps


def in_snntorch(graph, inputs):
    """Simulate in snnTorch 1.0.0, which imports an IF node with a leak, but a LIF node as it is, reset to 0 apart."""
    import snntorch
    import torch
    from snntorch.import_nir import import_from_nir

    step, tau = 1e-4, 1e12  # of snnTorch, seconds

    def leaky(node):
        leak, taus = np.zeros_like(node.r), np.full_like(node.r, tau, np.float64)
        return nir.LIF(tau=taus, r=node.r * (tau / step), v_leak=leak, v_threshold=node.v_threshold)

    nodes = {name: leaky(node) if isinstance(node, nir.IF) else node for name, node in graph.nodes.items()}
    network = import_from_nir(nir.NIRGraph(nodes, graph.edges))
    for module in network.modules():
        if isinstance(module, snntorch.Leaky):
            module.reset_mechanism = "subtract"
            module.reset_mem()
    steps, x = int(graph.metadata["steps"]), torch.from_numpy(inputs)
    with torch.no_grad():
        return (sum(network(x)[0] for _ in range(steps)) / steps).numpy()


def in_brian2(python, net, folder, graph, inputs):
    """Simulate the file of a graph in Brian2, in the Python that has it."""
    np.save(folder / "inputs.npy", inputs)
    script = Path(__file__).with_name("nir_in_brian2.py")
    subprocess.run([python, script, net, folder / "inputs.npy", folder / "outputs.npy"], check=True)
    return np.load(folder / "outputs.npy")

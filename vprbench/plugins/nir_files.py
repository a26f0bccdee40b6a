"""Trained networks as files of NIR, the intermediate representation that simulators and chips of spikes read.

A reader shows the first node an input for `steps` steps of length 1, takes the mean of the last node's outputs, and
limits it to `output_min` and `output_max` where these are there. An IF node adds its input to a potential that begins
at 0, spikes above the threshold, and subtracts the threshold then. `check_input` is answered by `check_output` within
`check_tolerance`, before any limit. All of these are metadata of the graph.
"""

from __future__ import annotations

from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.images import Images
from vprbench.api.method import Circuit, HasCircuit, Method
from vprbench.errors import BadInput

SUFFIX = ".nir"
STEPS = 64
_EXAMPLES = 32  # references among which the check vector is chosen
_CONTENT = "vprbench"  # the array of the network as safetensors, which other readers ignore
_ROUNDING = 1e-4  # of the largest answer

Array = npt.NDArray[Any]


def require_circuit(path: Path, method: Method) -> None:
    """Raise BadInput, before any training, if a file of NIR cannot hold the network of a method."""
    _require_nir(path)
    if not isinstance(method, HasCircuit):
        raise BadInput(f"save={path}: {type(method).__name__} has no layers that NIR could hold: save .safetensors")
    method.check_circuit()


def format_network(method: Method, references: Images, content: bytes) -> bytes:
    """Return a file of NIR: the graph of a trained method with a check vector, and `content` beside the graph."""
    import h5py
    import nir

    assert isinstance(method, HasCircuit)
    circuit = method.circuit()
    graph = _build_graph(circuit)
    examples = references[np.linspace(0, len(references) - 1, min(_EXAMPLES, len(references))).astype(int)]
    graph.metadata = _make_graph_metadata(graph, circuit, np.asarray(method.encode(examples), np.float32))
    buffer = BytesIO()
    nir.write(buffer, graph)
    with h5py.File(buffer, "r+") as file:
        file[_CONTENT] = np.frombuffer(content, np.uint8)
    return buffer.getvalue()


def read_stored_network(path: Path) -> bytes:
    """Return the `content` of a file that `format_network` made; raises what h5py raises of any other file."""
    _require_nir(path)
    import h5py

    with h5py.File(path) as file:
        array = file[_CONTENT]
        if array.dtype != np.uint8 or array.nbytes > path.stat().st_size:
            raise ValueError(f"it declares {array.nbytes} bytes of {array.dtype}")
        return bytes(array[()].tobytes())


def _require_nir(path: Path) -> None:
    if find_spec("nir") is None:
        raise BadInput(f"{path} needs the package nir, which is not installed: pip install 'vprbench[nir]'")


def _build_graph(circuit: Circuit) -> Any:
    """Return the nodes of a circuit: neurons before the last layer spike, and weights after them hold their clip.

    A neuron of activation a spikes in a / clip of the steps; a bias of half a spike rounds its count to the nearest.
    """
    import nir

    nodes: list[Any] = []
    *hidden, (weights, bias) = circuit.layers
    if circuit.clip is None:
        return nir.NIRGraph.from_list(*(nir.Affine(*layer) for layer in circuit.layers))
    clip, spike_value = np.float32(circuit.clip), np.float32(1)
    for inner_weights, inner_bias in hidden:
        nodes.append(nir.Affine(inner_weights * spike_value, inner_bias + clip / np.float32(2 * STEPS)))
        nodes.append(nir.IF(np.ones_like(inner_bias), np.full_like(inner_bias, clip)))
        spike_value = clip
    return nir.NIRGraph.from_list(*nodes, nir.Affine(weights * spike_value, bias))


def _make_graph_metadata(graph: Any, circuit: Circuit, inputs: Array) -> dict[str, Any]:
    """Return the metadata of a graph; the check vector is the input, of (n, n_in), that tells most about the reset."""
    steps = 1 if circuit.clip is None else STEPS
    answers, reset_to_zero = (_simulate(graph, inputs, steps, subtracts) for subtracts in (True, False))
    differences = np.abs(answers - reset_to_zero).max(1)
    best = int(differences.argmax())
    metadata = {
        "steps": steps,
        "input": "the same in every step",
        "output": "the mean of the steps",
        "check_input": inputs[best],
        "check_output": answers[best],
        "check_tolerance": float(max(differences[best] / 64, _ROUNDING * np.abs(answers[best]).max())),
    }
    if circuit.clip is not None:
        metadata |= {"reset": "the threshold is subtracted", "output_min": 0.0, "output_max": circuit.clip}
    return metadata


def _simulate(graph: Any, inputs: Array, steps: int, subtracts: bool) -> Array:
    """Return the mean of the last node's outputs (n, n_out) over the steps, before any limit, for inputs (n, n_in).

    A spike subtracts the threshold from the potential, or else sets it to 0.
    """
    import nir

    nodes = [node for node in graph.nodes.values() if isinstance(node, (nir.Affine, nir.IF))]
    potentials: dict[int, Array] = {}
    total: Any = np.float32(0)
    for _ in range(steps):
        x = inputs
        for number, node in enumerate(nodes):
            if isinstance(node, nir.Affine):
                x = x @ node.weight.T + node.bias
                continue
            v = potentials.get(number, np.float32(0)) + x
            x = (v > node.v_threshold).astype(np.float32)
            potentials[number] = v - node.v_threshold * x if subtracts else v * (1 - x)
        total = total + x
    return np.asarray(total / np.float32(steps))

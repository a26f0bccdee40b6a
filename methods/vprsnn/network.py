"""A trained network of VPRSNN: the modules' weights and thresholds, and the place that each neuron speaks for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput

from .arrays import Synapses, pack_neurons, unpack_neurons
from .model import Model
from .scoring import Responses, assign_places

Arrays = Mapping[str, npt.NDArray[Any]]

_TYPES = {"sums": np.float32, "shown": np.int64, "places": np.int64, "theta": np.float64, "reactions": np.int64}


@dataclass(frozen=True)
class Network(Responses):
    """Trained modules, one after the other. `reactions` are counted only if a threshold needs them."""

    weights: npt.NDArray[np.float64]  # (n_modules, n_blocks, n_inputs, SIDE), neurons side by side
    theta: npt.NDArray[np.float64]  # (n_modules, n_neurons) mV
    threshold: int = 0  # a neuron that fired for so many references is silenced; 0: none is
    reactions: npt.NDArray[np.int64] | None = None  # (n_modules, n_neurons) references for which a neuron fired

    @property
    def silenced(self) -> npt.NDArray[np.bool_]:
        """Which neurons are hyperactive, (n_modules, n_neurons)."""
        if self.reactions is None or not self.threshold:
            return np.zeros(self.theta.shape, np.bool_)
        return self.reactions >= self.threshold

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays of a stored network; its weights are (n_modules, n_inputs, n_neurons)."""
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        arrays["weights"] = np.stack([unpack_neurons(weights, self.theta.shape[1]) for weights in self.weights])
        arrays["threshold"] = np.array(self.threshold, np.int64)
        return {name: array for name, array in arrays.items() if array is not None}

    @classmethod
    def from_state(cls, state: Arrays, n_inputs: int, n_neurons: int) -> Self:
        """Take the arrays of a stored network; raises BadInput where they are no network of this size."""
        required = {field.name for field in fields(cls)} - {"reactions"}
        if set(state) - {"reactions"} != required:
            raise BadInput(f"the stored network holds {sorted(state)}; wanted {sorted(required)}: train anew")
        modules, labels = state["weights"].shape[:1], state["places"].shape[-1:]
        shapes = {
            "weights": (*modules, n_inputs, n_neurons),
            "sums": (*modules, n_neurons, *labels),
            "threshold": (),
            **dict.fromkeys(("theta", "reactions"), (*modules, n_neurons)),
            **dict.fromkeys(("shown", "places"), (*modules, *labels)),
        }
        for name, array in state.items():
            if array.shape != shapes[name] or not np.isfinite(array).all():
                raise BadInput(
                    f"the stored network's {name} {array.shape} should be finite and of shape {shapes[name]}: give the "
                    "method.height, method.width and method.n_excitatory that it was trained with"
                )
        known = np.sort(state["places"][state["places"] >= 0])
        if not len(known) or not np.array_equal(known, np.arange(len(known))):
            raise BadInput("the stored network's places are not 0, 1, 2 and so on, each in one module: train anew")
        return cls(
            weights=np.stack([pack_neurons(weights.astype(np.float64)) for weights in state["weights"]]),
            threshold=int(state["threshold"]),
            **{name: np.ascontiguousarray(state[name], kind) for name, kind in _TYPES.items() if name in state},
        )

    @classmethod
    def of(cls, modules: Sequence[Arrays]) -> Self:
        """Lay trained modules side by side; the last may have fewer places than the others."""
        most = max(len(module["places"]) for module in modules)

        def stack(name: str, value: int) -> npt.NDArray[Any]:
            """Return an array of all modules, the last axis filled up with a value."""
            arrays = [module[name] for module in modules]
            missing = [[*[(0, 0)] * (array.ndim - 1), (0, most - array.shape[-1])] for array in arrays]
            padded = [np.pad(array, own, constant_values=value) for array, own in zip(arrays, missing, strict=True)]
            return np.stack(padded)

        return cls(
            weights=np.stack([module["weights"] for module in modules]),
            theta=np.stack([module["theta"] for module in modules]),
            sums=stack("sums", 0),
            shown=stack("shown", 0),
            places=stack("places", -1),
        )


@dataclass(frozen=True)
class ReadyNetwork:
    """A trained network with the delays of its input, ready to be asked."""

    model: Model
    network: Network
    synapses: Sequence[Synapses]  # of each module
    labels: npt.NDArray[np.int64]  # (n_modules, n_neurons) the place that each neuron speaks for; -1: none

    @classmethod
    def of(cls, model: Model, network: Network, first: int = 0) -> Self:
        """Draw the delays, new ones or those of the training, of modules whose numbers begin with `first`."""
        new = model.delays_at_query == "new"
        synapses = [
            Synapses(weights, pack_neurons(model.draw_delays(first + number, new)))
            for number, weights in enumerate(network.weights)
        ]
        return cls(model, network, synapses, assign_places(network))


def split_members(state: Arrays, n_members: int) -> list[dict[str, npt.NDArray[Any]]]:
    """Return the arrays of each of `n_members` networks; those of a single one have no number.

    Raises BadInput for arrays of other numbers.
    """
    prefixes = [f"member_{number}." for number in range(n_members)] if n_members > 1 else [""]
    own = [{name.removeprefix(p): array for name, array in state.items() if name.startswith(p)} for p in prefixes]
    if sum(map(len, own)) != len(state) or not all(own):
        raise BadInput(
            f"the stored network holds {sorted(state)}; wanted {n_members} networks, numbered from 0 where several"
        )
    return own

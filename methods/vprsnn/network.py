"""What VPRSNN has learnt: the modules' weights and thresholds, and which place each neuron speaks for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput

from .arrays import Synapses, side_by_side, unpadded
from .model import Model
from .scoring import Responses, hyperactive, labels


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
        if self.reactions is None:
            return np.zeros(self.theta.shape, np.bool_)
        return hyperactive(self.reactions, self.threshold)

    def state(self) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays of a stored network; its weights are (n_modules, n_inputs, n_neurons)."""
        arrays = {field.name: getattr(self, field.name) for field in fields(self)}
        arrays["weights"] = np.stack([unpadded(weights, self.theta.shape[1]) for weights in self.weights])
        arrays["threshold"] = np.array(self.threshold, np.int64)
        return {name: array for name, array in arrays.items() if array is not None}

    @classmethod
    def from_state(cls, state: Mapping[str, npt.NDArray[Any]], n_inputs: int, n_neurons: int) -> Self:
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
        threshold = int(state["threshold"])
        if threshold < 0 or (threshold and "reactions" not in state):
            raise BadInput(
                f"the stored network's threshold {threshold} needs reactions, and to be 0 or more: train anew"
            )
        kept = np.sort(state["places"][state["places"] >= 0])
        if not np.array_equal(kept, np.arange(len(kept))) or not len(kept):
            raise BadInput("the stored network's places are not 0, 1, 2 and so on, each in one module: train anew")
        if (state["sums"].swapaxes(1, 2)[state["places"] < 0] != 0).any() or (state["sums"] < 0).any():
            raise BadInput("the stored network has spikes for places that its modules do not have: train anew")
        return cls(
            weights=np.stack([side_by_side(weights.astype(np.float64)) for weights in state["weights"]]),
            theta=np.ascontiguousarray(state["theta"], np.float64),
            sums=state["sums"].astype(np.float32),
            shown=state["shown"].astype(np.int64),
            places=state["places"].astype(np.int64),
            threshold=threshold,
            reactions=state["reactions"].astype(np.int64) if "reactions" in state else None,
        )

    @classmethod
    def of(cls, modules: Sequence[Mapping[str, npt.NDArray[Any]]]) -> Self:
        """Lay trained modules side by side; the last may have fewer places than the others."""
        most = max(len(module["places"]) for module in modules)

        def stacked(name: str, value: int) -> npt.NDArray[Any]:
            return np.stack([_lengthened(module[name], most, value) for module in modules])

        return cls(
            weights=np.stack([module["weights"] for module in modules]),
            theta=np.stack([module["theta"] for module in modules]),
            sums=stacked("sums", 0),
            shown=stacked("shown", 0),
            places=stacked("places", -1),
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
            Synapses(weights, side_by_side(model.delays(first + number, new)))
            for number, weights in enumerate(network.weights)
        ]
        return cls(model, network, synapses, labels(network))


def _lengthened(array: npt.NDArray[Any], length: int, value: int) -> npt.NDArray[Any]:
    """Return an array whose last axis is filled up to a length with a value."""
    missing = [(0, 0)] * (array.ndim - 1) + [(0, length - array.shape[-1])]
    return np.pad(array, missing, constant_values=value)


def by_member(state: Mapping[str, npt.NDArray[Any]], n_members: int) -> list[dict[str, npt.NDArray[Any]]]:
    """Return the arrays of each of `n_members` networks; those of a single one have no number.

    Raises BadInput for arrays of other numbers.
    """
    wanted = [f"member_{number}." for number in range(n_members)] if n_members > 1 else [""]
    own: list[dict[str, npt.NDArray[Any]]] = [
        {name.removeprefix(prefix): array for name, array in state.items() if name.startswith(prefix)}
        for prefix in wanted
    ]
    if sum(map(len, own)) != len(state) or not all(own) or (n_members == 1 and any("." in name for name in state)):
        raise BadInput(
            f"the stored network holds {sorted(state)}; wanted {n_members} networks, numbered from 0 where several"
        )
    return own

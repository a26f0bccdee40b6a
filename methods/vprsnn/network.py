"""What VPRSNN has learnt: the modules' weights and thresholds, and which place each neuron answers for."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput

from .module import side_by_side, unpadded
from .scoring import Learnt


@dataclass(frozen=True)
class Network:
    """Trained modules, one after the other. `reactions` are counted only where a threshold needs them."""

    weights: npt.NDArray[np.float64]  # (n_modules, n_blocks, n_inputs, SIDE), neurons side by side
    theta: npt.NDArray[np.float64]  # (n_modules, n_neurons) mV
    sums: npt.NDArray[
        np.float32
    ]  # (n_modules, n_neurons, n_labels) spikes for each place in the recorded presentations
    shown: npt.NDArray[np.int64]  # (n_modules, n_labels) those presentations
    places: npt.NDArray[np.int64]  # (n_modules, n_labels); -1: the module has fewer places
    threshold: int = 0  # a neuron that fired for so many references is silenced; 0: none is
    reactions: npt.NDArray[np.int64] | None = None  # (n_modules, n_neurons) references for which a neuron fired

    @property
    def learnt(self) -> Learnt:
        """What the neurons responded to in training."""
        return Learnt(self.sums, self.shown, self.places)

    @property
    def n_places(self) -> int:
        """The number of places, 0 to n_places - 1."""
        return int(self.places.max()) + 1

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
        if not required <= set(state) <= {*required, "reactions"}:
            raise BadInput(f"the stored network holds {sorted(state)}; wanted {sorted(required)}: train anew")
        modules, labels = state["weights"].shape[:1], state["places"].shape[-1:]
        shapes = {
            "weights": (*modules, n_inputs, n_neurons),
            "theta": (*modules, n_neurons),
            "sums": (*modules, n_neurons, *labels),
            "shown": (*modules, *labels),
            "places": (*modules, *labels),
            "threshold": (),
            "reactions": (*modules, n_neurons),
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
            np.stack([side_by_side(weights.astype(np.float64)) for weights in state["weights"]]),
            np.ascontiguousarray(state["theta"], np.float64),
            state["sums"].astype(np.float32),
            state["shown"].astype(np.int64),
            state["places"].astype(np.int64),
            threshold,
            state["reactions"].astype(np.int64) if "reactions" in state else None,
        )

    @classmethod
    def of(cls, modules: Sequence[Mapping[str, npt.NDArray[Any]]]) -> Self:
        """Lay trained modules side by side; the last may have fewer places than the others."""
        most = max(len(module["places"]) for module in modules)

        def padded(name: str, axis: int, value: int) -> npt.NDArray[Any]:
            parts = []
            for module in modules:
                missing = [(0, 0)] * module[name].ndim
                missing[axis] = (0, most - module[name].shape[axis])
                parts.append(np.pad(module[name], missing, constant_values=value))
            return np.stack(parts)

        return cls(
            np.stack([module["weights"] for module in modules]),
            np.stack([module["theta"] for module in modules]),
            padded("sums", 1, 0),
            padded("shown", 0, 0),
            padded("places", 0, -1),
        )


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

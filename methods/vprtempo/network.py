"""A trained VPRTempo network: the weights and thresholds of its modules, from training or from stored arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from vprbench.api import BadInput

from .layer import Layer

_CALIBRATION = ("score_mean", "score_spread")
_FEATURES = ("features", "constant", "feature_thresholds")
_PUBLISHED = ("feature_layer.w.weight", "feature_layer.thr", "output_layer.w.weight", "output_layer.thr")


@dataclass(frozen=True)
class Network:
    """Signed weights, constants and thresholds of both layers; modules lie side by side, places in their order."""

    features: Tensor  # (modules, n_features, n_pixels)
    constant: Tensor  # (modules, n_features)
    feature_thresholds: Tensor  # (modules, n_features)
    outputs: tuple[Tensor, ...]  # per module (n_features, n_places of the module)
    output_thresholds: tuple[Tensor, ...]  # per module (n_places of the module,)
    calibration: tuple[Tensor, Tensor] | None = None  # mean and spread of each place's score over the references

    @property
    def n_places(self) -> int:
        """The places of all modules."""
        return sum(len(thresholds) for thresholds in self.output_thresholds)

    @classmethod
    def of(cls, features: Layer, outputs: Layer, sizes: Sequence[int]) -> Self:
        """Take over trained layers without the padding of modules smaller than others; `sizes` in places."""
        weights = outputs.weights
        return cls(
            features.weights,
            features.constant,
            features.thresholds,
            tuple(weights[module, :size].T.contiguous() for module, size in enumerate(sizes)),
            tuple(outputs.thresholds[module, :size].clone() for module, size in enumerate(sizes)),
        )

    def state(self) -> dict[str, npt.NDArray[np.float32]]:
        """Return the arrays to be stored, the output layers as (n_places, n_features)."""
        arrays: dict[str, Tensor] = {
            "features": self.features,
            "constant": self.constant,
            "feature_thresholds": self.feature_thresholds,
            **{f"outputs_{module}": weights.T for module, weights in enumerate(self.outputs)},
            **{f"output_thresholds_{module}": thresholds for module, thresholds in enumerate(self.output_thresholds)},
        }
        if self.calibration is not None:
            arrays |= zip(_CALIBRATION, self.calibration, strict=True)
        return {name: np.ascontiguousarray(tensor.cpu().numpy()) for name, tensor in arrays.items()}

    @classmethod
    def from_state(cls, state: Mapping[str, npt.NDArray[Any]], device: str) -> Self:
        """Read the arrays of `state`, or the layout of the published checkpoints (QVPR/VPRTempo 64154e5).

        Raises BadInput where an array is missing, too many, or of a shape that does not fit the others.
        """
        if any(name.startswith("model_") for name in state):
            state = _rename_published(state)
        shapes = {name: np.shape(array) for name, array in state.items()}
        modules = sum(name.startswith("outputs_") for name in state)
        sizes = [(*shapes.get(f"outputs_{module}", ()), 0)[0] for module in range(modules)]
        n_features, n_pixels = (*shapes.get("features", ()), 0, 0, 0)[1:3]
        wanted: dict[str, tuple[int, ...]] = {
            "features": (modules, n_features, n_pixels),
            "constant": (modules, n_features),
            "feature_thresholds": (modules, n_features),
        }
        for module, size in enumerate(sizes):
            wanted |= {f"outputs_{module}": (size, n_features), f"output_thresholds_{module}": (size,)}
        if any(name in _CALIBRATION for name in state):
            wanted |= dict.fromkeys(_CALIBRATION, (sum(sizes),))
        if differing := sorted(wanted.keys() ^ shapes.keys()):
            raise BadInput(f"the stored network lacks or has besides {', '.join(differing)}: it is none of VPRTempo")
        for name, shape in wanted.items():
            if shapes[name] != shape or 0 in shape or not np.isfinite(state[name]).all():
                raise BadInput(
                    f"the stored network's {name} {shapes[name]} should be finite and of shape {shape}, without a 0"
                )
        tensors = {name: torch.tensor(array, dtype=torch.float32, device=device) for name, array in state.items()}
        return cls(
            tensors["features"],
            tensors["constant"],
            tensors["feature_thresholds"],
            tuple(tensors[f"outputs_{module}"].T.contiguous() for module in range(modules)),
            tuple(tensors[f"output_thresholds_{module}"] for module in range(modules)),
            (tensors["score_mean"], tensors["score_spread"]) if "score_mean" in tensors else None,
        )

    def followed_by(self, other: Network, in_one_module: bool = False) -> Self:
        """Return the network with the modules of another behind its own, or of one module with the neurons behind."""
        both = (self, other)
        names = () if in_one_module else _FEATURES
        joined: dict[str, Any] = {name: torch.cat([getattr(one, name) for one in both]) for name in names}
        outputs, thresholds = self.outputs + other.outputs, self.output_thresholds + other.output_thresholds
        if in_one_module:
            outputs, thresholds = (torch.cat(outputs, dim=1),), (torch.cat(thresholds),)
        parts = [one.calibration for one in both if one.calibration is not None]
        known = (torch.cat([mean for mean, _ in parts]), torch.cat([spread for _, spread in parts])) if parts else None
        return replace(self, **joined, outputs=outputs, output_thresholds=thresholds, calibration=known)


def take_last_features(members: Sequence[Network]) -> Layer:
    """Return the last feature layer of each network, side by side."""
    signed, constant, thresholds = (torch.cat([getattr(one, name)[-1:] for one in members]) for name in _FEATURES)
    return Layer(signed.clamp(min=0), (-signed).clamp_(min=0), thresholds, constant)


def join_states(members: Sequence[Network]) -> dict[str, npt.NDArray[np.float32]]:
    """Return the arrays of networks to be stored; the arrays of several networks are numbered."""
    if len(members) == 1:
        return members[0].state()
    states = [member.state() for member in members]
    return {f"member_{n}.{name}": array for n, state in enumerate(states) for name, array in state.items()}


def read_members(state: Mapping[str, npt.NDArray[Any]], n_members: int, device: str) -> list[Network]:
    """Read the arrays of `join_states`, or a published checkpoint.

    Raises BadInput for another number of networks, and for arrays that `Network.from_state` refuses.
    """
    prefixes = [f"member_{number}." for number in range(n_members)] if n_members > 1 else [""]
    own = [{name.removeprefix(p): array for name, array in state.items() if name.startswith(p)} for p in prefixes]
    if sum(map(len, own)) != len(state) or not all(own):
        raise BadInput(f"the stored network has other members; wanted {n_members}, numbered from 0 where several")
    return [Network.from_state(arrays, device) for arrays in own]


def _rename_published(state: Mapping[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    """Rename and stack the arrays `model_<module>.<layer>` of a published checkpoint; it has no constant input."""
    modules = len({name.partition(".")[0] for name in state})
    wanted = {f"model_{module}.{name}" for module in range(modules) for name in _PUBLISHED}
    if differing := sorted(wanted ^ set(state)):
        raise BadInput(f"the checkpoint lacks or has besides {', '.join(differing)}: it is none of VPRTempo's authors")
    features, thresholds, outputs, output_thresholds = (
        [state[f"model_{module}.{name}"] for module in range(modules)] for name in _PUBLISHED
    )
    try:
        stacked = {"features": np.stack(features), "feature_thresholds": np.stack([*map(np.ravel, thresholds)])}
    except ValueError as error:
        raise BadInput("the checkpoint's modules have feature layers of different shapes") from error
    found = {**stacked, "constant": np.zeros_like(stacked["feature_thresholds"])}
    for module in range(modules):
        found[f"outputs_{module}"] = outputs[module]
        found[f"output_thresholds_{module}"] = np.ravel(output_thresholds[module])
    return found

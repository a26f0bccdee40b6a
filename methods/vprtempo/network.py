"""A trained VPRTempo network: what its modules have learnt, taken from training or from stored arrays."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from vprbench.api import BadInput

from .layer import Layer

_CALIBRATION = ["score_mean", "score_spread"]
_LEAST_SPREAD = 0.01  # of the mean spread
_PUBLISHED = ("feature_layer.w.weight", "feature_layer.thr", "output_layer.w.weight", "output_layer.thr")


@dataclass(frozen=True)
class Network:
    """Signed weights of both layers and what Eq. 1 adds to them; modules lie side by side, places in their order."""

    features: Tensor  # (modules, n_features, n_pixels)
    constant: Tensor  # (modules, n_features)
    feature_thresholds: Tensor  # (modules, n_features)
    outputs: tuple[Tensor, ...]  # per module (n_features, n_places of the module)
    output_thresholds: tuple[Tensor, ...]  # per module (n_places of the module,)
    score_mean: Tensor | None = None  # (n_places,), over the references, where scores are calibrated
    score_spread: Tensor | None = None

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
        if self.score_mean is not None and self.score_spread is not None:
            arrays |= {"score_mean": self.score_mean, "score_spread": self.score_spread}
        return {name: np.ascontiguousarray(tensor.cpu().numpy()) for name, tensor in arrays.items()}

    @classmethod
    def from_state(cls, state: Mapping[str, npt.NDArray[Any]], device: str) -> Self:
        """Read what `state` returned, or the layout of the published checkpoints (QVPR/VPRTempo 64154e5).

        Raises BadInput where an array is missing, too many, or of a shape that does not fit the others.
        """
        if any(name.startswith("model_") for name in state):
            state = _from_published(state)
        modules = max(sum(name.startswith(part) for name in state) for part in ("outputs_", "output_thresholds_"))
        wanted = ["features", "constant", "feature_thresholds"]
        wanted += [f"{part}_{module}" for part in ("outputs", "output_thresholds") for module in range(modules)]
        if any(name in _CALIBRATION for name in state):
            wanted += _CALIBRATION
        if set(state) != set(wanted) or not modules:
            missing, unexpected = sorted(set(wanted) - set(state)), sorted(set(state) - set(wanted))
            what = f"lacks {missing[0]}" if missing else f"has an unexpected {(unexpected or ['nothing'])[0]}"
            raise BadInput(f"the arrays of a VPRTempo network are wanted, but the stored one {what}")
        shapes = {name: np.shape(array) for name, array in state.items()}
        n_features = shapes["features"][1] if len(shapes["features"]) == 3 else 0
        expected = {
            "features": (modules, n_features, shapes["features"][-1] if shapes["features"] else 0),
            "constant": (modules, n_features),
            "feature_thresholds": (modules, n_features),
        }
        for module in range(modules):
            size = shapes[f"outputs_{module}"][0] if shapes[f"outputs_{module}"] else 0
            expected |= {f"outputs_{module}": (size, n_features), f"output_thresholds_{module}": (size,)}
        n_places = sum(expected[f"output_thresholds_{module}"][0] for module in range(modules))
        expected |= {name: (n_places,) for name in _CALIBRATION if name in state}
        for name, shape in expected.items():
            if shapes[name] != shape or 0 in shape:
                raise BadInput(f"the stored network's {name} has the shape {shapes[name]}; wanted {shape}, without a 0")
            if not np.isfinite(state[name]).all():
                raise BadInput(f"the stored network's {name} holds values that are not finite: its training diverged")
        tensors = {name: torch.tensor(array, dtype=torch.float32, device=device) for name, array in state.items()}
        return cls(
            tensors["features"],
            tensors["constant"],
            tensors["feature_thresholds"],
            tuple(tensors[f"outputs_{module}"].T.contiguous() for module in range(modules)),
            tuple(tensors[f"output_thresholds_{module}"] for module in range(modules)),
            tensors.get("score_mean"),
            tensors.get("score_spread"),
        )

    def calibrated(self, total: Tensor, total_of_squares: Tensor, count: int) -> Self:
        """Return the network with its mean score and spread a place, from sums (n_places,) over `count` references."""
        mean = total / count
        spread = (total_of_squares / count - mean.square()).clamp(min=0).sqrt()
        # A place that hardly answers to any reference must not shout at the first query that it answers to.
        spread = spread.clamp(min=float(_LEAST_SPREAD * spread.mean()) or 1.0)
        device = self.features.device
        return replace(self, score_mean=mean.float().to(device), score_spread=spread.float().to(device))


def _from_published(state: Mapping[str, npt.NDArray[Any]]) -> dict[str, npt.NDArray[Any]]:
    """Rename and stack the arrays `model_<module>.<layer>` of a published checkpoint; it has no constant input."""
    modules = len({number[1] for name in state if (number := re.match(r"model_([0-9]+)\.", name))})
    wanted = {f"model_{module}.{name}" for module in range(modules) for name in _PUBLISHED}
    if differing := sorted(wanted ^ set(state)):
        raise BadInput(
            f"the checkpoint {'lacks' if differing[0] in wanted else 'has an unexpected'} {differing[0]}: "
            f"published ones hold model_0 to model_N with {', '.join(_PUBLISHED)}"
        )
    features, thresholds, outputs, output_thresholds = (
        [state[f"model_{module}.{name}"] for module in range(modules)] for name in _PUBLISHED
    )
    if len({np.shape(weights) for weights in features}) > 1:
        raise BadInput("the checkpoint's modules have feature layers of different shapes; wanted the same in each")
    if len({np.size(row) for row in thresholds}) > 1:
        raise BadInput("the checkpoint's feature_layer.thr has different lengths in its modules; wanted one a feature")
    found = {"features": np.stack(features), "feature_thresholds": np.stack([np.ravel(row) for row in thresholds])}
    found["constant"] = np.zeros_like(found["feature_thresholds"])
    for module in range(modules):
        found |= {
            f"outputs_{module}": outputs[module],
            f"output_thresholds_{module}": np.ravel(output_thresholds[module]),
        }
    return found

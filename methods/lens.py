"""LENS: a small network for frames of event counts, trained as VPRTempo is, asked over many steps in binary spikes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
import torch
from numba import types

from vprbench.api import BadInput, Images, LayerSpikes, Method, NotFittedError, Places, Scores, compiled

from .parts.filters.patches import pixels
from .vprtempo.method import VPRTempo

Floats = npt.NDArray[np.float32]

_FEATURES, _OUTPUTS = "feature_layer.w.weight", "output_layer.w.weight"  # in the published state dictionary


@dataclass
class Lens(Method):
    """Scores a place by how often its output neuron spikes while a frame is shown as random input spikes.

    Every pixel of a frame (7 x 7 or 10 x 10 counts in 8 bits) spikes at each of `steps` with probability count / 255,
    by numbers that `input_seed` draws, the same for every frame. Features and outputs integrate without leak, fire at
    1, as often a step as the membrane holds, and are reset by subtraction, never below -1. Training is that of
    VPRTempo's public code, one module of all places, on gamma-corrected frames.
    Source: Hines, Milford and Fischer, Science Robotics 2025; github.com/AdamDHines/LENS. But here each query finds
    membranes at rest, and output thresholds start at 0, to which they fall within 50 steps there.
    """

    height: int = 7  # pixels
    width: int = 7
    features_per_pixel: float = 2.0
    epochs: int = 128
    stdp_rate: float = 0.01  # that of thresholds is twice as high
    threshold_max: float = 0.75
    rate_min: float = 0.4
    rate_max: float = 0.6
    p_excitatory: float = 0.1
    p_inhibitory: float = 0.5
    steps: int = 1000
    input_seed: int = 50
    seed: int = 0

    query_arguments: ClassVar[frozenset[str]] = frozenset({"steps", "input_seed"})

    # (n_pixels, n_features) and (n_features, n_places)
    _weights: tuple[Floats, Floats] | None = field(default=None, init=False, repr=False, compare=False)

    def fit(self, references: Images, places: Places) -> Self:
        """Train the feature layer, then the output layer, on images in a new random order each epoch."""
        self._weights = None
        n_pixels, n_places = self.height * self.width, int(places.max()) + 1
        own = {one.name: getattr(self, one.name) for one in fields(VPRTempo) if hasattr(self, one.name) and one.init}
        own |= {"features_per_pixel": int(n_pixels * self.features_per_pixel) / max(1, n_pixels)}
        own |= {"rules": "reference", "annealing_interval": 10, "itp_rate": 2 * self.stdp_rate, "max_module": n_places}
        learnt = _Training(**own).fit(references, places).state()
        return self.restore({_FEATURES: learnt["features"][0], _OUTPUTS: learnt["outputs_0"]})

    def encode(self, images: Images) -> Floats:
        """Return the probability that a pixel spikes in a step, (n_images, n_pixels)."""
        return pixels(images, "grey", self.height, self.width, 1).astype(np.float32) / np.float32(255)

    def match(self, codes: Floats) -> Scores:
        """Return the spikes of all output neurons, (n_queries, n_places)."""
        return self._count_spikes(codes)[2]

    def spikes(self, codes: Floats) -> list[LayerSpikes]:
        """Return how often each neuron spikes; raises NotFittedError before `fit`."""
        return [*map(LayerSpikes, ("input", "feature", "output"), self._count_spikes(codes))]

    def _count_spikes(self, codes: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the spikes of inputs, features and outputs, each (n_queries, n_neurons)."""
        features, outputs = self._require_weights()
        if self.steps < 1:
            raise BadInput(f"method.steps={self.steps}: give at least 1")
        codes = np.ascontiguousarray(codes, np.float32).reshape(-1, len(features))
        counts = tuple(np.zeros((len(codes), n), np.float32) for n in (*features.shape, outputs.shape[1]))
        drawn = torch.rand(self.steps, len(features), generator=torch.Generator().manual_seed(self.input_seed))
        _run_neurons(codes, drawn.numpy(), features, outputs, *counts)
        return counts[0], counts[1], counts[2]

    def _require_weights(self) -> tuple[Floats, Floats]:
        if self._weights is None:
            raise NotFittedError("LENS has no network yet: call fit(references, places) first")
        return self._weights

    def state(self) -> Mapping[str, Floats]:
        """Return the weights under their published names, (n_features, n_pixels) and (n_places, n_features)."""
        features, outputs = self._require_weights()
        return {_FEATURES: features.T.copy(), _OUTPUTS: outputs.T.copy()}

    def restore(self, state: Mapping[str, npt.NDArray[Any]]) -> Self:
        """Take the weights of `state` or of a published state dictionary, whose other arrays only training needs.

        Raises BadInput for layers that are missing, not finite, or of sizes that do not fit.
        """
        self._weights = None
        features, outputs = (np.asarray(state.get(name, ())) for name in (_FEATURES, _OUTPUTS))
        n_pixels = self.height * self.width
        fits = features.ndim == outputs.ndim == 2 and outputs.shape[1] == len(features) > 0 < len(outputs)
        if not fits or features.shape[1] != n_pixels or not all(np.isfinite(w).all() for w in (features, outputs)):
            raise BadInput(
                f"the stored network has {_FEATURES} {features.shape} and {_OUTPUTS} {outputs.shape}; wanted finite "
                f"(n_features, method.height x method.width = {n_pixels}) and (n_places, n_features)"
            )
        self._weights = np.array(features.T, np.float32, order="C"), np.array(outputs.T, np.float32, order="C")
        return self


@dataclass
class _Training(VPRTempo):
    """VPRTempo, but for its input: counts as they are, each frame raised to the power that takes its mean to 127.5."""

    def encode(self, images: Images) -> Floats:
        """Return the input spikes, (n_images, n_pixels), 0 to 1; a mean count of 1 or less stays as it is."""
        counts = pixels(images, "grey", self.height, self.width, 1).astype(np.float32)
        mean = counts.mean(1, keepdims=True)
        gamma = np.log(127.5) / np.log(np.where(mean > 1, mean, 127.5))
        inputs: Floats = (counts**gamma).clip(0, 255).astype(np.float32) / np.float32(255)
        return inputs


_ROWS, _READ = types.float32[:, ::1], types.Array(types.float32, 2, "C", readonly=True)


@compiled(_READ, _READ, _READ, _READ, _ROWS, _ROWS, _ROWS)
def _run_neurons(codes, drawn, features, outputs, of_inputs, of_features, of_outputs):  # type: ignore[no-untyped-def]
    """Count the spikes of all layers, each query from rest; only what spikes is added to the next layer's membranes."""
    for query in range(len(codes)):
        hidden, membranes = np.zeros(features.shape[1], np.float32), np.zeros(outputs.shape[1], np.float32)
        for step in range(len(drawn)):
            for pixel in range(len(features)):
                if drawn[step, pixel] < codes[query, pixel]:
                    of_inputs[query, pixel] += 1
                    for feature in range(len(hidden)):
                        hidden[feature] += features[pixel, feature]
            changed = False
            for feature in range(len(hidden)):
                if hidden[feature] >= 1:
                    fired, changed = np.floor(hidden[feature]), True
                    hidden[feature] -= fired
                    of_features[query, feature] += fired
                    for place in range(len(membranes)):
                        membranes[place] += fired * outputs[feature, place]
                elif hidden[feature] < -1:
                    hidden[feature] = -1
            for place in range(len(membranes) if changed else 0):
                if membranes[place] >= 1:
                    fired = np.floor(membranes[place])
                    membranes[place] -= fired
                    of_outputs[query, place] += fired
                elif membranes[place] < -1:
                    membranes[place] = -1

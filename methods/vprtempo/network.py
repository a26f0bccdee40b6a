"""A trained VPRTempo network: the scores of all places for input spikes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from .layer import Layer
from .rules import Rules

_BLOCK = 256  # queries whose feature spikes are held together


@dataclass(frozen=True)
class Network:
    """Signed weights of both layers and what Eq. 1 adds to them; the first axis is the module."""

    features: Tensor  # (modules, n_features, n_pixels)
    constant: Tensor  # (modules, 1, n_features)
    feature_thresholds: Tensor  # (modules, 1, n_features)
    outputs: Tensor  # (modules, n_outputs, n_features)
    output_thresholds: Tensor  # (modules, 1, n_outputs)
    sizes: Sequence[int]  # places of each module
    rules: Rules

    @classmethod
    def of(cls, features: Layer, outputs: Layer, sizes: Sequence[int], rules: Rules) -> Network:
        """Take over trained layers."""
        return cls(
            features.weights,
            features.constant[:, None],
            features.thresholds[:, None],
            outputs.weights,
            outputs.thresholds[:, None],
            sizes,
            rules,
        )

    def scores(self, spikes: Tensor) -> Tensor:
        """Return the state of every place's output neuron, (n_queries, n_places), for spikes (n_queries, n_pixels)."""
        return torch.cat([self._block(block) for block in torch.split(spikes, _BLOCK)])

    def _block(self, spikes: Tensor) -> Tensor:
        x = spikes.expand(len(self.sizes), *spikes.shape)  # (modules, n_queries, n_pixels)
        if self.rules.query_rule == "linear":
            return self._places(torch.bmm(torch.bmm(x, self.features.mT), self.outputs.mT))
        net = torch.baddbmm(self.constant, x, self.features.mT)
        features = (net - self.feature_thresholds).clamp_(0, self.rules.clip)
        above = torch.bmm(features, self.outputs.mT) - self.output_thresholds
        scores = self._places(above.clamp(0, self.rules.clip))
        if self.rules.silent_winner:
            silent = torch.nonzero((scores == 0).all(1))[:, 0]
            scores[silent, above[0, silent, : self.sizes[0]].argmax(1)] = 0.5
        return scores

    def _places(self, outputs: Tensor) -> Tensor:
        """Bring (modules, n_queries, n_outputs) into the order of places, without the padding of small modules."""
        return torch.cat([outputs[module, :, :size] for module, size in enumerate(self.sizes)], dim=1)

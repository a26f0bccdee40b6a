"""VPRTempo asked in 8 bits: trained as ever, quantised afterwards."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from vprbench.api import BadInput

from .ensemble import VPRTempoEnsemble
from .method import VPRTempo
from .quantised import MOST_INPUTS, Int8LinearQuery, Int8SpikingQuery


@dataclass
class VPRTempoInt8(VPRTempo):
    """VPRTempo whose trained network answers in 8 bits: int8 weights, one scale a neuron, and uint8 activations.

    Queries run on the CPU, wherever the network was trained. The quantisation of VPRTempo's public code differs: it
    is learnt during the training and leaves scores on a coarse grid.
    """

    _linear_query: ClassVar[type[Int8LinearQuery]] = Int8LinearQuery
    _spiking_query: ClassVar[type[Int8SpikingQuery]] = Int8SpikingQuery

    def check(self) -> None:
        """Raise BadInput for arguments under which there is no network."""
        n_inputs = self.encoder().n_inputs
        n_features = round(self.features_per_pixel * n_inputs)
        if max(n_features, n_inputs) > MOST_INPUTS:
            raise BadInput(
                f"method.features_per_pixel={self.features_per_pixel} makes {n_features} features, more than 32 bits "
                f"can sum: give at most {MOST_INPUTS}"
            )
        super().check()

    def map_bytes(self) -> int:
        """Return the bytes of the weights, one each, and of a scale and a bias for each neuron."""
        members = self._join_networks()
        if self.choose_rules().query_rule == "linear":
            return members[0].n_places * (members[0].features.shape[2] + 8)
        weights = sum(part.numel() for member in members for part in (member.features, *member.outputs))
        return weights + 8 * sum(member.feature_thresholds.numel() + member.n_places for member in members)


@dataclass
class VPRTempoEnsembleInt8(VPRTempoInt8, VPRTempoEnsemble):
    """The mean score of `members` networks, of the seeds `seed`, `seed` + 1 and so on, each asked in 8 bits."""

    conformance_arguments: ClassVar[Mapping[str, Any]] = VPRTempoEnsemble.conformance_arguments
    stored_as: ClassVar[str] = VPRTempoEnsemble.stored_as

"""VPRTempo asked in 8 bits: trained as ever, quantised afterwards."""

from __future__ import annotations

from dataclasses import dataclass

from .method import VPRTempo
from .quantised import Int8LinearQuery, Int8SpikingQuery
from .query import Query, calibrated, together


@dataclass
class VPRTempoInt8(VPRTempo):
    """VPRTempo whose trained network answers in 8 bits: int8 weights, one scale a neuron, and uint8 activations.

    Queries run on the CPU, wherever the network was trained. The quantisation of VPRTempo's public code differs: it
    is learnt during the training and leaves scores on a coarse grid.
    """

    def _asking(self) -> Query:
        rules = self.chosen_rules()
        if rules.query_rule == "linear":
            return Int8LinearQuery(self._members)
        return together([calibrated(Int8SpikingQuery(member, rules), member) for member in self._members])

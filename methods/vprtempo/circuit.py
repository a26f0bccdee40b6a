"""A trained VPRTempo network as plain layers, for other simulators."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from vprbench.api import BadInput, Circuit

from .network import Network
from .rules import Rules


def check_circuit(n_members: int, rules: Rules) -> None:
    """Raise BadInput for a spiking query that does more than its two layers."""
    more = {
        "method.members": n_members > 1,
        "method.calibrated_scores=true": rules.calibrated_scores,
        "method.silent_winner=true": rules.silent_winner,
    }
    if rules.query_rule == "spiking" and (given := [name for name, is_so in more.items() if is_so]):
        raise BadInput(
            f"{given[0]} does more to the answers of a spiking query than two layers of neurons can: "
            "set method.query_rule=linear, or leave it out"
        )


def circuit_of(members: Sequence[Network], rules: Rules) -> Circuit:
    """Return the layers of networks of the same places, whose features lie side by side; scores are their mean."""
    spiking = rules.query_rule == "spiking"
    features = torch.cat([member.features.flatten(0, 1) for member in members])
    above = torch.cat([(member.constant - member.feature_thresholds).flatten() for member in members])
    outputs, biases = [], []
    for member in members:
        weights = torch.block_diag(*(own.T for own in member.outputs))  # type: ignore[no-untyped-call]
        bias = -torch.cat(member.output_thresholds) * spiking
        if member.calibration is not None:
            mean, spread = member.calibration
            weights, bias = weights / spread[:, None], -mean / spread
        outputs.append(weights / len(members))
        biases.append(bias / len(members))
    layers = (features, above * spiking), (torch.cat(outputs, dim=1), torch.stack(biases).sum(0))
    return Circuit(
        tuple((weights.cpu().numpy(), bias.cpu().numpy()) for weights, bias in layers), rules.clip if spiking else None
    )

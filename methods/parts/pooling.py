"""Poolings over the positions of a feature map that several networks share."""

from __future__ import annotations

import torch
from torch import Tensor, nn

_SMALLEST = 1e-6  # what a feature counts as at least


class GeM(nn.Module):
    """Generalised mean with a learned power `p`: (n, channels, height, width) to (n, channels), in float32.

    Source: Radenovic et al. 2019: (mean over positions of max(x, 1e-6)^p)^(1/p).
    """

    def __init__(self) -> None:
        super().__init__()
        self.p = nn.Parameter(torch.full((1,), 3.0))

    def forward(self, features: Tensor) -> Tensor:
        """Pool each channel over all positions."""
        p = self.p.float()
        return features.float().clamp(min=_SMALLEST).pow(p).mean((2, 3)).pow(1 / p)

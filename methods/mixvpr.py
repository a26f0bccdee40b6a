"""MixVPR: feature maps mixed as wholes, by layers that see all positions of a channel at once, as a method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import ClassVar, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from vprbench.api import BadInput

from .parts.backbones.convolutional import build_resnet, count_channels
from .parts.published import PublishedNetwork, Tensors, read_size

_BACKBONE, _N_STAGES = "resnet50", 3
_SIDE = 320  # pixels
_PIXELS = 16  # along a side of a position
_N_MIXERS = 4
_CHANNELS: Mapping[int, int] = MappingProxyType({4096: 1024, 512: 256, 128: 64})  # by published dimensions


@dataclass(kw_only=True)
class MixVPR(PublishedNetwork):
    """Scores a place by the cosine between the mixed feature maps of query and most similar reference image.

    A mixer is made for a number of positions, one for each 16x16 pixels: the published ones for 320x320 images.
    `n_dimensions` has to be that of the file. Source: Ali-bey et al. 2023 and amaralibey/MixVPR 4043915, whose
    evaluation resizes with Pillow, bilinear (its demo: bicubic).
    """

    n_dimensions: int = 4096
    height: int | None = _SIDE
    width: int | None = _SIDE

    fixed_size: ClassVar[bool] = True

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network of these dimensions; raises BadInput for others than the published ones without a file."""
        if not tensors and self.n_dimensions not in _CHANNELS:
            raise BadInput(
                f"method.n_dimensions={self.n_dimensions}: MixVPR was published with {', '.join(map(str, _CHANNELS))}"
            )
        channels = read_size(tensors, "aggregator.channel_proj.weight", 0, _CHANNELS.get(self.n_dimensions, 1))
        n_positions = read_size(tensors, "aggregator.row_proj.weight", 1, (_SIDE // _PIXELS) ** 2)
        return _MixVPR(n_positions, channels, self.n_dimensions // channels)


class _MixVPR(nn.Module):
    """Images (n, 3, height, width) to descriptors (n, channels * rows), not yet of unit length."""

    def __init__(self, n_positions: int, channels: int, rows: int) -> None:
        super().__init__()
        self.backbone = nn.ModuleDict({"model": build_resnet(_BACKBONE, _N_STAGES, names="words")})
        self.aggregator = _MixerAggregator(n_positions, channels, rows)

    def forward(self, images: Tensor) -> Tensor:
        features = self.backbone["model"](images)
        n_positions = self.aggregator.n_positions
        if features[0, 0].numel() != n_positions:
            down, across = features.shape[-2:]
            side = round(n_positions**0.5) * _PIXELS
            raise BadInput(
                f"images of {images.shape[-1]}x{images.shape[-2]} pixels have {down * across} positions, these weights "
                f"are for {n_positions}: set method.height={side} and method.width={side}"
            )
        return cast(Tensor, self.aggregator(features))


class _MixerAggregator(nn.Module):
    """Feature maps (n, channels, height, width) to descriptors, the rows of each output channel side by side."""

    def __init__(self, n_positions: int, channels: int, rows: int) -> None:
        super().__init__()
        self.n_positions = n_positions
        self.mix = nn.Sequential(*(_Mixer(n_positions) for _ in range(_N_MIXERS)))
        self.channel_proj = nn.Linear(count_channels(_BACKBONE, _N_STAGES), channels)
        self.row_proj = nn.Linear(n_positions, rows)

    def forward(self, features: Tensor) -> Tensor:
        mixed = self.mix(features.flatten(2))  # (n, channels, positions)
        # The published order, channels first and then rows, is a hundred times the work and gives the same: the
        # second projection multiplies the first one's bias by the sum of each row's weights.
        projected = self.channel_proj.weight @ functional.linear(mixed, self.row_proj.weight)
        projected = projected + torch.outer(self.channel_proj.bias, self.row_proj.weight.sum(1)) + self.row_proj.bias
        return projected.flatten(1)


class _Mixer(nn.Module):
    """Two linear layers over the positions of each channel, beside a shortcut."""

    def __init__(self, n_positions: int) -> None:
        super().__init__()
        self.mix = nn.Sequential(
            nn.LayerNorm(n_positions),
            nn.Linear(n_positions, n_positions),
            nn.ReLU(inplace=True),
            nn.Linear(n_positions, n_positions),
        )

    def forward(self, maps: Tensor) -> Tensor:
        return cast(Tensor, maps + self.mix(maps))

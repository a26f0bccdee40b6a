"""Conv-AP: feature maps projected position by position, and averaged in four quarters, as a method."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor, nn

from vprbench.api import Interpolation

from .parts.backbones.convolutional import build_resnet, count_channels
from .parts.published import PublishedNetwork, Tensors

_BACKBONE = "resnet50"
_QUARTERS = (2, 2)  # down and across


@dataclass(kw_only=True)
class ConvAP(PublishedNetwork):
    """Scores a place by the cosine between the averaged features of query and most similar reference image.

    ResNet50's last feature maps pass a 1x1 convolution to `channels`, which has to be the number of the file, and are
    averaged in 2x2 parts: 4 * `channels` numbers, the parts of a channel side by side. The authors evaluate at 320x320.
    Source: Ali-bey et al. 2022 and amaralibey/gsv-cities.
    """

    channels: int = 1024  # of the file: 2048, 1024, 512 or 128
    height: int | None = 320
    width: int | None = 320
    interpolation: Interpolation = "bicubic"

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network of these channels."""
        return _ConvAP(self.channels)


class _ConvAP(nn.Module):
    """Images (n, 3, height, width) to descriptors (n, 4 * channels), not yet of unit length."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.backbone = nn.ModuleDict({"model": build_resnet(_BACKBONE, names="words")})
        self.aggregator = nn.ModuleDict({"channel_pool": nn.Conv2d(count_channels(_BACKBONE), channels, 1)})

    def forward(self, images: Tensor) -> Tensor:
        features = self.aggregator["channel_pool"](self.backbone["model"](images))
        return nn.functional.adaptive_avg_pool2d(features, _QUARTERS).flatten(1)

"""MegaLoc: SALAD with larger clusters and a linear layer, trained on many collections, as a method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor, nn

from vprbench.api import Resize

from .parts.backbones.vit import VisionTransformer
from .parts.published import PublishedNetwork, Tensors, size, under
from .salad import Aggregator, Sizes


@dataclass(kw_only=True)
class MegaLoc(PublishedNetwork):
    """MegaLoc on DINOv2 ViT-B/14: 8448 numbers, a linear layer's view of SALAD's 16640.

    Takes images of any size with more than 64 patches of 14x14 pixels, and by default sees them at the nearest
    multiple of 14 to their own.
    Source: Berton and Masone 2025 and gmberton/MegaLoc (1af071c).
    """

    resize: Resize = "tensor"

    multiple: ClassVar[int] = 14

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network of 8448 dimensions, or in the sizes of a file."""
        sizes = Sizes.of(under(tensors, "aggregator.agg."), cluster_dim=256)
        n_dimensions = size(tensors, "aggregator.linear.weight", 0, 8448)
        return _Network(VisionTransformer.sized(under(tensors, "backbone.")), sizes, n_dimensions)


class _Network(nn.Module):
    """Images (n, 3, height, width) in, descriptors (n, n_dimensions) out, not yet of unit length."""

    def __init__(self, backbone: VisionTransformer, sizes: Sizes, n_dimensions: int) -> None:
        super().__init__()
        self.backbone = backbone
        self.aggregator = _Aggregator(backbone.sizes.dim, sizes, n_dimensions)

    def forward(self, images: Tensor) -> Tensor:
        tokens = self.backbone.tokens(images, normalised=True)
        out: Tensor = self.aggregator(tokens.cls, tokens.patches)
        return out


class _Aggregator(nn.Module):
    """SALAD's unit vectors, joined linearly."""

    def __init__(self, dim: int, sizes: Sizes, n_dimensions: int) -> None:
        super().__init__()
        self.agg = Aggregator(dim, sizes)
        self.linear = nn.Linear(sizes.n_dimensions, n_dimensions)

    def forward(self, cls: Tensor, patches: Tensor) -> Tensor:
        out: Tensor = self.linear(self.agg(cls, patches).to(cls.dtype))
        return out

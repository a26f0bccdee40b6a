"""MegaLoc: SALAD with larger clusters and a linear layer, trained on many collections, as a method."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor, nn

from vprbench.api import NeuralDescriptor, Resize, load_strictly, state_dict

from .dinov2 import transformer
from .parts.backbones.vit import SIZES, VisionTransformer
from .parts.tensor_sizes import n_outputs
from .salad import Aggregator, Sizes

_BACKBONE, _AGGREGATOR, _LINEAR = "backbone.", "aggregator.agg.", "aggregator.linear.weight"


@dataclass(kw_only=True)
class MegaLoc(NeuralDescriptor):
    """MegaLoc on DINOv2 ViT-B/14: 8448 numbers, a linear layer's view of SALAD's 16640.

    Takes images of any size with more than 64 patches of 14x14 pixels, and by default sees them at the nearest
    multiple of 14 to their own.
    Source: Berton and Masone 2025 and gmberton/MegaLoc (1af071c).
    """

    resize: Resize = "tensor"

    multiple: ClassVar[int] = 14

    def load(self, path: Path) -> nn.Module:
        """Return the network with the values of a published file; raises BadInput for any other file.

        Sizes are the file's own.
        """
        tensors = state_dict(path)
        sizes = Sizes.of(tensors, path, _AGGREGATOR)
        n_dimensions = n_outputs(tensors, path, _LINEAR)
        model = transformer(tensors, path, _BACKBONE)
        with torch.device("meta"):
            network = _Network(model, sizes, n_dimensions)
        load_strictly(network, tensors, path)
        return network

    def blank(self) -> nn.Module:
        """Return the network of 8448 dimensions, without the published values."""
        with torch.device("meta"):
            return _Network(VisionTransformer(SIZES["vitb14"]), Sizes(cluster_dim=256), 8448)


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

"""BoQ: learnt queries gather what they look for from an image's local features, as a method."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Self, cast

import torch
from torch import Tensor, nn

from vprbench.api import Interpolation, Resize

from .parts.backbones.convolutional import build_resnet, count_channels
from .parts.backbones.vit import VisionTransformer
from .parts.published import PublishedNetwork, Tensors, read_size, select_prefix

_HEAD = 64  # dimensions of an attention head
_RESNET, _STAGES = "resnet50", 3
_BLOCK = re.compile(r"aggregator\.boqs\.(\d+)\.")

#: Names that another public wrapper gives the parts of the same ResNet, and the names here.
_OTHER_NAMES = {
    "backbone.frozen_layers.0.0.": "backbone.net.0.",
    "backbone.frozen_layers.0.1.": "backbone.net.1.",
    "backbone.frozen_layers.1.": "backbone.net.4.",
    "backbone.frozen_layers.2.": "backbone.net.5.",
    "backbone.unfrozen_layers.0.": "backbone.net.6.",
}


@dataclass(frozen=True)
class Sizes:
    """The sizes of BoQ's aggregator."""

    dim: int  # a multiple of 64: one attention head for each 64
    n_queries: int  # of a block
    n_blocks: int
    n_hidden: int  # between the two linear layers of an encoder
    n_rows: int  # that the outputs of all queries become

    @classmethod
    def of(cls, tensors: Tensors, published_dim: int) -> Self:
        """Read the sizes off a file's tensors; a size that no tensor of BoQ has is the published one."""
        dim = read_size(tensors, "aggregator.proj_c.weight", 0, published_dim)
        return cls(
            dim,
            n_queries=read_size(tensors, "aggregator.boqs.0.queries", 1, 64),
            # Counted, not the highest number: strict loading finds a gap.
            n_blocks=len({found[1] for name in tensors if (found := _BLOCK.match(name))}) or 2,
            n_hidden=read_size(tensors, "aggregator.boqs.0.encoder.linear1.weight", 0, 4 * dim),
            n_rows=read_size(tensors, "aggregator.fc.weight", 0, 32),
        )


@dataclass(kw_only=True)
class BoQ(PublishedNetwork):
    """Bag of queries on DINOv2 ViT-B/14: 12288 numbers.

    The patch tokens, without DINOv2's final norm, pass a 3x3 convolution and two blocks. In each an encoder refines
    them and 64 learnt queries attend to them; the outputs of all queries are joined linearly. The published input is
    322x322 pixels, bicubic and antialiased on floats. A file may hold DINOv2's final norm and mask token or not.
    Source: Ali-bey et al. 2024 and amaralibey/Bag-of-Queries (1a4965e).
    """

    height: int | None = 322
    width: int | None = 322
    resize: Resize = "tensor"
    interpolation: Interpolation = "bicubic"

    multiple: ClassVar[int] = 14

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network of 12288 dimensions, or in the sizes of a file."""
        dino = select_prefix(tensors, "backbone.dino.")
        model = VisionTransformer.sized(dino, norm="norm.weight" in dino)
        return _BoQNetwork("dino", model, model.sizes.dim, Sizes.of(tensors, published_dim=384))


@dataclass(kw_only=True)
class BoQResNet50(BoQ):
    """Bag of queries on ResNet50 without its last stage: 16384 numbers; all else is as in BoQ.

    The published input is 384x384 pixels. The backbone's tensors may bear the names of either public wrapper,
    backbone.net or backbone.frozen_layers and unfrozen_layers.
    """

    height: int | None = 384
    width: int | None = 384

    multiple: ClassVar[int] = 1

    def loaded(self, tensors: Tensors, path: Path) -> nn.Module:
        """Return the network with tensors of either wrapper; raises BadInput if they are another network's."""
        return super().loaded(_rename_wrapper(tensors), path)

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network of 16384 dimensions, or in the sizes of a file."""
        sizes = Sizes.of(tensors, published_dim=512)
        return _BoQNetwork("net", build_resnet(_RESNET, _STAGES), count_channels(_RESNET, _STAGES), sizes)


class _BoQNetwork(nn.Module):
    """Images (n, 3, height, width) in, descriptors (n, dim * n_rows) out, not yet of unit length."""

    def __init__(self, name: str, backbone: nn.Module, n_channels: int, sizes: Sizes) -> None:
        super().__init__()
        self.backbone = nn.ModuleDict({name: backbone})
        self.aggregator = _QueryAggregator(n_channels, sizes)

    def forward(self, images: Tensor) -> Tensor:
        (backbone,) = self.backbone.values()
        if isinstance(backbone, VisionTransformer):
            features = backbone.tokens(images, normalised=False).patches.permute(0, 3, 1, 2)
        else:
            features = backbone(images)
        return cast(Tensor, self.aggregator(features))


class _QueryAggregator(nn.Module):
    """Local features (n, n_channels, rows, columns) in, descriptors (n, dim * n_rows) out."""

    def __init__(self, n_channels: int, sizes: Sizes) -> None:
        super().__init__()
        self.proj_c = nn.Conv2d(n_channels, sizes.dim, 3, padding=1)
        self.norm_input = nn.LayerNorm(sizes.dim)
        self.boqs = nn.ModuleList(_BoQBlock(sizes) for _ in range(sizes.n_blocks))
        self.fc = nn.Linear(sizes.n_blocks * sizes.n_queries, sizes.n_rows)

    def forward(self, features: Tensor) -> Tensor:
        x = self.norm_input(self.proj_c(features).flatten(2).permute(2, 0, 1))  # (positions, n, dim), as torch has it
        found = []
        for block in self.boqs:
            x, gathered = block(x)
            found.append(gathered)
        joined: Tensor = self.fc(torch.cat(found).permute(1, 2, 0))  # (n, dim, n_rows)
        return joined.flatten(1)


class _BoQBlock(nn.Module):
    """Refines the features, and gathers from them what its queries attend to."""

    def __init__(self, sizes: Sizes) -> None:
        super().__init__()
        n_heads = sizes.dim // _HEAD
        self.encoder = nn.TransformerEncoderLayer(sizes.dim, n_heads, sizes.n_hidden, dropout=0.0)
        self.queries = nn.Parameter(torch.zeros(1, sizes.n_queries, sizes.dim))
        self.self_attn = nn.MultiheadAttention(sizes.dim, n_heads)
        self.norm_q = nn.LayerNorm(sizes.dim)
        self.cross_attn = nn.MultiheadAttention(sizes.dim, n_heads)
        self.norm_out = nn.LayerNorm(sizes.dim)

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Return the refined features (positions, n, dim) and what was gathered (n_queries, n, dim)."""
        x = self.encoder(x)
        queries = self.queries.transpose(0, 1)  # (n_queries, 1, dim)
        own, _ = self.self_attn(queries, queries, queries, need_weights=False)  # the same for all images
        queries = self.norm_q(queries + own)
        found, _ = self.cross_attn(queries.expand(-1, x.shape[1], -1), x, x, need_weights=False)
        return x, self.norm_out(found)


def _rename_wrapper(tensors: Tensors) -> dict[str, Tensor]:
    """Return tensors of either wrapper under the names of this network."""
    renamed = {}
    for name, tensor in tensors.items():
        old = next((old for old in _OTHER_NAMES if name.startswith(old)), "")
        renamed[_OTHER_NAMES.get(old, "") + name.removeprefix(old)] = tensor
    return renamed

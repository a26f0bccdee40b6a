"""SALAD: patches are assigned to clusters, or to a dustbin, by optimal transport; MegaLoc: a linear layer behind it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Self, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from vprbench.api import BadInput, Resize

from .parts.backbones.vit import VisionTransformer
from .parts.published import PublishedNetwork, Tensors, read_size, select_prefix

_ITERATIONS = 3  # of Sinkhorn's algorithm


@dataclass(kw_only=True)
class SALAD(PublishedNetwork):
    """SALAD on DINOv2 ViT-B/14: 8448 numbers, 256 of the image's token and 128 of each of 64 clusters.

    Needs more patches than clusters: 126x126 pixels are enough. The authors evaluate at 322x322.
    Source: Izquierdo and Civera 2024 and serizba/salad (e593005).
    """

    height: int | None = 322
    width: int | None = 322

    multiple: ClassVar[int] = 14

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network of 8448 dimensions, or in the sizes of a file."""
        sizes = Sizes.of(select_prefix(tensors, "aggregator."), cluster_dim=128)
        return _SALADNetwork(VisionTransformer.sized(select_prefix(tensors, "backbone.model.")), sizes)


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
        sizes = Sizes.of(select_prefix(tensors, "aggregator.agg."), cluster_dim=256)
        n_dimensions = read_size(tensors, "aggregator.linear.weight", 0, 8448)
        return _MegaLocNetwork(VisionTransformer.sized(select_prefix(tensors, "backbone.")), sizes, n_dimensions)


@dataclass(frozen=True)
class Sizes:
    """The sizes of SALAD's aggregator."""

    n_hidden: int  # between the two layers of each of its networks
    n_clusters: int
    cluster_dim: int
    token_dim: int

    @classmethod
    def of(cls, tensors: Tensors, cluster_dim: int) -> Self:
        """Read the sizes off the aggregator's tensors, or take the published ones, of `cluster_dim`."""
        return cls(
            n_hidden=read_size(tensors, "token_features.0.weight", 0, 512),
            n_clusters=read_size(tensors, "score.3.weight", 0, 64),
            cluster_dim=read_size(tensors, "cluster_features.3.weight", 0, cluster_dim),
            token_dim=read_size(tensors, "token_features.2.weight", 0, 256),
        )

    @property
    def n_dimensions(self) -> int:
        """The numbers of a descriptor."""
        return self.token_dim + self.cluster_dim * self.n_clusters


class Aggregator(nn.Module):
    """Gathers DINOv2's normalised tokens: unit vectors, float32 (n, n_dimensions).

    The parts are the image's token through a small network, of unit length, then for each dimension l and cluster k,
    as l * n_clusters + k, the sum of the patches' features weighted by their assignment, of unit length per cluster.
    Raises BadInput for an image that has no more patches than there are clusters.
    """

    def __init__(self, dim: int, sizes: Sizes) -> None:
        super().__init__()
        self.token_features = nn.Sequential(
            nn.Linear(dim, sizes.n_hidden), nn.ReLU(), nn.Linear(sizes.n_hidden, sizes.token_dim)
        )
        self.cluster_features = _build_patch_network(dim, sizes.n_hidden, sizes.cluster_dim)
        self.score = _build_patch_network(dim, sizes.n_hidden, sizes.n_clusters)
        self.dust_bin = nn.Parameter(torch.ones(()))

    def forward(self, cls: Tensor, patches: Tensor) -> Tensor:
        """Gather the token (n, dim) and the patches (n, rows, columns, dim) of images."""
        grid = patches.permute(0, 3, 1, 2)  # its memory is channels-last already
        # In float32 whatever the network's precision: a sum over hundreds of patches, exponentials and lengths.
        token = functional.normalize(self.token_features(cls).float(), dim=1)
        features = self.cluster_features(grid).flatten(2).float()  # (n, cluster_dim, n_patches)
        scores = self.score(grid).flatten(2).float()  # (n, n_clusters, n_patches)
        gathered = features @ assign_patches(scores, self.dust_bin.float()).transpose(1, 2)
        clusters = functional.normalize(gathered, dim=1).flatten(1)
        return functional.normalize(torch.cat([token, clusters], 1), dim=1)


def assign_patches(scores: Tensor, dust_bin: Tensor) -> Tensor:
    """Return how much of each patch goes to each cluster, (n, n_clusters, n_patches), from scores of that shape.

    The optimal transport, after 3 iterations of Sinkhorn's algorithm on logarithms, that gives every cluster the mass
    of one patch and the dustbin, whose score is the same for all patches, the rest; the dustbin's row is left out.
    Raises BadInput if there is no rest.
    """
    n, n_clusters, n_patches = scores.shape
    if n_patches <= n_clusters:
        raise BadInput(
            f"an image gave {n_patches} patches of 14x14 pixels; the {n_clusters} clusters need more: set "
            f"method.height and method.width to {14 * (math.isqrt(n_clusters) + 1)} pixels each, or more"
        )
    scores = torch.cat([scores, dust_bin.expand(n, 1, n_patches)], 1)
    log_patch = -math.log(n_patches + n_clusters)  # the mass of one patch
    log_rows = scores.new_full((n_clusters + 1, 1), log_patch)
    log_rows[-1] += math.log(n_patches - n_clusters)
    columns = scores.new_zeros(n, 1, n_patches)
    for _ in range(_ITERATIONS):
        rows = log_rows - (scores + columns).logsumexp(2, keepdim=True)
        columns = log_patch - (scores + rows).logsumexp(1, keepdim=True)
    return (scores + rows + columns - log_patch).exp()[:, :-1]


class _SALADNetwork(nn.Module):
    """Images (n, 3, height, width) in, descriptors (n, n_dimensions) out; the parts have their published names."""

    def __init__(self, model: VisionTransformer, sizes: Sizes) -> None:
        super().__init__()
        self.backbone = nn.ModuleDict({"model": model})
        self.aggregator = Aggregator(model.sizes.dim, sizes)

    def forward(self, images: Tensor) -> Tensor:
        tokens = cast(VisionTransformer, self.backbone["model"]).tokens(images, normalised=True)
        return cast(Tensor, self.aggregator(tokens.cls, tokens.patches))


class _MegaLocNetwork(nn.Module):
    """Images (n, 3, height, width) in, descriptors (n, n_dimensions) out, not yet of unit length."""

    def __init__(self, model: VisionTransformer, sizes: Sizes, n_dimensions: int) -> None:
        super().__init__()
        self.backbone = model
        linear = nn.Linear(sizes.n_dimensions, n_dimensions)
        self.aggregator = nn.ModuleDict({"agg": Aggregator(model.sizes.dim, sizes), "linear": linear})

    def forward(self, images: Tensor) -> Tensor:
        tokens = self.backbone.tokens(images, normalised=True)
        gathered = self.aggregator["agg"](tokens.cls, tokens.patches)
        return cast(Tensor, self.aggregator["linear"](gathered.to(images.dtype)))


def _build_patch_network(dim: int, n_hidden: int, n_out: int) -> nn.Sequential:
    """Return two layers for each patch; between them stood the dropout of the training, whose number stays."""
    return nn.Sequential(nn.Conv2d(dim, n_hidden, 1), nn.Identity(), nn.ReLU(), nn.Conv2d(n_hidden, n_out, 1))

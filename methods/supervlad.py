"""SuperVLAD: DINOv2's patches summed in few soft clusters without centroids, as a method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, cast

from torch import Tensor, nn
from torch.nn import functional

from vprbench.api import Resize

from .parts.backbones.vit import VisionTransformer
from .parts.cross_image import CrossImageDescriptor, CrossImageEncoder
from .parts.published import PublishedNetwork, Tensors, read_size, select_prefix

_CLUSTERS, _GHOSTS = 4, 1


@dataclass(kw_only=True)
class SuperVLAD(PublishedNetwork):
    """SuperVLAD on DINOv2 ViT-B/14: 3072 numbers, 768 of each of 4 clusters.

    Unit patches are shared among the clusters and a ghost, which is left out; the sums in each cluster get unit length.
    The authors evaluate at 322x322. Source: Lu et al. 2024 (NeurIPS) and Lu-Feng/SuperVLAD dea6b2e.
    """

    height: int | None = 322
    width: int | None = 322
    resize: Resize = "tensor"

    multiple: ClassVar[int] = 14

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network of 3072 dimensions, or as many as a file has."""
        n_shares = read_size(tensors, "aggregation.conv.weight", 0, _CLUSTERS + _GHOSTS)
        return _SuperVLADNetwork(VisionTransformer.sized(select_prefix(tensors, "backbone.")), n_shares)


@dataclass(kw_only=True)
class SuperVLADCrossImage(SuperVLAD, CrossImageDescriptor):
    """SuperVLAD with the cross-image encoder, in which the clusters of images that are described together meet.

    All else is as in SuperVLAD. The authors evaluate with `images_together=16`.
    """

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network of 3072 dimensions, or as many as a file has, with its encoder."""
        network = cast(_SuperVLADNetwork, super().network(tensors))
        network.encoder = CrossImageEncoder.sized(tensors, network.backbone.sizes.dim, self.images_together)
        return network


class _SuperVLADNetwork(nn.Module):
    """Images (n, 3, height, width) in, float32 descriptors (n, n_clusters * dim) out, not yet of unit length."""

    def __init__(self, model: VisionTransformer, n_shares: int) -> None:
        super().__init__()
        self.backbone = model
        self.aggregation = nn.ModuleDict({"conv": nn.Conv2d(model.sizes.dim, n_shares, 1, bias=False)})
        self.encoder: CrossImageEncoder | None = None

    def forward(self, images: Tensor) -> Tensor:
        tokens = self.backbone.tokens(images, normalised=True)
        patches = functional.normalize(tokens.patches.flatten(1, 2).float(), dim=2)  # (n, n_patches, dim)
        weight = self.aggregation["conv"].get_parameter("weight").float().flatten(1)
        shares = functional.softmax(patches @ weight.T, dim=2)[:, :, :-_GHOSTS]
        clusters = functional.normalize(shares.transpose(1, 2) @ patches, dim=2)  # (n, n_clusters, dim)
        if self.encoder is not None:  # it sees the clusters of a vector of unit length
            vectors = functional.normalize(clusters.flatten(1), dim=1).view_as(clusters)
            clusters = self.encoder(vectors.to(images.dtype)).float()
        return clusters.flatten(1)

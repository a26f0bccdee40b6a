"""SuperVLAD: DINOv2's patches summed in few soft clusters without centroids, as a method."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor, nn
from torch.nn import functional

from vprbench.api import NeuralDescriptor, Resize, load_strictly, state_dict, without_prefix

from .dinov2 import transformer
from .parts.backbones.vit import SIZES, VisionTransformer
from .parts.cross_image import CrossImageDescriptor, CrossImageEncoder
from .parts.tensor_sizes import n_outputs

_CLUSTERS, _GHOSTS = 4, 1
_HIDDEN = 2048  # of the cross-image encoder


@dataclass(kw_only=True)
class SuperVLAD(NeuralDescriptor):
    """SuperVLAD on DINOv2 ViT-B/14: 3072 numbers, 768 of each of 4 clusters.

    Unit patches are shared among the clusters and a ghost, which is left out; the sums in each cluster get unit length.
    The authors evaluate at 322x322. Source: Lu et al. 2024 (NeurIPS) and Lu-Feng/SuperVLAD dea6b2e.
    """

    height: int | None = 322
    width: int | None = 322
    resize: Resize = "tensor"

    multiple: ClassVar[int] = 14

    def load(self, path: Path) -> nn.Module:
        """Return the network with the values of a published file; raises BadInput for any other file."""
        return _loaded(path)

    def blank(self) -> nn.Module:
        """Return the network of 3072 dimensions, without the published values."""
        with torch.device("meta"):
            return _Network(VisionTransformer(SIZES["vitb14"], mask_token=True), _CLUSTERS + _GHOSTS)


@dataclass(kw_only=True)
class SuperVLADCrossImage(CrossImageDescriptor):
    """SuperVLAD with the cross-image encoder, in which the clusters of images that are described together meet.

    All else is as in SuperVLAD. The authors evaluate with `images_together=16`.
    """

    height: int | None = 322
    width: int | None = 322
    resize: Resize = "tensor"

    multiple: ClassVar[int] = 14

    def load(self, path: Path) -> nn.Module:
        """Return the network with the values of a published file; raises BadInput for any other file."""
        return _loaded(path, self.images_together)

    def blank(self) -> nn.Module:
        """Return the network of 3072 dimensions, without the published values."""
        with torch.device("meta"):
            model = VisionTransformer(SIZES["vitb14"], mask_token=True)
            encoder = CrossImageEncoder(model.sizes.dim, _HIDDEN, self.images_together)
            return _Network(model, _CLUSTERS + _GHOSTS, encoder)


def _loaded(path: Path, together: int | None = None) -> nn.Module:
    """Return the network of a file, with an encoder for so many images; None: without one."""
    tensors = without_prefix(state_dict(path, "model_state_dict"), "module.")
    n_shares = n_outputs(tensors, path, "aggregation.conv.weight")
    model = transformer(tensors, path, "backbone.")
    with torch.device("meta"):
        encoder = None
        if together is not None:
            n_hidden = n_outputs(tensors, path, "encoder.layers.0.linear1.weight")
            encoder = CrossImageEncoder(model.sizes.dim, n_hidden, together)
        network = _Network(model, n_shares, encoder)
    load_strictly(network, tensors, path)
    return network


class _Network(nn.Module):
    """Images (n, 3, height, width) in, float32 descriptors (n, n_clusters * dim) out, not yet of unit length."""

    def __init__(self, model: VisionTransformer, n_shares: int, encoder: CrossImageEncoder | None = None) -> None:
        super().__init__()
        self.backbone = model
        self.aggregation = nn.ModuleDict({"conv": nn.Conv2d(model.sizes.dim, n_shares, 1, bias=False)})
        self.encoder = encoder

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

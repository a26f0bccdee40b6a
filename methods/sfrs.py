"""SFRS: NetVLAD's network trained with the similarities of image regions, as a method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, cast

from torch import Tensor, nn

from .netvlad import STRIDE, Network
from .parts.published import PublishedNetwork, Tensors, size

_MEAN = (123.68, 116.779, 103.939)  # RGB levels


@dataclass(kw_only=True)
class SFRS(PublishedNetwork):
    """Scores a place by the cosine between the whitened VLADs of query and most similar reference image.

    VGG16 in 64 clusters, whitened to 4096 dimensions, channels fastest; it sees levels less their mean. The authors
    evaluate at 640x480 (on Tokyo 24/7 with a shorter side of 640).
    Source: Ge et al. 2020 and yxgeee/OpenIBL dea9d41.
    """

    height: int | None = 480
    width: int | None = 640

    smallest_side: ClassVar[int] = STRIDE

    def pixels(self, levels: Tensor) -> Tensor:
        """Return RGB levels 0..255 less their mean."""
        return levels - levels.new_tensor(_MEAN)[:, None, None]

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network of 64 clusters and 4096 dimensions, or in the sizes of a file."""
        return Network(size(tensors, "net_vlad.centroids", 0, 64), size(tensors, "pca_layer.weight", 0, 4096))

    def named(self, network: nn.Module) -> nn.Module:
        """Return the parts of the network under their names in the file."""
        own = cast(Network, network)
        base = nn.ModuleDict({"base": own.encoder})
        return nn.ModuleDict({"base_model": base, "net_vlad": own.pool, "pca_layer": cast(nn.Sequential, own.WPCA)[0]})

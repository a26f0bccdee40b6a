"""SFRS: NetVLAD's network trained with the similarities of image regions, as a method."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, cast

import torch
from torch import Tensor, nn

from vprbench.api import NeuralDescriptor, load_strictly, state_dict

from .netvlad import STRIDE, Network
from .parts.tensor_sizes import n_outputs

_MEAN = (123.68, 116.779, 103.939)  # RGB levels
_CLUSTERS, _COMPONENTS = 64, 4096


@dataclass(kw_only=True)
class SFRS(NeuralDescriptor):
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

    def load(self, path: Path) -> nn.Module:
        """Return the network in the sizes of the file; raises BadInput for a file of anything else."""
        tensors = state_dict(path)
        clusters, components = (n_outputs(tensors, path, name) for name in ("net_vlad.centroids", "pca_layer.weight"))
        with torch.device("meta"):
            network = Network(clusters, components)
        load_strictly(_published(network), tensors, path)
        return network

    def blank(self) -> nn.Module:
        """Return the network of 4096 dimensions, without the published values."""
        return Network(_CLUSTERS, _COMPONENTS)


def _published(network: Network) -> nn.ModuleDict:
    """Return the parts of a network under the names that the published file has for them."""
    whitening = cast(nn.Sequential, network.WPCA)[0]
    base = nn.ModuleDict({"base": network.encoder})
    return nn.ModuleDict({"base_model": base, "net_vlad": network.pool, "pca_layer": whitening})

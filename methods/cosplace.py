"""CosPlace and EigenPlaces: one network, trained in two ways, as methods."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from torch import Tensor, nn
from torch.nn import functional

from vprbench.api import Resize

from .parts.backbones.convolutional import VGG16_CHANNELS, GeM, build_resnet, build_vgg16, count_channels
from .parts.published import PublishedNetwork, Tensors

Backbone = Literal["VGG16", "ResNet18", "ResNet50", "ResNet101", "ResNet152"]


@dataclass(kw_only=True)
class CosPlace(PublishedNetwork):
    """Scores a place by the cosine between the projected GeM of query and most similar reference image.

    Channels are of unit length at each position before they are pooled, and what is pooled goes through one linear
    layer to `n_dimensions`, which has to be that of the file. Images keep their size unless `height` and `width` are
    given. Source: Berton et al. 2022 and gmberton/CosPlace 33ce8d0.
    """

    backbone: Backbone = "ResNet50"
    n_dimensions: int = 2048
    resize: Resize = "tensor"

    @property
    def smallest_side(self) -> int:  # type: ignore[override]  # here it depends on an argument
        """The pixels under which nothing is left to pool: VGG16 halves four times, a ResNet rounds up."""
        return 16 if self.backbone == "VGG16" else 1

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network of this backbone and these dimensions."""
        return _CosPlace(self.backbone, self.n_dimensions)


@dataclass(kw_only=True)
class EigenPlaces(CosPlace):
    """CosPlace's network trained for robustness to viewpoint: Berton et al. 2023, gmberton/EigenPlaces a2969f7."""


class _CosPlace(nn.Module):
    """Images (n, 3, height, width) to descriptors (n, n_dimensions), not yet of unit length."""

    def __init__(self, backbone: Backbone, n_dimensions: int) -> None:
        super().__init__()
        if backbone == "VGG16":
            self.backbone, n_inputs = build_vgg16(last_pool=False), VGG16_CHANNELS
        else:
            self.backbone, n_inputs = build_resnet(backbone.lower()), count_channels(backbone.lower())
        # Under these numbers the published files know them.
        self.aggregation = nn.ModuleDict({"1": GeM(), "3": nn.Linear(n_inputs, n_dimensions)})

    def forward(self, images: Tensor) -> Tensor:
        features = functional.normalize(self.backbone(images).float(), dim=1)
        project = self.aggregation["3"]
        descriptors: Tensor = project(self.aggregation["1"](features).to(images.dtype))
        return descriptors

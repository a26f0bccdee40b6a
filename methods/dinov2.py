"""DINOv2: the token of the whole image, or its patch tokens pooled, as a global descriptor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Literal, cast

from torch import Tensor, nn

from .parts.backbones.vit import VisionTransformer
from .parts.published import PublishedNetwork, Tensors

Backbone = Literal["vits14", "vitb14", "vitl14", "vitg14"]
Pooling = Literal["cls", "mean", "gem"]

_POWER = 3.0  # of the generalised mean
_EPSILON = 1e-6


@dataclass(kw_only=True)
class DINOv2(PublishedNetwork):
    """DINOv2 as it was published, not trained for places: 384 (vits14), 768, 1024 or 1536 (vitg14) numbers.

    After the final norm, `cls` takes the token of the whole image; `mean` and `gem` pool the patch tokens, the latter
    by the generalised mean of power 3 over values clamped at 1e-6. `backbone` names the published file; sizes are the
    file's own. The input of 322x322 pixels and both poolings are this project's choice.
    Source: Oquab et al. 2024 and facebookresearch/dinov2 (b8931f7).
    """

    backbone: Backbone = "vitb14"
    pooling: Pooling = "cls"
    height: int | None = 322
    width: int | None = 322

    multiple: ClassVar[int] = 14

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network in the sizes of `backbone`, or of a file."""
        return _DINOv2Network(VisionTransformer.sized(tensors, self.backbone), self.pooling)

    def name_parts(self, network: nn.Module) -> nn.Module:
        """Return the transformer alone."""
        return cast(_DINOv2Network, network).model


class _DINOv2Network(nn.Module):
    """Images (n, 3, height, width) in, descriptors (n, dim) out, not yet of unit length."""

    def __init__(self, model: VisionTransformer, pooling: Pooling) -> None:
        super().__init__()
        self.model = model
        self.pooling = pooling

    def forward(self, images: Tensor) -> Tensor:
        tokens = self.model.tokens(images, normalised=True)
        if self.pooling == "cls":
            return tokens.cls
        patches = tokens.patches.flatten(1, 2).float()
        if self.pooling == "mean":
            return patches.mean(1)
        return patches.clamp(min=_EPSILON).pow(_POWER).mean(1).pow(1 / _POWER)

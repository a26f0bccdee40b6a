"""CricaVPR: an adapted DINOv2 pooled in regions, which attend to the regions of other images, as a method."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise, product
from typing import ClassVar, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from vprbench.api import BadInput, Resize

from .parts.backbones.convolutional import GeM
from .parts.backbones.vit import VisionTransformer
from .parts.cross_image import CrossImageDescriptor, CrossImageEncoder
from .parts.published import Tensors, select_prefix

_SIDE = 224  # pixels, of 16 patches
_CUTS = ((0, 16), (0, 8, 16), (0, 5, 11, 16))  # patches, of the three levels of the pyramid; the first is the token's
_ADAPTED = 0.2  # of what an adapter gives
_EPSILON = 1e-3  # of the adapters' batch norms


@dataclass(kw_only=True)
class CricaVPR(CrossImageDescriptor):
    """CricaVPR on DINOv2 ViT-B/14 with adapters, at 224x224 pixels: 10752 numbers, 768 of each of 14 parts.

    The parts are the token of the image, and the GeM of the patches in 2x2 and 3x3 regions. The authors evaluate with
    `images_together=16`, 8 on Pittsburgh; their numbers belong to that. Images are resized without antialiasing, as the
    version of torchvision that they name does it, but for the rounding of levels.
    Source: Lu et al. 2024 and Lu-Feng/CricaVPR 2387aab.
    """

    height: int | None = _SIDE
    width: int | None = _SIDE
    resize: Resize = "opencv"

    multiple: ClassVar[int] = 14
    fixed_size: ClassVar[bool] = True

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network of 10752 dimensions, or as many as a file has."""
        model = VisionTransformer.sized(select_prefix(tensors, "backbone."))
        return _CricaVPRNetwork(model, CrossImageEncoder.sized(tensors, model.sizes.dim, self.images_together))


class _CricaVPRNetwork(nn.Module):
    """Images (n, 3, 224, 224) in, descriptors (n, 14 * dim) out, not yet of unit length."""

    def __init__(self, model: VisionTransformer, encoder: CrossImageEncoder) -> None:
        super().__init__()
        self.backbone = _add_adapters(model)
        self.aggregation = nn.ModuleDict({"1": GeM()})
        self.encoder = encoder

    def forward(self, images: Tensor) -> Tensor:
        height, width = images.shape[-2:]
        if (height, width) != (_SIDE, _SIDE):
            raise BadInput(
                f"images of {width}x{height} pixels: CricaVPR's regions are those of {_SIDE}x{_SIDE}; "
                f"set method.height={_SIDE} and method.width={_SIDE}"
            )
        tokens = self.backbone.tokens(images, normalised=True)
        patches = functional.normalize(tokens.patches.float(), dim=3).permute(0, 3, 1, 2)
        pool = self.aggregation["1"]
        parts = [tokens.cls.float()]
        for cuts in _CUTS[1:]:
            for (top, bottom), (left, right) in product(pairwise(cuts), repeat=2):
                parts.append(pool(patches[:, :, top:bottom, left:right]))
        return cast(Tensor, self.encoder(torch.stack(parts, 1).to(images.dtype)).flatten(1))


def _add_adapters(model: VisionTransformer) -> VisionTransformer:
    """Put an adapter beside the MLP of every block: its output for the MLP's input is added to the MLP's."""

    def attach(block: nn.Module) -> None:
        block.adapter = adapter = _Adapter(model.sizes.dim)
        mlp = cast(nn.Module, block.mlp)
        mlp.register_forward_hook(lambda _, inputs, output: output + _ADAPTED * adapter(inputs[0]))

    for block in model.blocks:
        attach(block)
    return model


class _Adapter(nn.Module):
    """Tokens (n, 1 + side^2, dim) through half as many dimensions, in which patches see their surroundings."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        inner = dim // 2
        self.D_fc1 = nn.Linear(dim, inner)
        self.branch1 = _Convolution(inner, inner // 2, 1)
        self.branch2 = nn.Sequential(_Convolution(inner, inner // 16, 1), _Convolution(inner // 16, inner // 4, 3))
        self.branch3 = nn.Sequential(_Convolution(inner, inner // 16, 1), _Convolution(inner // 16, inner // 4, 5))
        self.D_fc2 = nn.Linear(inner, dim)
        self.eval()

    def forward(self, tokens: Tensor) -> Tensor:
        inner = functional.relu(self.D_fc1(tokens))
        cls, patches = inner[:, :1], inner[:, 1:]
        side = math.isqrt(patches.shape[1])
        grid = patches.transpose(1, 2).reshape(len(tokens), -1, side, side)
        seen = torch.cat([branch(grid) for branch in (self.branch1, self.branch2, self.branch3)], 1)
        return cast(Tensor, self.D_fc2(torch.cat([2 * cls, patches + seen.flatten(2).transpose(1, 2)], 1)))


class _Convolution(nn.Module):
    """A convolution that keeps the size, a batch norm and a ReLU."""

    def __init__(self, n_inputs: int, n_outputs: int, side: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(n_inputs, n_outputs, side, padding=side // 2)
        self.bn = nn.BatchNorm2d(n_outputs, eps=_EPSILON)

    def forward(self, x: Tensor) -> Tensor:
        return functional.relu(self.bn(self.conv(x)))

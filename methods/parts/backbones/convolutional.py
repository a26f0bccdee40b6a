"""Convolutional backbones, ResNet, ResNeXt and VGG16, under the names that published weights have, and GeM."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import torch
from torch import Tensor, nn

N_STAGES = 4

VGG16_CHANNELS = 512

_VGG16_GROUPS = ((64, 2), (128, 2), (256, 3), (512, 3), (512, 3))  # channels, convolutions; a pool ends each group
_SMALLEST_FEATURE = 1e-6  # the generalised mean counts smaller ones as this

_WORDS = ("conv1", "bn1", "relu", "maxpool", "layer1", "layer2", "layer3", "layer4")


@dataclass(frozen=True)
class _Kind:
    n_blocks: tuple[int, int, int, int]  # of each stage
    bottleneck: bool
    n_groups: int = 1
    group_width: int = 64  # channels of a group in the first stage


_KINDS: Mapping[str, _Kind] = MappingProxyType(
    {
        "resnet18": _Kind((2, 2, 2, 2), bottleneck=False),
        "resnet50": _Kind((3, 4, 6, 3), bottleneck=True),
        "resnet101": _Kind((3, 4, 23, 3), bottleneck=True),
        "resnet152": _Kind((3, 8, 36, 3), bottleneck=True),
        "resnext101_32x8d": _Kind((3, 4, 23, 3), bottleneck=True, n_groups=32, group_width=8),
    }
)


def build_resnet(name: str, n_stages: int = N_STAGES, names: Literal["numbers", "words"] = "numbers") -> nn.Sequential:
    """Return a ResNet without its pooling and classifier, in evaluation mode and without gradients.

    Images (n, 3, height, width) become (n, n_channels, height / 2^(n_stages + 1), width / 2^(n_stages + 1)), rounded
    up. The children are called "0" to "7" or conv1, bn1, relu, maxpool, layer1 to layer4; stages that
    are left out have none.
    Source: He et al. 2016 with the stride on the 3x3 convolution (v1.5), Xie et al. 2017 for ResNeXt; torchvision's
    names.
    """
    kind = _KINDS[name]
    layers: list[nn.Module] = [
        nn.Conv2d(3, 64, 7, stride=2, padding=3, bias=False),
        nn.BatchNorm2d(64),
        nn.ReLU(inplace=True),
        nn.MaxPool2d(3, stride=2, padding=1),
    ]
    n_inputs = 64
    for stage in range(n_stages):
        layers.append(_build_stage(kind, stage, n_inputs))
        n_inputs = _count_outputs(kind, stage)
    keys = _WORDS if names == "words" else tuple(str(number) for number in range(len(_WORDS)))
    # The stages that are left out leave keys over.
    return nn.Sequential(OrderedDict(zip(keys, layers, strict=False))).eval().requires_grad_(False)


def count_channels(name: str, n_stages: int = N_STAGES) -> int:
    """Return how many channels `build_resnet(name, n_stages)` puts out."""
    return _count_outputs(_KINDS[name], n_stages - 1)


def build_vgg16(*, last_pool: bool = True) -> nn.Sequential:
    """Return VGG16's `features`, in evaluation mode and without gradients.

    The keys are "0.weight", "0.bias", "2.weight" and so on: every convolution, ReLU and pool has a number. Images
    (n, 3, height, width) become (n, 512, height // 32, width // 32). Without the `last_pool` and the ReLU before it
    they become (n, 512, height // 16, width // 16).
    Source: Simonyan and Zisserman 2015, configuration D, in torchvision's numbering.
    """
    layers: list[nn.Module] = []
    n_inputs = 3
    for n_channels, n_convolutions in _VGG16_GROUPS:
        for _ in range(n_convolutions):
            layers += [nn.Conv2d(n_inputs, n_channels, 3, padding=1), nn.ReLU(inplace=True)]
            n_inputs = n_channels
        layers.append(nn.MaxPool2d(2))
    return nn.Sequential(*layers[: None if last_pool else -2]).eval().requires_grad_(False)


class GeM(nn.Module):
    """Generalised mean with a learned power `p`: (n, channels, height, width) to (n, channels), in float32.

    Source: Radenovic et al. 2019: (mean over positions of max(x, 1e-6)^p)^(1/p).
    """

    def __init__(self) -> None:
        super().__init__()
        self.p = nn.Parameter(torch.full((1,), 3.0))

    def forward(self, features: Tensor) -> Tensor:
        """Pool each channel over all positions."""
        p = self.p.float()
        return features.float().clamp(min=_SMALLEST_FEATURE).pow(p).mean((2, 3)).pow(1 / p)


class _Block(nn.Module):
    """Convolutions, each with a batch norm, and a ReLU after all but the last, beside a shortcut."""

    def __init__(self, n_inputs: int, stride: int, *convolutions: nn.Conv2d) -> None:
        super().__init__()
        self.n_convolutions = len(convolutions)
        for number, convolution in enumerate(convolutions, 1):
            self.add_module(f"conv{number}", convolution)
            self.add_module(f"bn{number}", nn.BatchNorm2d(convolution.out_channels))
        self.downsample = _build_shortcut(n_inputs, convolutions[-1].out_channels, stride)

    def forward(self, x: Tensor) -> Tensor:
        out = x
        for number in range(1, self.n_convolutions + 1):
            out = out.relu_() if number > 1 else out
            out = self.get_submodule(f"bn{number}")(self.get_submodule(f"conv{number}")(out))
        out += x if self.downsample is None else self.downsample(x)
        return out.relu_()


def _count_outputs(kind: _Kind, stage: int) -> int:
    """Return the channels after a stage; the first stage is 0."""
    return (256 if kind.bottleneck else 64) << stage


def _build_stage(kind: _Kind, stage: int, n_inputs: int) -> nn.Sequential:
    """Return the blocks of a stage; all but the first stage halve the image in their first block."""
    n_outputs = _count_outputs(kind, stage)
    blocks: list[nn.Module] = []
    for number in range(kind.n_blocks[stage]):
        stride = 2 if stage > 0 and number == 0 else 1
        if kind.bottleneck:
            width = kind.n_groups * kind.group_width << stage
            convolutions = [
                _build_convolution(n_inputs, width, 1),
                _build_convolution(width, width, 3, stride, kind.n_groups),
                _build_convolution(width, n_outputs, 1),
            ]
        else:
            convolutions = [
                _build_convolution(n_inputs, n_outputs, 3, stride),
                _build_convolution(n_outputs, n_outputs, 3),
            ]
        blocks.append(_Block(n_inputs, stride, *convolutions))
        n_inputs = n_outputs
    return nn.Sequential(*blocks)


def _build_convolution(n_inputs: int, n_outputs: int, side: int, stride: int = 1, n_groups: int = 1) -> nn.Conv2d:
    """Return a convolution that keeps the size but for its stride."""
    return nn.Conv2d(n_inputs, n_outputs, side, stride=stride, padding=side // 2, groups=n_groups, bias=False)


def _build_shortcut(n_inputs: int, n_outputs: int, stride: int) -> nn.Sequential | None:
    """Return what brings a block's input to the shape of its output; none if it has that shape already."""
    if stride == 1 and n_inputs == n_outputs:
        return None
    return nn.Sequential(_build_convolution(n_inputs, n_outputs, 1, stride), nn.BatchNorm2d(n_outputs))

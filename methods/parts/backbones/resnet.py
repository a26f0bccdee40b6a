"""The convolutional part of ResNet and ResNeXt, under the two kinds of names that published weights have."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from torch import Tensor, nn

from vprbench.api import BadInput

N_STAGES = 4

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
        "resnet34": _Kind((3, 4, 6, 3), bottleneck=False),
        "resnet50": _Kind((3, 4, 6, 3), bottleneck=True),
        "resnet101": _Kind((3, 4, 23, 3), bottleneck=True),
        "resnet152": _Kind((3, 8, 36, 3), bottleneck=True),
        "resnext101_32x8d": _Kind((3, 4, 23, 3), bottleneck=True, n_groups=32, group_width=8),
    }
)
NAMES = tuple(_KINDS)


def resnet(name: str, n_stages: int = N_STAGES, names: Literal["numbers", "words"] = "numbers") -> nn.Sequential:
    """Return a ResNet without its pooling and classifier, in evaluation mode and without gradients.

    Images (n, 3, height, width) become (n, n_channels, height / 2^(n_stages + 1), width / 2^(n_stages + 1)), rounded
    up. The children are called "0" to "7" or conv1, bn1, relu, maxpool, layer1 to layer4; those of the stages that are
    left out are missing. Raises BadInput for an unknown name and outside 1 to 4 stages.
    Source: He et al. 2016 with the stride on the 3x3 convolution (v1.5), Xie et al. 2017 for ResNeXt; torchvision's
    names.
    """
    kind = _kind(name, n_stages)
    layers: list[nn.Module] = [
        nn.Conv2d(3, 64, 7, stride=2, padding=3, bias=False),
        nn.BatchNorm2d(64),
        nn.ReLU(inplace=True),
        nn.MaxPool2d(3, stride=2, padding=1),
    ]
    n_inputs = 64
    for stage in range(n_stages):
        layers.append(_stage(kind, stage, n_inputs))
        n_inputs = _n_outputs(kind, stage)
    keys = _WORDS if names == "words" else tuple(str(number) for number in range(len(_WORDS)))
    # The stages that are left out leave keys over.
    return nn.Sequential(OrderedDict(zip(keys, layers, strict=False))).eval().requires_grad_(False)


def n_channels(name: str, n_stages: int = N_STAGES) -> int:
    """Return how many channels `resnet(name, n_stages)` puts out; raises BadInput as that does."""
    return _n_outputs(_kind(name, n_stages), n_stages - 1)


class _Basic(nn.Module):
    """Two 3x3 convolutions beside a shortcut."""

    def __init__(self, n_inputs: int, n_outputs: int, stride: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(n_inputs, n_outputs, 3, stride=stride, padding=1, bias=False)
        self.bn1 = nn.BatchNorm2d(n_outputs)
        self.conv2 = nn.Conv2d(n_outputs, n_outputs, 3, padding=1, bias=False)
        self.bn2 = nn.BatchNorm2d(n_outputs)
        self.relu = nn.ReLU(inplace=True)
        self.downsample = _shortcut(n_inputs, n_outputs, stride)

    def forward(self, x: Tensor) -> Tensor:
        out: Tensor = self.bn2(self.conv2(self.relu(self.bn1(self.conv1(x)))))
        out += x if self.downsample is None else self.downsample(x)
        return out.relu_()


class _Bottleneck(nn.Module):
    """A 3x3 convolution between two of 1x1, beside a shortcut."""

    def __init__(self, n_inputs: int, width: int, n_outputs: int, stride: int, n_groups: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(n_inputs, width, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(width)
        self.conv2 = nn.Conv2d(width, width, 3, stride=stride, padding=1, groups=n_groups, bias=False)
        self.bn2 = nn.BatchNorm2d(width)
        self.conv3 = nn.Conv2d(width, n_outputs, 1, bias=False)
        self.bn3 = nn.BatchNorm2d(n_outputs)
        self.relu = nn.ReLU(inplace=True)
        self.downsample = _shortcut(n_inputs, n_outputs, stride)

    def forward(self, x: Tensor) -> Tensor:
        inner: Tensor = self.relu(self.bn1(self.conv1(x)))
        out: Tensor = self.bn3(self.conv3(self.relu(self.bn2(self.conv2(inner)))))
        out += x if self.downsample is None else self.downsample(x)
        return out.relu_()


def _kind(name: str, n_stages: int) -> _Kind:
    if name not in _KINDS:
        raise BadInput(f"there is no backbone {name}: give one of {', '.join(NAMES)}")
    if not 1 <= n_stages <= N_STAGES:
        raise BadInput(f"n_stages={n_stages}: {name} has stages 1 to {N_STAGES}")
    return _KINDS[name]


def _n_outputs(kind: _Kind, stage: int) -> int:
    """Return the channels after a stage; the first stage is 0."""
    return (256 if kind.bottleneck else 64) << stage


def _stage(kind: _Kind, stage: int, n_inputs: int) -> nn.Sequential:
    """Return the blocks of a stage; all but the first stage halve the image in their first block."""
    n_outputs = _n_outputs(kind, stage)
    blocks: list[nn.Module] = []
    for number in range(kind.n_blocks[stage]):
        stride = 2 if stage > 0 and number == 0 else 1
        if kind.bottleneck:
            width = kind.n_groups * kind.group_width << stage
            blocks.append(_Bottleneck(n_inputs, width, n_outputs, stride, kind.n_groups))
        else:
            blocks.append(_Basic(n_inputs, n_outputs, stride))
        n_inputs = n_outputs
    return nn.Sequential(*blocks)


def _shortcut(n_inputs: int, n_outputs: int, stride: int) -> nn.Sequential | None:
    """Return what brings a block's input to the shape of its output; none where it has it already."""
    if stride == 1 and n_inputs == n_outputs:
        return None
    return nn.Sequential(nn.Conv2d(n_inputs, n_outputs, 1, stride=stride, bias=False), nn.BatchNorm2d(n_outputs))

"""EfficientNet-Lite 0, 1 and 2 without their classifiers, batch norms folded into the convolutions before them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from types import MappingProxyType
from typing import Literal, cast

from torch import Tensor, nn
from torch.nn import functional

Variant = Literal["lite0", "lite1", "lite2"]

_EPSILON = 1e-3  # of the batch norms
_STEM = 32  # channels, the same in every variant
_DIVISOR = 8  # of which a layer's channels are a multiple
_WIDTH_AND_DEPTH: Mapping[str, tuple[float, float]] = MappingProxyType(
    {"lite0": (1.0, 1.0), "lite1": (1.0, 1.1), "lite2": (1.1, 1.2)}
)


#: Of each stage: blocks, kernel, stride of the first block, expansion and channels.
_STAGES = (
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
    (1, 3, 1, 6, 320),
)


class EfficientNetLite(nn.Module):
    """The stem and the MBConv blocks 0 to `last_block`, in evaluation mode, with random values.

    An image side becomes side / 2 after the stem, / 4, 8, 16 and 32 after the first block of the second, third, fourth
    and sixth stage, rounded up. Source: Tan and Le 2019 for the blocks and their scaling; the public description of the
    Lite variants: ReLU6 in the place of Swish, no squeeze-excitation, the first and the last stage never repeated, a
    stem and a head that do not grow with the width.
    """

    def __init__(self, variant: Variant, last_block: int | None = None) -> None:
        """Make the layers up to `last_block`, counted from 0; None: up to the last one."""
        super().__init__()
        plans = _plan_blocks(variant)
        kept = plans if last_block is None else plans[: last_block + 1]
        self.stem = Convolution(3, _STEM, 3, stride=2)
        self.blocks = nn.ModuleList(Block(*plan) for plan in kept)
        self.eval()

    def forward(self, images: Tensor, blocks: Sequence[int]) -> list[Tensor]:
        """Return the outputs of `blocks`, ascending, each (n, channels, rows, columns), for images (n, 3, h, w)."""
        maps, outputs = functional.relu6(self.stem(images), inplace=True), []
        for number, block in enumerate(self.blocks[: blocks[-1] + 1]):
            maps = block(maps)
            if number in blocks:
                outputs.append(maps)
        return outputs


def count_blocks(variant: Variant) -> int:
    """Return the number of MBConv blocks of a variant."""
    return len(_plan_blocks(variant))


def count_channels(variant: Variant, block: int) -> int:
    """Return the channels of a block's output."""
    return _plan_blocks(variant)[block][1]


def map_size(variant: Variant, block: int, height: int, width: int) -> tuple[int, int]:
    """Return the rows and columns of a block's output for an image of `height` x `width` pixels."""
    strides = [2, *(plan[3] for plan in _plan_blocks(variant)[: block + 1])]
    for stride in strides:
        height, width = math.ceil(height / stride), math.ceil(width / stride)
    return height, width


def count_multiply_adds(variant: Variant, last_block: int, height: int, width: int) -> int:
    """Return the multiply-adds of an image of `height` x `width` pixels, up to and with `last_block`."""
    rows, columns = math.ceil(height / 2), math.ceil(width / 2)
    total = rows * columns * _STEM * 3 * 3**2
    for n_inputs, n_outputs, kernel, stride, expansion in _plan_blocks(variant)[: last_block + 1]:
        inner = n_inputs * expansion
        total += rows * columns * n_inputs * inner * (expansion > 1)
        rows, columns = math.ceil(rows / stride), math.ceil(columns / stride)
        total += rows * columns * inner * (kernel**2 + n_outputs)
    return total


def fold_batch_norms(tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return the weight and the bias of each convolution, the batch norm behind it folded in, by this module's names.

    `tensors` are those of a published file: "_conv_stem.weight", "_bn0.running_mean", "_blocks.3._expand_conv.weight"
    and so on; layers after the blocks are left out. A convolution that lacks a part of its batch norm is left out
    too, which strict loading then reports.
    """
    folded: dict[str, Tensor] = {}
    for name, weight in tensors.items():
        parent, _, own = f".{name}".rpartition("._")
        convolution = own.removesuffix(".weight")
        if convolution not in _NORMS or own == convolution:
            continue
        parts = [tensors.get(f"{parent}._{_NORMS[convolution]}.{part}"[1:]) for part in _NORM_PARTS]
        if any(part is None for part in parts):
            continue
        scale, shift, mean, variance = (cast(Tensor, part).double() for part in parts)
        factor = scale / (variance + _EPSILON).sqrt()
        folder = parent.replace("._blocks.", "blocks.")
        place = ".".join(filter(None, [folder, _NAMES[convolution]]))
        folded[f"{place}.weight"] = (weight.double() * factor[:, None, None, None]).float()
        folded[f"{place}.bias"] = (shift - mean * factor).float()
    return folded


#: The batch norm behind each convolution of a published file, and the convolution's name in this module.
_NORMS = {"conv_stem": "bn0", "expand_conv": "bn0", "depthwise_conv": "bn1", "project_conv": "bn2"}
_NAMES = {"conv_stem": "stem", "expand_conv": "expand", "depthwise_conv": "depthwise", "project_conv": "project"}
_NORM_PARTS = ("weight", "bias", "running_mean", "running_var")


@cache
def _plan_blocks(variant: Variant) -> list[tuple[int, int, int, int, int]]:
    """Return input and output channels, kernel, stride and expansion of each block."""
    width, depth = _WIDTH_AND_DEPTH[variant]
    plans, n_inputs = list[tuple[int, int, int, int, int]](), _STEM
    for number, (n_blocks, kernel, stride, expansion, n_outputs) in enumerate(_STAGES):
        channels = _scale_channels(n_outputs, width)
        repeated = 0 < number < len(_STAGES) - 1
        for block in range(math.ceil(n_blocks * depth) if repeated else n_blocks):
            plans.append((n_inputs, channels, kernel, stride if block == 0 else 1, expansion))
            n_inputs = channels
    return plans


def _scale_channels(channels: int, width: float) -> int:
    """Return the multiple of 8 nearest to the scaled channels, and not less than nine tenths of them."""
    scaled = channels * width
    nearest = max(_DIVISOR, int(scaled + _DIVISOR / 2) // _DIVISOR * _DIVISOR)
    return nearest + _DIVISOR if nearest < 0.9 * scaled else nearest


class Convolution(nn.Conv2d):
    """A convolution with bias whose output side is its input side / stride, rounded up (TensorFlow's SAME)."""

    def __init__(self, n_inputs: int, n_outputs: int, kernel: int, stride: int = 1, groups: int = 1) -> None:
        """Make a layer of a square kernel."""
        super().__init__(n_inputs, n_outputs, kernel, stride, groups=groups)

    def padding_of(self, sides: Sequence[int]) -> tuple[tuple[int, int], tuple[int, int]]:
        """Return the padding at top and bottom, and at left and right, in pixels, for maps of `sides`."""
        kernel, stride = self.kernel_size[0], self.stride[0]
        if stride == 1:
            return (kernel // 2, kernel // 2), (kernel // 2, kernel // 2)
        both = [max(0, (math.ceil(side / stride) - 1) * stride + kernel - side) for side in sides]
        down, across = ((pixels // 2, pixels - pixels // 2) for pixels in both)
        return down, across

    def forward(self, maps: Tensor) -> Tensor:
        """Return the output for maps (n, channels, rows, columns)."""
        (top, bottom), (left, right) = self.padding_of(maps.shape[-2:])
        weight, padding = self.weight, (top, left)
        if bottom - top == right - left == 1:
            # PyTorch pads evenly without a copy: zeros in the kernel cost less than a padded copy of the maps.
            weight, padding = functional.pad(weight, (1, 0, 1, 0)), (bottom, right)
        elif (top, left) != (bottom, right):
            maps, padding = functional.pad(maps, (left, right, top, bottom)), (0, 0)
        return functional.conv2d(maps, weight, self.bias, self.stride, padding, groups=self.groups)


class Block(nn.Module):
    """MBConv: expand, convolve each channel on its own, project; a shortcut where input and output have one shape."""

    def __init__(self, n_inputs: int, n_outputs: int, kernel: int, stride: int, expansion: int) -> None:
        """Make the layers of a square kernel; an `expansion` of 1 has none before the depthwise one."""
        super().__init__()
        inner = n_inputs * expansion
        self.expand: Convolution | None = Convolution(n_inputs, inner, 1) if expansion > 1 else None
        self.depthwise = Convolution(inner, inner, kernel, stride, groups=inner)
        self.project = Convolution(inner, n_outputs, 1)
        self.shortcut = stride == 1 and n_inputs == n_outputs

    def forward(self, maps: Tensor) -> Tensor:
        """Return the output for maps (n, channels, rows, columns)."""
        inner = maps
        if self.expand is not None:
            inner = functional.relu6(self.expand(inner), inplace=True)
        inner = functional.relu6(self.depthwise(inner), inplace=True)
        projected = self.project(inner)
        return cast(Tensor, projected + maps if self.shortcut else projected)

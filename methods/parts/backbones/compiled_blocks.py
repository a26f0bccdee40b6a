"""EfficientNet-Lite on a CPU, compiled by oneDNN for images of one size."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from .efficientnet_lite import Block, Convolution, EfficientNetLite

_WARMING_CALLS = 3  # PyTorch compiles a graph during the first ones


@torch.inference_mode()
def compile_blocks(
    network: EfficientNetLite, images: Tensor, blocks: Sequence[int]
) -> Callable[[Tensor], Sequence[Tensor]] | None:
    """Return a function from images of this shape, channels last, to the outputs of `blocks`.

    The numbers are the network's but for the order of sums. None where oneDNN makes no graph.
    """
    sized = _SizedNetwork(network, cast(tuple[int, int], images.shape[-2:]), blocks)
    compiler: Any = torch.jit  # whose functions have no type hints
    try:
        compiler.enable_onednn_fusion(True)
    except RuntimeError:
        return None
    try:
        with warnings.catch_warnings():
            # PyTorch recommends torch.compile, which needs a compiler of C++ on the user's machine.
            warnings.simplefilter("ignore", DeprecationWarning)
            graph = compiler.freeze(compiler.trace(sized.eval(), images, check_trace=False))
            for _ in range(_WARMING_CALLS):
                graph(images)
    except RuntimeError:  # oneDNN has no graph of maps of one pixel
        return None
    finally:
        compiler.enable_onednn_fusion(False)
    return cast(Callable[[Tensor], Sequence[Tensor]], graph)


class _SizedNetwork(nn.Module):
    """The layers of a network for images of one size, all paddings known."""

    def __init__(self, network: EfficientNetLite, size: tuple[int, int], blocks: Sequence[int]) -> None:
        super().__init__()
        self._wanted = blocks
        self.stem = _SizedConvolution(network.stem, size)
        self.blocks = nn.ModuleList()
        size = self.stem.output_size
        for block in cast(Iterable[Block], network.blocks[: blocks[-1] + 1]):
            self.blocks.append(_SizedBlock(block, size))
            size = cast(_SizedBlock, self.blocks[-1]).depthwise.output_size

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        maps, outputs = functional.relu6(self.stem(images)), []
        for number, block in enumerate(self.blocks):
            maps = block(maps)
            if number in self._wanted:
                outputs.append(maps)
        return tuple(outputs)


class _SizedBlock(nn.Module):
    """A block for maps of one size."""

    def __init__(self, block: Block, size: tuple[int, int]) -> None:
        super().__init__()
        self.expand, self.project, self._shortcut = block.expand, block.project, block.shortcut
        self.depthwise = _SizedConvolution(block.depthwise, size)

    def forward(self, maps: Tensor) -> Tensor:
        inner = maps if self.expand is None else functional.relu6(self.expand(maps))
        projected = self.project(functional.relu6(self.depthwise(inner)))
        return cast(Tensor, projected + maps if self._shortcut else projected)


class _SizedConvolution(nn.Module):
    """A convolution of maps of one size.

    PyTorch pads evenly without a copy. Where a pixel more is wanted at the bottom and at the right, the kernel gets a
    first row and a first column of zeros, which costs less than a padded copy.
    """

    def __init__(self, convolution: Convolution, size: tuple[int, int]) -> None:
        super().__init__()
        self.stride, self.groups, self.bias = convolution.stride, convolution.groups, convolution.bias
        self.output_size = cast(tuple[int, int], tuple(-(-side // self.stride[0]) for side in size))
        weight = convolution.weight
        (top, bottom), (left, right) = convolution.padding_of(size)
        self.padding, self.copied_padding = (top, left), [0, 0, 0, 0]
        if bottom - top == right - left == 1:
            self.padding, weight = (bottom, right), functional.pad(weight, (1, 0, 1, 0))
        elif (top, left) != (bottom, right):
            self.padding, self.copied_padding = (0, 0), [left, right, top, bottom]
        self.weight = nn.Parameter(weight, requires_grad=False)

    def forward(self, maps: Tensor) -> Tensor:
        if any(self.copied_padding):
            maps = functional.pad(maps, self.copied_padding)
        return functional.conv2d(maps, self.weight, self.bias, self.stride, self.padding, groups=self.groups)

"""EfficientNet-Lite on a CPU: each convolution with its ReLU6 or its shortcut in one call of oneDNN, weights packed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, cast

import torch
from torch import Tensor
from torch.nn import functional

from .efficientnet_lite import Block, Convolution, EfficientNetLite

BlockOutputs = Callable[[Tensor, Sequence[int]], list[Tensor]]  # as EfficientNetLite.forward


def fuse_blocks(network: EfficientNetLite) -> BlockOutputs | None:
    """Return what computes the network's outputs by fused calls; None where PyTorch has no oneDNN that fuses.

    The numbers are the network's but for the order of sums. Images are (n, 3, height, width) on the CPU, channels last.
    """
    try:
        fused = _Fused(network)
        frame = network.stem.weight.new_zeros(1, 3, 32, 32)
        fused(frame.contiguous(memory_format=torch.channels_last), [0])
    except (AttributeError, RuntimeError):  # operators that PyTorch promises to nobody
        return None
    return fused


class _Fused:
    """The layers of a network, ready for oneDNN."""

    def __init__(self, network: EfficientNetLite) -> None:
        self._stem = _Packed(network.stem, relu6=True)
        self._blocks = [
            (
                None if block.expand is None else _Packed(block.expand, relu6=True),
                _Packed(block.depthwise, relu6=True),
                _Packed(block.project, relu6=False),
                block.shortcut,
            )
            for block in cast(Iterable[Block], network.blocks)
        ]

    def __call__(self, images: Tensor, blocks: Sequence[int]) -> list[Tensor]:
        maps, outputs = self._stem(images), []
        for number, (expand, depthwise, project, shortcut) in enumerate(self._blocks[: blocks[-1] + 1]):
            inner = depthwise(maps if expand is None else expand(maps))
            maps = project(inner, maps if shortcut else None)
            if number in blocks:
                outputs.append(maps)
        return outputs


class _Packed:
    """A convolution whose weights lie in oneDNN's order.

    oneDNN pads evenly. Where more is wanted at the right and at the bottom, a depthwise kernel gets a first row and a
    first column of zeros instead, which costs less than a padded copy of its many channels.
    """

    def __init__(self, convolution: Convolution, relu6: bool) -> None:
        self._convolution = convolution
        self._bias = convolution.bias.detach()  # type: ignore[union-attr]  # every convolution here has one
        self._fused: tuple[str, list[float]] = ("hardtanh", [0.0, 6.0]) if relu6 else ("none", [])
        weight = convolution.weight.detach()
        self._even = self._pack(weight)
        grown = functional.pad(weight, (1, 0, 1, 0))
        self._grown = self._pack(grown) if convolution.groups > 1 and convolution.stride[0] > 1 else None

    def __call__(self, maps: Tensor, shortcut: Tensor | None = None) -> Tensor:
        """Return the output for maps (n, channels, rows, columns), a shortcut of the output's shape added."""
        (top, bottom), (left, right) = self._convolution.padding_of(maps)
        weight, padding = self._even, [top, left]
        if (top, left) != (bottom, right):
            if self._grown is not None and bottom - top == right - left == 1:
                weight, padding = self._grown, [bottom, right]
            else:
                maps, padding = functional.pad(maps, (left, right, top, bottom)), [0, 0]
        place = (padding, [*self._convolution.stride], [1, 1], self._convolution.groups)
        operators: Any = torch.ops.mkldnn
        if shortcut is not None:
            added: Tensor = operators._convolution_pointwise.binary(
                maps, shortcut, weight, self._bias, *place, "add", 1.0, None, [], None
            )
            return added
        output: Tensor = operators._convolution_pointwise(maps, weight, self._bias, *place, *self._fused, "")
        return output

    def _pack(self, weight: Tensor) -> Tensor:
        stride = [*self._convolution.stride]
        packed: Tensor = torch._C._nn.mkldnn_reorder_conv2d_weight(
            weight.to_mkldnn(), [0, 0], stride, [1, 1], self._convolution.groups
        )
        return packed

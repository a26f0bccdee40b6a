"""EfficientNet-Lite on a CPU, compiled by oneDNN for images of one size."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, cast

import torch
from torch import Tensor, nn

from .efficientnet_lite import EfficientNetLite

_WARMING_CALLS = 3  # PyTorch compiles a graph during the first ones


@torch.inference_mode()
def compile_blocks(
    network: EfficientNetLite, images: Tensor, blocks: Sequence[int]
) -> Callable[[Tensor], Sequence[Tensor]] | None:
    """Return a function from images of this shape, channels last, to the outputs of `blocks`.

    The numbers are the network's but for the order of sums. None where oneDNN makes no graph.
    """
    compiler: Any = torch.jit  # whose functions have no type hints
    try:
        compiler.enable_onednn_fusion(True)
    except RuntimeError:
        return None
    try:
        with warnings.catch_warnings():
            # PyTorch recommends torch.compile, which needs a compiler of C++ on the user's machine, and warns that a
            # graph has the paddings of one size.
            warnings.simplefilter("ignore")
            graph = compiler.freeze(compiler.trace(_Blocks(network, blocks).eval(), images, check_trace=False))
            for _ in range(_WARMING_CALLS):
                graph(images)
    except RuntimeError:  # oneDNN has no graph of maps of one pixel
        return None
    finally:
        compiler.enable_onednn_fusion(False)
    return cast(Callable[[Tensor], Sequence[Tensor]], graph)


class _Blocks(nn.Module):
    """The outputs of some blocks of a network, as a tuple."""

    def __init__(self, network: EfficientNetLite, blocks: Sequence[int]) -> None:
        super().__init__()
        self._network, self._wanted = network, blocks

    def forward(self, images: Tensor) -> tuple[Tensor, ...]:
        return tuple(self._network(images, self._wanted))

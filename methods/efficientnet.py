"""EfficientNet-Lite, trained on ImageNet: feature maps of several depths side by side, as a descriptor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from vprbench.api import BadInput, NeuralDescriptor, Resize, count_operations, load_strictly, state_dict

from .parts.backbones.compiled_blocks import compile_blocks
from .parts.backbones.efficientnet_lite import (
    EfficientNetLite,
    Variant,
    count_blocks,
    count_channels,
    count_multiply_adds,
    fold_batch_norms,
    map_size,
)

Grid = tuple[int, int] | None  # rows and columns of cells; None: every position of the map


@dataclass(kw_only=True)
class EfficientNet(NeuralDescriptor):
    """Describes an image by the outputs of some blocks of EfficientNet-Lite, which was not trained for places.

    Of each block in `blocks`, counted from 0, the means over the cells of its `grid` are brought to unit length; these
    vectors side by side are the descriptor. Early blocks tell places apart that are seen from the same pose, late ones
    bear other viewpoints. `variant` is that of the file. An image is seen as (level - 127) / 128, as the published
    weights want it; the size of 128x224 pixels is this project's choice.
    Source: Tan and Le 2019, and the Lite variants of their public code.
    """

    variant: Variant = "lite0"
    blocks: tuple[int, ...] = (4, 10, 12)
    grid: tuple[Grid, ...] = (None, None, (2, 4))
    height: int | None = 128
    width: int | None = 224
    resize: Resize = "tensor"

    def load(self, path: Path) -> nn.Module:
        """Return the network up to the last block that is read; raises BadInput for a file of another variant."""
        network = cast(_EfficientNetwork, self.blank())
        tensors = state_dict(path)
        folded = fold_batch_norms(tensors)
        n_blocks, of_variant = 1 + max(map(_find_block, folded), default=-1), count_blocks(self.variant)
        if folded and n_blocks != of_variant:
            wanted = f"{n_blocks} blocks, wanted {of_variant}; set method.variant"
            raise BadInput(f"{path} does not fit {self.variant}: {wanted}")
        known = {name: tensor for name, tensor in folded.items() if _find_block(name) <= self.blocks[-1]}
        load_strictly(network.model, known or tensors, path)  # which names what another network has
        return network

    def blank(self) -> nn.Module:
        """Return the network up to the last block that is read, on the device "meta"."""
        self._check_arguments()
        with torch.device("meta"):
            return _EfficientNetwork(EfficientNetLite(self.variant, self.blocks[-1]), self.blocks, self.grid)

    def use(self, network: nn.Module) -> None:
        """Describe images with this network from now on."""
        super().use(network)
        own = cast(_EfficientNetwork, self._network)
        own.compiled = None
        if self.device == "cpu":
            shown = torch.zeros(1, 3, *self.target(0, 0)).contiguous(memory_format=torch.channels_last)
            own.compiled = compile_blocks(own.model, shown, self.blocks)

    def pixels(self, levels: Tensor) -> Tensor:
        """Return what the network sees of RGB levels 0..255, (n, 3, height, width)."""
        return (levels - 127) / 128

    def block_lengths(self) -> list[int]:
        """Return the numbers that each block gives; raises BadInput for arguments that do not fit."""
        self._check_arguments()
        return [
            count_channels(self.variant, block) * rows * columns
            for block, (rows, columns) in zip(self.blocks, self._resolve_cells(), strict=True)
        ]

    def _resolve_cells(self) -> list[tuple[int, int]]:
        """Return the rows and columns that are kept of each block; raises BadInput for cells that no map has."""
        if self.height is None or self.width is None:
            raise BadInput(f"method.height={self.height}, method.width={self.width}: give both")
        maps = [map_size(self.variant, block, self.height, self.width) for block in self.blocks]
        cells = [most if grid is None else grid for most, grid in zip(maps, self.grid, strict=True)]
        for block, most, own in zip(self.blocks, maps, cells, strict=True):
            if not (1 <= own[0] <= most[0] and 1 <= own[1] <= most[1]):
                raise BadInput(
                    f"method.grid={[*self.grid]}: give block {block} 1 to {most[0]} rows and 1 to {most[1]} columns, "
                    "or null for all"
                )
        return cells

    def _described(self, batch: npt.NDArray[Any]) -> Tensor:
        size = self.target(*batch.shape[1:3])
        count_operations(len(batch) * count_multiply_adds(self.variant, self.blocks[-1], *size))
        return super()._described(batch)

    def _at_most(self, image: npt.NDArray[Any]) -> int:
        # On a CPU the maps of one image stay in its caches; several together are slower.
        return 1 if self.device == "cpu" else super()._at_most(image)

    def _check_arguments(self) -> None:
        """Raise BadInput for arguments that do not fit."""
        super()._check_arguments()
        last = count_blocks(self.variant) - 1
        ascending = all(one < next_one for one, next_one in zip(self.blocks, self.blocks[1:], strict=False))
        if not self.blocks or not ascending or not 0 <= self.blocks[0] <= self.blocks[-1] <= last:
            raise BadInput(f"method.blocks={[*self.blocks]}: give blocks of {self.variant}, 0 to {last}, ascending")
        if len(self.grid) != len(self.blocks):
            raise BadInput(
                f"method.grid={[*self.grid]} has {len(self.grid)} entries for {len(self.blocks)} blocks: give rows and "
                "columns for each, null for every position"
            )
        self._resolve_cells()


class _EfficientNetwork(nn.Module):
    """Images (n, 3, height, width) to the cells of each block, each of unit length, side by side (n, n_dimensions)."""

    def __init__(self, model: EfficientNetLite, blocks: Sequence[int], grid: Sequence[Grid]) -> None:
        super().__init__()
        self.model = model
        self.compiled: Callable[[Tensor], Sequence[Tensor]] | None = None  # the same outputs of one image, faster
        self._blocks, self._grid = blocks, grid

    def forward(self, images: Tensor) -> Tensor:
        maps = self.model(images, self._blocks) if self.compiled is None else self.compiled(images)
        pairs = zip(maps, self._grid, strict=True)
        cells = [each if grid is None else functional.adaptive_avg_pool2d(each, grid) for each, grid in pairs]
        return torch.cat([functional.normalize(each.flatten(1).float(), dim=1) for each in cells], dim=1)


def _find_block(name: str) -> int:
    """Return the number of the block that a tensor belongs to; -1 for the stem's."""
    return int(name.split(".")[1]) if name.startswith("blocks.") else -1

"""VPRTempo whose input spikes are made by a trained network, EfficientNet-Lite."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt

from vprbench.api import Images, Weights

from ..efficientnet import EfficientNet, Grid
from ..parts.backbones.efficientnet_lite import Variant
from .encoding import scale_values
from .int8 import VPRTempoInt8
from .method import VPRTempo


@dataclass(frozen=True)
class BlockSpikes:
    """A spike for every number that a trained network gives of a frame: the more it stands out, the larger."""

    descriptor: EfficientNet

    @property
    def n_inputs(self) -> int:
        """The numbers of all blocks."""
        return sum(self.descriptor.block_lengths())

    def __call__(self, images: Images) -> npt.NDArray[np.float32]:
        """Return the spikes of each frame, each block scaled on its own."""
        ends = np.cumsum(self.descriptor.block_lengths())[:-1]
        return np.concatenate([scale_values(part) for part in np.split(self.descriptor.encode(images), ends, 1)], 1)


@dataclass(kw_only=True)
class VPRTempoEfficientNet(VPRTempo):
    """VPRTempo that reads the feature maps of EfficientNet-Lite in the place of pixels; see `EfficientNet`.

    `blocks`, `grid` and `variant` are those of the descriptor. Training does not touch the network's weights.
    """

    weights: Weights
    encoding: Literal["efficientnet"] = "efficientnet"  # type: ignore[assignment]  # its own, beside VPRTempo's
    variant: Variant = "lite0"
    blocks: tuple[int, ...] = (4, 10, 12)
    grid: tuple[Grid, ...] = ((8, 14), (4, 7), (2, 4))
    height: int = 128
    width: int = 224

    conformance_arguments: ClassVar[Mapping[str, Any]] = {
        **{"max_module": 10, "blocks": [1, 2], "grid": [[4, 5], [3, 4]], "height": 32, "width": 40},
    }

    _descriptor: EfficientNet | None = field(default=None, init=False, repr=False, compare=False)

    def encoder(self) -> BlockSpikes:
        """Return the encoder; raises BadInput for blocks or cells that the network lacks."""
        if self._descriptor is None:
            self._descriptor = EfficientNet(
                weights=self.weights,
                variant=self.variant,
                blocks=self.blocks,
                grid=self.grid,
                height=self.height,
                width=self.width,
                device=self.device,
            )
        return BlockSpikes(self._descriptor)

    def files(self) -> Sequence[Path]:
        """Return the file of weights; raises BadInput if it is missing."""
        return self.encoder().descriptor.files()


@dataclass(kw_only=True)
class VPRTempoEfficientNetInt8(VPRTempoInt8, VPRTempoEfficientNet):
    """The same network, asked in 8 bits; EfficientNet-Lite stays in 32."""

    conformance_arguments: ClassVar[Mapping[str, Any]] = VPRTempoEfficientNet.conformance_arguments

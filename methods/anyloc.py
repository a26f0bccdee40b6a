"""AnyLoc: values of DINOv2's attention, gathered by a small vocabulary, as a method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from vprbench.api import BadInput, Interpolation, Resize, Weights, find_weights, read_tensor

from .dinov2 import Backbone
from .parts.backbones.vit import SIZES, VisionTransformer, first_blocks
from .parts.published import PublishedNetwork, Tensors

Domain = Literal["indoor", "urban", "aerial", "structured", "unstructured", "global"]

_ROUNDING = 1e-5  # length of a residual, per value in it, that is rounding and no direction


@dataclass(kw_only=True)
class AnyLoc(PublishedNetwork):
    """AnyLoc-VLAD-DINOv2: 49152 numbers, 1536 for each of 32 centres, from networks not trained for places.

    The values of block 31 of DINOv2 ViT-g/14, one for each patch and of unit length, go to the centre of most similar
    direction; their differences from it are summed and brought to unit length per centre. `domain` names the file of
    published centres; another `backbone`, `layer` (from 0) or number of `words` wants own `centres`.

    As in the authors' demo, images keep their size, those with more than `longest_side` pixels shrink to it, sides
    rounded down, and what exceeds whole patches of 14x14 is cut off at the borders; with
    `preprocessing`=vpr_methods_evaluation they are resized to the nearest whole patches instead.
    Source: Keetha et al. 2023 and AnyLoc/DINO (eea7d4c).
    """

    centres: Weights
    domain: Domain = "urban"
    backbone: Backbone = "vitg14"
    layer: int = 31
    words: int = 32
    resize: Resize = "tensor"
    interpolation: Interpolation = "bicubic"
    longest_side: int | None = 1024  # pixels
    batch_size: int = 4

    multiple: ClassVar[int] = 14
    smallest_side: ClassVar[int] = 14
    crops: ClassVar[bool] = True

    def files(self) -> Sequence[Path]:
        """Return the files of the network and of published centres; raises BadInput if one is missing."""
        return [*super().files(), self._centres_file()]

    def target(self, height: int, width: int) -> tuple[int, int]:
        """Return the height and width that an image is resized to, before its borders are cut off."""
        if self.preprocessing != "authors":
            return super().target(height, width)
        wanted = (self.height or height, self.width or width)
        longest = max(wanted)
        if self.longest_side is None or longest <= self.longest_side:
            return wanted
        return wanted[0] * self.longest_side // longest, wanted[1] * self.longest_side // longest

    def loaded(self, tensors: Tensors, path: Path) -> nn.Module:
        """Return the network of the blocks up to `layer`, and the centres; raises BadInput if they do not fit."""
        network = cast(_Network, super().loaded(first_blocks(tensors, self.layer + 1), path))
        network.centres = self._read_centres(network.values.model.sizes.dim)
        return network

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network in the sizes of `backbone`, or of a file, up to `layer`."""
        model = VisionTransformer.sized(tensors, self.backbone, n_blocks=self.layer + 1)
        return _Network(model, self.words)

    def named(self, network: nn.Module) -> nn.Module:
        """Return the transformer alone."""
        return cast(_Network, network).values.model

    def use(self, network: nn.Module) -> None:
        """Describe images with this network from now on; centres stay float32."""
        centres = cast(Tensor, network.centres)
        super().use(network)
        network.centres = centres.to(self.device)

    def _check_arguments(self) -> None:
        """Raise BadInput for arguments that do not fit."""
        super()._check_arguments()
        n_blocks = SIZES[self.backbone].n_blocks
        if not 0 <= self.layer < n_blocks:
            raise BadInput(
                f"method.layer={self.layer}: {self.backbone} has layers 0 to {n_blocks - 1}, give one of them"
            )
        if self.words < 1:
            raise BadInput(f"method.words={self.words}: give at least 1 centre")
        if self.longest_side is not None and self.longest_side < self.multiple:
            raise BadInput(f"method.longest_side={self.longest_side}: give at least {self.multiple}, or null for any")

    def _centres_file(self) -> Path:
        return find_weights(self.centres, f"{type(self).__name__} in the domain {self.domain}", "centres")

    def _read_centres(self, dim: int) -> Tensor:
        path = self._centres_file()
        centres = read_tensor(path)
        if centres.shape != (self.words, dim) or not centres.is_floating_point() or not centres.isfinite().all():
            raise BadInput(
                f"{path} holds centres of shape {tuple(centres.shape)} {centres.dtype}; wanted ({self.words}, {dim}), "
                "method.words times the network's dimensions, all finite"
            )
        return centres.float()


class _Network(nn.Module):
    """Images (n, 3, height, width) in, VLADs float32 (n, n_centres * dim) out, not yet of unit length."""

    centres: Tensor  # (n_centres, dim)

    def __init__(self, model: VisionTransformer, n_centres: int) -> None:
        super().__init__()
        self.values = _Values(model)
        self.register_buffer("centres", torch.zeros(n_centres, model.sizes.dim))

    def forward(self, images: Tensor) -> Tensor:
        return vlad(self.values(images), self.centres)


class _Values(nn.Module):
    """The value facet of a transformer's last block, unit vectors, float32 (n, n_patches, dim)."""

    def __init__(self, model: VisionTransformer) -> None:
        super().__init__()
        self.model = model

    def forward(self, images: Tensor) -> Tensor:
        return functional.normalize(self.model.values(images).flatten(1, 2).float(), dim=2)


def vlad(values: Tensor, centres: Tensor) -> Tensor:
    """Return (n, n_centres * dim): per centre, at unit length, the sum of residuals of the unit vectors nearest to it.

    `values` is (n, n_patches, dim). Nearest is what has the most similar direction; the residual is from the centre
    as it is, of any length. A centre without values, or with none but itself, has zeros.
    """
    nearest = (values @ functional.normalize(centres, dim=1).T).argmax(2)
    chosen = functional.one_hot(nearest, len(centres)).to(values.dtype)  # (n, n_patches, n_centres)
    n_values = chosen.sum(1)[:, :, None]
    residuals = chosen.transpose(1, 2) @ values - n_values * centres
    lengths = residuals.norm(dim=2, keepdim=True)
    return torch.where(lengths > _ROUNDING * n_values, residuals / lengths, 0).flatten(1)

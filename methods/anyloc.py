"""AnyLoc: values of DINOv2's attention, gathered by a small vocabulary, as a method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, Self, cast

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from vprbench.api import (
    BadInput,
    Images,
    Interpolation,
    NotFittedError,
    Places,
    Resize,
    Weights,
    find_weights,
    progress,
    read_tensor,
)

from .dinov2 import Backbone
from .parts.backbones.vit import SIZES, VisionTransformer, keep_first_blocks
from .parts.published import PublishedNetwork, Tensors
from .parts.vectors import k_means

Domain = Literal["indoor", "urban", "aerial", "structured", "unstructured", "global"]
Vocabulary = Literal["published", "references"]

_PUBLISHED = ("vitg14", 31, 32)  # backbone, layer and number of the centres that the authors give away
_SAMPLED_IMAGES = 1000  # references that centres are learnt from, at most
_SAMPLED_PER_CENTRE = 256  # values
_ROUNDING = 1e-5  # length of a residual, per value in it, that is rounding and no direction


@dataclass(kw_only=True)
class AnyLoc(PublishedNetwork):
    """AnyLoc-VLAD-DINOv2: 49152 numbers, 1536 for each of 32 centres, from networks not trained for places.

    The values of block 31 of DINOv2 ViT-g/14, one for each patch and of unit length, go to the centre of most similar
    direction; their differences from it are summed and brought to unit length per centre. `domain` names the file of
    published centres. As in the authors' demo, images keep their size, those with more than `longest_side` pixels
    shrink to it, sides rounded down, and what exceeds whole patches of 14x14 is cut off at the borders; with
    `preprocessing`=vpr_methods_evaluation they are resized to the nearest whole patches instead.

    vocabulary=references is a variant and no published method: the centres are learnt by k-means from what the
    references look like, never from their places; say so beside any result. Then any `backbone`, `layer` (counted from
    0) and number of `words` will do, and `encode` raises NotFittedError before `fit`.
    Source: Keetha et al. 2023 and AnyLoc/DINO (eea7d4c).
    """

    centres: Weights | None = None  # not needed for vocabulary=references
    domain: Domain = "urban"
    vocabulary: Vocabulary = "published"
    backbone: Backbone = "vitg14"
    layer: int = 31
    words: int = 32
    seed: int = 0
    resize: Resize = "tensor"
    interpolation: Interpolation = "bicubic"
    longest_side: int | None = 1024  # pixels
    batch_size: int = 4

    multiple: ClassVar[int] = 14
    smallest_side: ClassVar[int] = 14
    crops: ClassVar[bool] = True

    _learnt: bool = field(default=False, init=False, repr=False, compare=False)

    def files(self) -> Sequence[Path]:
        """Return the files of the network and of published centres; raises BadInput if one is missing."""
        self._check_arguments()  # before gigabytes are fetched
        files = [*super().files()]
        return files if self.vocabulary == "references" else [*files, self._find_centres()]

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
        network = cast(_VLADNetwork, super().loaded(keep_first_blocks(tensors, self.layer + 1), path))
        dim = network.values.model.sizes.dim
        learnt = self.vocabulary == "references"
        network.centres = torch.zeros(self.words, dim) if learnt else self._read_centres(dim)
        return network

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network in the sizes of `backbone`, or of a file, up to `layer`."""
        model = VisionTransformer.sized(tensors, self.backbone, n_blocks=self.layer + 1)
        return _VLADNetwork(model, self.words)

    def name_parts(self, network: nn.Module) -> nn.Module:
        """Return the transformer alone."""
        return cast(_VLADNetwork, network).values.model

    def use(self, network: nn.Module) -> None:
        """Describe images with this network from now on; centres stay float32."""
        centres = cast(Tensor, network.centres)
        super().use(network)
        network.centres = centres.to(self.device)

    def fit(self, references: Images, places: Places) -> Self:
        """Learn the centres if the vocabulary is the references' own, and encode all references."""
        if self.vocabulary == "references":
            self._check_arguments()
            self.searched = None
            self._learnt = False
            if self._network is None:
                self.use(self.load(self.files()[0]))
            network = cast(_VLADNetwork, self._network)
            network.centres = torch.from_numpy(self._learn_centres(network, references)).to(self.device)
            self._learnt = True
        return super().fit(references, places)

    def keeps_descriptors(self) -> bool:
        """Tell that descriptors are worth keeping on disk, unless their centres are the references' own."""
        return self.vocabulary == "published"

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        """Return the VLAD of each image, (n_images, words * dim), unit vectors."""
        if self.vocabulary == "references" and not self._learnt:
            raise NotFittedError("AnyLoc has no centres yet: call fit(references, places) first")
        return super().encode(images)

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

    def _find_centres(self) -> Path:
        if self.centres is None:
            raise BadInput("method.centres is missing: give the file with centres, or set method.vocabulary=references")
        if self.centres.path is None and (self.backbone, self.layer, self.words) != _PUBLISHED:
            backbone, layer, words = _PUBLISHED
            raise BadInput(
                f"method.backbone={self.backbone} method.layer={self.layer} method.words={self.words}: centres are "
                f"published for {backbone}, {layer} and {words} alone; set method.vocabulary=references, or give "
                "method.centres.path=FILE"
            )
        return find_weights(self.centres, f"{type(self).__name__} in the domain {self.domain}", "centres")

    def _read_centres(self, dim: int) -> Tensor:
        path = self._find_centres()
        centres = read_tensor(path)
        if centres.shape != (self.words, dim) or not centres.is_floating_point() or not centres.isfinite().all():
            raise BadInput(
                f"{path} holds centres of shape {tuple(centres.shape)} {centres.dtype}; wanted ({self.words}, {dim}), "
                "method.words times the network's dimensions, all finite"
            )
        return centres.float()

    def _learn_centres(self, network: _VLADNetwork, references: Images) -> npt.NDArray[np.float32]:
        """Return k-means' centres, (words, dim), of values drawn from the references."""
        generator = np.random.default_rng(self.seed)
        n = len(references)
        chosen = np.sort(generator.choice(n, min(n, _SAMPLED_IMAGES), replace=False))
        per_image = _SAMPLED_PER_CENTRE * self.words / len(chosen)
        drawn: list[npt.NDArray[np.float32]] = []

        def draw(_: nn.Module, __: Any, values: Tensor) -> None:
            share = per_image / values.shape[1]
            picked = torch.from_numpy(generator.random(values.shape[:2]) < share).to(values.device)
            drawn.append(values[picked].cpu().numpy())

        hook = network.values.register_forward_hook(draw)
        try:
            super().encode(
                references[chosen].watched(lambda done: progress.report("learning centres", done / len(chosen)))
            )
        finally:
            hook.remove()
        return k_means(np.concatenate(drawn), self.words, generator)


class _VLADNetwork(nn.Module):
    """Images (n, 3, height, width) in, VLADs float32 (n, n_centres * dim) out, not yet of unit length."""

    centres: Tensor  # (n_centres, dim)

    def __init__(self, model: VisionTransformer, n_centres: int) -> None:
        super().__init__()
        self.values = _Values(model)
        self.register_buffer("centres", torch.zeros(n_centres, model.sizes.dim))

    def forward(self, images: Tensor) -> Tensor:
        return gather_residuals(self.values(images), self.centres)


class _Values(nn.Module):
    """The value facet of a transformer's last block, unit vectors, float32 (n, n_patches, dim)."""

    def __init__(self, model: VisionTransformer) -> None:
        super().__init__()
        self.model = model

    def forward(self, images: Tensor) -> Tensor:
        return functional.normalize(self.model.values(images).flatten(1, 2).float(), dim=2)


def gather_residuals(values: Tensor, centres: Tensor) -> Tensor:
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

"""GCL: a network trained with graded similarity of images, pooled by generalised mean, as a method."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import ClassVar, Literal, Self

import numpy as np
import numpy.typing as npt
from torch import Tensor, nn

from vprbench.api import BadInput, Descriptors, Places, Scores

from .parts.backbones.convolutional import GeM, build_resnet, build_vgg16
from .parts.published import PublishedNetwork, Tensors

Backbone = Literal["vgg16", "resnet50", "resnet152", "resnext"]
Pooling = Literal["GeM", "avg", "max"]

_RESNETS = {"resnet50": "resnet50", "resnet152": "resnet152", "resnext": "resnext101_32x8d"}
_POOLINGS: Mapping[Pooling, Callable[[], nn.Module]] = MappingProxyType(
    {"GeM": GeM, "avg": lambda: nn.AdaptiveAvgPool2d(1), "max": lambda: nn.AdaptiveMaxPool2d(1)}
)
_ONE_BY_ONE = "a batch gives what its single images give"
_SMALLEST_NORM = 1e-6
_TOGETHER = 4096  # descriptors


@dataclass(frozen=True)
class Whitening:
    """The mean of descriptors, and a projection that leaves components of equal variance."""

    mean: npt.NDArray[np.float32]  # (n_dimensions,)
    projection: npt.NDArray[np.float32]  # (n_dimensions, n_components)

    @classmethod
    def learn(cls, descriptors: Descriptors, n_components: int) -> Self:
        """Learn it from descriptors (n, n_dimensions): the directions of largest variance, the largest first.

        There are fewer than `n_components` if the descriptors vary in fewer directions, n - 1 at most.
        """
        n, n_dimensions = descriptors.shape
        mean = sum(block.sum(0) for block in _read_residual_blocks(descriptors)) / n
        few = n < n_dimensions
        if few:  # n x n products vary in the same directions, and are far smaller
            centred = np.concatenate([*_read_residual_blocks(descriptors)]) - mean
            products = centred @ centred.T
        else:
            products = np.zeros((n_dimensions, n_dimensions))
            for block in _read_residual_blocks(descriptors):
                products += (block - mean).T @ (block - mean)
        variances, directions = np.linalg.eigh(products / (2 * n))  # the 2 is the authors'
        # In directions without variance there is rounding noise left, which whitening would make as large as any.
        rounding = max(n, n_dimensions) * np.finfo(np.float64).eps
        kept = np.flatnonzero(variances > rounding * variances[-1])[::-1][:n_components]
        directions, deviations = directions[:, kept], np.sqrt(variances[kept])
        if few:
            directions = centred.T @ directions / (np.sqrt(2 * n) * deviations)
        projection = directions / deviations
        if not len(kept):  # all are equal: nothing tells them apart, but an index wants a dimension
            projection = np.zeros((n_dimensions, 1))
        return cls(mean.astype(np.float32), projection.astype(np.float32))

    def __call__(self, descriptors: Descriptors) -> npt.NDArray[np.float32]:
        """Return whitened descriptors of unit length, (n, n_components); zero for the mean."""
        whitened = np.empty((len(descriptors), self.projection.shape[1]), np.float32)
        for first in range(0, len(descriptors), _TOGETHER):
            own = slice(first, first + _TOGETHER)
            rounded = descriptors[own].astype(np.float16)  # as the authors apply it, not as they learn it
            whitened[own] = (rounded.astype(np.float32) - self.mean) @ self.projection
        whitened /= np.linalg.norm(whitened, axis=1, keepdims=True) + np.float32(_SMALLEST_NORM)
        return whitened


@dataclass(kw_only=True)
class GCL(PublishedNetwork):
    """Scores a place by the cosine between the pooled features of query and most similar reference image.

    `loss` says what the network was trained with, graded (GCL) or binary (CL) labels, and changes nothing but the file.
    Source: Leyva-Vallina et al. 2023 and marialeyvallina/generalized_contrastive_loss 3f02752.

    With `n_components` descriptors are whitened, of references and queries alike, rounded to float16 first, as the
    authors do it. The whitening is learnt from what the references look like, before any rounding, never from their
    places or the queries: the method is then transductive on the references. It keeps at most as many components as
    they vary in, one less than there are.
    """

    backbone: Backbone = "resnet152"  # resnext: ResNeXt-101 32x8d
    pooling: Pooling = "GeM"
    loss: Literal["GCL", "CL"] = "GCL"
    height: int | None = 480
    width: int | None = 640
    n_components: int | None = None  # of the whitening; None: no whitening

    search_arguments: ClassVar[frozenset[str]] = PublishedNetwork.search_arguments | {"loss", "n_components"}

    _whitening: Whitening | None = field(default=None, init=False, repr=False, compare=False)

    @property
    def conformance_exceptions(self) -> Mapping[str, str]:  # type: ignore[override]  # whitening alone has one
        """The rule of the conformance suite that whitening cannot keep, and the reason."""
        if self.n_components is None:
            return {}
        return {_ONE_BY_ONE: "a last digit may round to another float16, which the weakest components make visible"}

    @property
    def smallest_side(self) -> int:  # type: ignore[override]  # here it depends on an argument
        """The pixels under which nothing is left to pool: VGG16 halves five times, a ResNet rounds up."""
        return 32 if self.backbone == "vgg16" else 1

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network of this backbone and this pooling, whose sizes are the same in every file."""
        return _GCL(self.backbone, self.pooling)

    def fit_descriptors(self, descriptors: Descriptors, places: Places) -> Self:
        """Learn the whitening, if one is wanted, and keep the whitened references."""
        if self.n_components is not None and self.n_components < 1:
            raise BadInput(f"method.n_components={self.n_components}: give at least 1, or null for no whitening")
        self._whitening = None if self.n_components is None else Whitening.learn(descriptors, self.n_components)
        whitened = descriptors if self._whitening is None else self._whitening(descriptors)
        return super().fit_descriptors(whitened, places)

    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        """Score every place for every code, (n_queries, n_places); raises NotFittedError before `fit`."""
        return super().match(self._whiten_codes(codes))

    def nearest(self, codes: npt.NDArray[np.float32], n: int) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int64]]:
        """Return the scores of the best `n` places of each code, and these places."""
        return super().nearest(self._whiten_codes(codes), n)

    def _whiten_codes(self, descriptors: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        return descriptors if self._whitening is None else self._whitening(descriptors)


class _GCL(nn.Module):
    """Images (n, 3, height, width) to descriptors (n, n_channels), not yet of unit length."""

    def __init__(self, backbone: Backbone, pooling: Pooling) -> None:
        super().__init__()
        self.backbone = build_vgg16() if backbone == "vgg16" else build_resnet(_RESNETS[backbone])
        self.pool: nn.Module = _POOLINGS[pooling]()

    def forward(self, images: Tensor) -> Tensor:
        pooled: Tensor = self.pool(self.backbone(images)).flatten(1)
        return pooled


def _read_residual_blocks(descriptors: Descriptors) -> Iterator[npt.NDArray[np.float64]]:
    """Yield descriptors in blocks, (n, n_dimensions), as float64."""
    for first in range(0, len(descriptors), _TOGETHER):
        yield descriptors[first : first + _TOGETHER].astype(np.float64)

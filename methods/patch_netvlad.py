"""Patch-NetVLAD: NetVLAD proposes places, and descriptors of patches, matched in their geometry, put them in order."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar, Literal, Self

import cv2
import numpy as np
import numpy.typing as npt
import psutil
import torch
from torch import Tensor, nn
from torch.nn import functional

from vprbench.api import BadInput, Descriptors, Images, NotFittedError, Places, Scores

from .netvlad import STRIDE, Network, read_sizes
from .parts.published import PublishedNetwork, Tensors
from .parts.vectors import unit

Configuration = Literal["performance", "speed", "storage"]
Geometry = Literal["homography", "displacement"]
Pairs = tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]  # patches of the query, and theirs of the reference

_RECEPTIVE_FIELD, _PADDING = 196, 90  # pixels of a local descriptor
_TOLERANCE = 1.5 * STRIDE  # pixels that an inlier of the homography may be off


@dataclass(frozen=True)
class Setting:
    """The patches that a configuration of the paper compares, and how."""

    sides: tuple[int, ...]  # of square patches, local descriptors
    weights: tuple[float, ...]  # of their scores, together 1
    geometry: Geometry


SETTINGS: Mapping[Configuration, Setting] = MappingProxyType(
    {
        "performance": Setting((2, 5, 8), (0.45, 0.15, 0.4), "homography"),
        "speed": Setting((5,), (1.0,), "displacement"),
        "storage": Setting((5,), (1.0,), "displacement"),
    }
)


@dataclass(frozen=True)
class Map:
    """The descriptors of the references, and the images of each place."""

    codes: npt.NDArray[Any]  # (n_references, 1 + n_patches, n_components), all of one length
    whole: npt.NDArray[np.float32]  # (n_references, n_components), unit vectors
    images: Sequence[npt.NDArray[np.int64]]  # of each place


@dataclass(kw_only=True)
class PatchNetVLAD(PublishedNetwork):
    """Orders the places that look most alike to NetVLAD by how many patches of their images match in their geometry.

    The `candidates` places of the highest cosine are compared patch by patch, each by its image of the highest cosine.
    For each patch size the pairs of patches that are nearest to one another score: by the inliers of a homography
    (`configuration`=performance), for which fewer than 4 pairs score 0, or by how little their displacements differ
    (speed, storage). These scores become standard scores among a query's candidates and are summed with the paper's
    weights. A place's score is its cosine, at most 1; that of one of n candidates is the sum + 2 + sqrt(n - 1), which
    is at least 2, and of equal sums the higher cosine scores higher by one rounding step. An approximate `index`
    retrieves the images that candidates are taken from.

    `encode` gives the descriptors of the image and of its patches one after the other as one unit vector.
    `components` says how many principal components the file of each configuration has; a patch takes 4 bytes for each
    of them, or 2 with `patches`=float16, which holds for the references. For images of 480x640 that is 46 MB an image
    for performance, 1.9 MB for speed and 0.5 MB for storage: `fit` raises BadInput if there is not enough memory.
    Source: Hausler et al. 2021 and QVPR/Patch-NetVLAD 39ab4e4.
    """

    configuration: Configuration = "performance"
    components: Mapping[Configuration, int] = field(
        default_factory=lambda: {"performance": 4096, "speed": 512, "storage": 128}
    )
    candidates: int = 100  # places
    patches: Literal["float32", "float16"] = "float32"
    height: int | None = 480
    width: int | None = 640

    fixed_size: ClassVar[bool] = True
    adapts: ClassVar[bool] = False  # its patches have no mean in common
    search_arguments: ClassVar[frozenset[str]] = PublishedNetwork.search_arguments | {"candidates", "patches"}

    _map: Map | None = field(default=None, init=False, repr=False, compare=False)

    def fit(self, references: Images, places: Places) -> Self:
        """Encode the references, block by block."""
        self._map = None
        length, kind = self._count_numbers(), np.dtype(self.patches)
        needed_bytes, free = len(references) * length * kind.itemsize, psutil.virtual_memory().available
        if needed_bytes > free:
            raise BadInput(
                f"the patches of {len(references)} reference images need {needed_bytes / 1e9:.1f} GB of memory, "
                f"{free / 1e9:.1f} GB are free: set method.configuration=storage or method.patches=float16, "
                "or take fewer images"
            )
        codes = np.empty((len(references), length), kind)
        done = 0
        for block in references.blocks(self.batch_size):
            codes[done : done + len(block)] = self.encode(block)
            done += len(block)
        return self.fit_descriptors(codes, places)

    def fit_descriptors(self, descriptors: Descriptors, places: Places) -> Self:
        """Learn the map from what `encode` gave of the references; an array is not copied but to `patches`=float16."""
        self._map = None
        codes = self._split(descriptors[:].astype(self.patches, copy=False))
        whole = unit(codes[:, 0])
        super().fit_descriptors(whole, places)
        order = np.argsort(places, kind="stable")
        self._map = Map(codes, whole, np.split(order, np.flatnonzero(np.diff(places[order])) + 1))
        return self

    def keeps_descriptors(self) -> bool:
        """Tell whether descriptors are worth keeping on disk: only if a traverse does not fill it."""
        return self.configuration == "storage"

    @property
    def code_bytes(self) -> int:
        """Bytes of the descriptors of one image and of its patches, as `encode` gives them.

        Raises BadInput for arguments that do not fit.
        """
        return self._count_numbers() * np.dtype(np.float32).itemsize

    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        """Return the cosine with the best reference image of each place, and more for the best by their patches."""
        if self._map is None:
            raise NotFittedError("PatchNetVLAD has no map yet: call fit(references, places) first")
        queries = self._split(codes)
        whole = unit(queries[:, 0])
        scores = super().match(whole).copy()
        for row, query, cue in zip(scores, queries, whole, strict=True):
            candidates = np.argsort(-row, kind="stable")[: self.candidates]
            candidates = candidates[np.isfinite(row[candidates])]
            own = [self._map.images[place] for place in candidates.tolist()]
            images = [int(of_place[(self._map.whole[of_place] @ cue).argmax()]) for of_place in own]
            row[candidates] = lift_scores(
                self._score_patches(query[1:], self._map.codes[:, 1:], images), row[candidates]
            )
        return scores

    def network(self, tensors: Tensors) -> nn.Module:
        """Return the network in the clusters of a file, of the components of the configuration."""
        clusters, _ = read_sizes(tensors, self.weights.file)
        return _PatchNetVLADNetwork(clusters, self.components[self.configuration], SETTINGS[self.configuration].sides)

    def _split(self, codes: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the descriptors in codes, first that of the image, (n_images, 1 + n_patches, n_components)."""
        return codes.reshape(len(codes), -1, self.components[self.configuration])

    def _score_patches(
        self, query: npt.NDArray[np.float32], patches: npt.NDArray[Any], images: Sequence[int]
    ) -> npt.NDArray[np.float64]:
        """Return the weighted sum of standard scores for each of the reference images, (n_images,)."""
        setting = SETTINGS[self.configuration]
        agreement = np.zeros(len(images))
        grids = self._lay_grids()
        ends = np.cumsum([len(grid) for grid in grids])
        for side, weight, grid, end in zip(setting.sides, setting.weights, grids, ends, strict=True):
            part = slice(end - len(grid), end)
            pairs = self._match_patches(query[part], (patches[image, part] for image in images))
            scores = np.array([score(setting.geometry, grid, side, of_image) for of_image in pairs])
            if np.ptp(scores) > 0:
                agreement += weight * (scores - scores.mean()) / scores.std()
        return agreement

    @torch.inference_mode()
    def _match_patches(self, query: npt.NDArray[np.float32], references: Iterator[npt.NDArray[Any]]) -> Iterator[Pairs]:
        """Yield for each image the pairs of patches that are nearest to one another, in the order of the reference.

        Those of the highest product, for all descriptors of a code have one length.
        """
        own = torch.from_numpy(np.array(query)).to(self.device)  # a copy, for arrays on disk are read-only
        for reference in references:
            products = own @ torch.from_numpy(np.array(reference)).to(self.device).float().T
            nearest, back = products.argmax(0).cpu().numpy(), products.argmax(1).cpu().numpy()
            mutual = np.flatnonzero(back[nearest] == np.arange(len(nearest)))
            yield nearest[mutual], mutual

    def _lay_grids(self) -> list[npt.NDArray[np.int64]]:
        """Return for each patch size the column and row of each patch, (n_patches, 2), row by row."""
        self._check_arguments()
        sides = SETTINGS[self.configuration].sides
        height, width = (side // STRIDE for side in self.target(0, 0))
        shapes = [(height - side + 1, width - side + 1) for side in sides]
        return [np.stack(np.divmod(np.arange(rows * columns), columns)[::-1], axis=1) for rows, columns in shapes]

    def _count_numbers(self) -> int:
        """Return how many numbers a code has: (1 + n_patches) * n_components."""
        return (1 + sum(len(grid) for grid in self._lay_grids())) * self.components[self.configuration]

    def _check_arguments(self) -> None:
        super()._check_arguments()
        if self.height is None or self.width is None:
            raise BadInput(
                f"method.height={self.height}, method.width={self.width}: give both, "
                "for PatchNetVLAD compares images of one size"
            )
        if self.candidates < 1:
            raise BadInput(f"method.candidates={self.candidates}: give at least 1 place")
        if self.components.get(self.configuration, 0) < 1:
            raise BadInput(f"method.components={dict(self.components)}: give those of {self.configuration}, at least 1")
        sides = SETTINGS[self.configuration].sides
        if min(self.target(0, 0)) // STRIDE < max(sides):
            least = max(sides) * STRIDE
            raise BadInput(
                f"method.height={self.height}, method.width={self.width}: the patches of "
                f"method.configuration={self.configuration} need at least {least}x{least} pixels"
            )


class _PatchNetVLADNetwork(Network):
    """Images (n, 3, height, width) to the unit vectors of image and patches, (n, (1 + n_patches) * n_components)."""

    def __init__(self, clusters: int, components: int, sides: tuple[int, ...]) -> None:
        super().__init__(clusters, components)
        self.sides = sides

    def forward(self, images: Tensor) -> Tensor:
        """Describe images and, one image after the other for they take much memory, their patches."""
        local, shares = self.pool.assign(self.encoder(images))
        whole = self.describe_residuals(self.pool.gather_residuals(local, shares))
        return torch.stack(
            [
                torch.cat([vector, *(vectors.flatten() for vectors in self._describe_patches(*one))])
                for vector, *one in zip(whole, local, shares, strict=True)
            ]
        )

    def _describe_patches(self, local: Tensor, shares: Tensor) -> Iterator[Tensor]:
        """Yield the descriptors of the patches of each size, (n_patches, n_components), row by row."""
        residuals = local - self.pool.centroids.float()[:, :, None, None]  # (clusters, channels, h, w)
        residuals *= shares[:, None]
        for side in self.sides:
            means = functional.avg_pool2d(functional.avg_pool2d(residuals, (side, 1), 1), (1, side), 1)
            yield self.describe_residuals(means.flatten(2).permute(2, 0, 1))


def score(geometry: Geometry, grid: npt.NDArray[np.int64], side: int, pairs: Pairs) -> float:
    """Return how well pairs of patches fit together, 0 or more. `grid` is (n_patches, 2).

    Fewer than 4 pairs have no homography and score 0; of displacements one pair is enough.
    """
    query, reference = (grid[ends] for ends in pairs)
    if len(query) < (4 if geometry == "homography" else 1):
        return 0.0
    if geometry == "homography":
        return count_inliers(find_centres(query, side), find_centres(reference, side)) / len(grid)
    displacements = reference - query
    residuals = np.abs(displacements - displacements.mean(0))
    return float(((grid.max(0) - residuals) ** 2).sum() / len(grid))


def find_centres(cells: npt.NDArray[np.int64], side: int) -> npt.NDArray[np.float32]:
    """Return the middle of what patches see of the image, whole pixels, (n, 2), from their first columns and rows."""
    first = STRIDE * cells - _PADDING
    last = first + STRIDE * (side - 1) + _RECEPTIVE_FIELD - 1
    return np.trunc((first + last) / 2).astype(np.float32)


def count_inliers(query: npt.NDArray[np.float32], reference: npt.NDArray[np.float32]) -> int:
    """Return how many points (n, 2) of the reference one homography takes to within 24 pixels of the query's."""
    cv2.setRNGSeed(0)  # the answer must not depend on earlier queries
    _, fitting = cv2.findHomography(reference, query, cv2.RANSAC, _TOLERANCE)
    return 0 if fitting is None else int(np.count_nonzero(fitting))


def lift_scores(agreement: npt.NDArray[np.float64], cosines: Scores) -> Scores:
    """Return scores of candidates, all above any cosine, in the order of their agreement and then of their cosine.

    A standard score among n is at least -sqrt(n - 1), so that the sum with 2 + sqrt(n - 1) is at least 2.
    """
    if not len(agreement):
        return cosines
    order = np.lexsort((cosines, agreement))
    scores = (agreement[order] + 2 + math.sqrt(len(agreement) - 1)).astype(np.float32)
    for i, (before, after) in enumerate(itertools.pairwise(order), 1):
        equal = agreement[before] == agreement[after] and cosines[before] == cosines[after]
        scores[i] = scores[i - 1] if equal else max(scores[i], np.nextafter(scores[i - 1], np.float32(np.inf)))
    result = np.empty_like(scores)
    result[order] = scores
    return result

"""Patch-NetVLAD's network: NetVLAD of an image, and of all square patches of its local descriptors."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor
from torch.nn import functional

from ..netvlad import Network


class PatchNetwork(Network):
    """Images (n, 3, height, width) to the unit vectors of image and patches, (n, (1 + n_patches) * n_components).

    `integral` sums patches as the public code does: as differences of an integral image in float32.
    """

    def __init__(self, clusters: int, components: int, sides: tuple[int, ...], *, integral: bool = False) -> None:
        super().__init__(clusters, components)
        self.sides = sides
        self.integral = integral

    def forward(self, images: Tensor) -> Tensor:
        """Describe images and, one image after the other for they take much memory, their patches."""
        local, shares = self.pool.assigned(self.encoder(images))
        whole = self.described(self.pool.gathered(local, shares))
        return torch.stack(
            [
                torch.cat([vector, *(vectors.flatten() for vectors in self._parts(*one))])
                for vector, *one in zip(whole, local, shares, strict=True)
            ]
        )

    def _parts(self, local: Tensor, shares: Tensor) -> Iterator[Tensor]:
        """Yield the descriptors of the patches of each size, (n_patches, n_components), row by row."""
        residuals = local - self.pool.centroids.float()[:, :, None, None]  # (clusters, channels, h, w)
        residuals *= shares[:, None]
        means = _means_by_differences if self.integral else _means
        for patches in means(residuals, self.sides):
            yield self.described(patches.flatten(2).permute(2, 0, 1))


def _means(maps: Tensor, sides: tuple[int, ...]) -> Iterator[Tensor]:
    """Yield for each side the means of square patches of maps (clusters, channels, h, w)."""
    for side in sides:
        yield functional.avg_pool2d(functional.avg_pool2d(maps, (side, 1), 1), (1, side), 1)


def _means_by_differences(maps: Tensor, sides: tuple[int, ...]) -> Iterator[Tensor]:
    """Yield what `_means` yields, as it is rounded by a float32 integral image over the whole maps."""
    flat = maps.flatten(0, 1)
    integral = functional.pad(flat.cumsum(2).cumsum(1), (1, 0, 1, 0))
    corners = flat.new_tensor([[1, -1], [-1, 1]]).expand(len(flat), 1, 2, 2)
    for side in sides:
        sums = functional.conv2d(integral, corners, groups=len(flat), dilation=side)
        yield (sums / side**2).reshape(*maps.shape[:2], *sums.shape[1:])

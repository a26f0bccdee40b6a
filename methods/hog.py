"""Histograms of oriented gradients: one hand-made descriptor of the whole image, as in VPR-Bench."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import cv2
import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, DescriptorMethod, Images, count_operations

from .parts.checks import require_arguments

_INTERPOLATIONS = {"linear": cv2.INTER_LINEAR, "area": cv2.INTER_AREA}

# A normalised block's largest number, before it is normalised again. No argument: OpenCV (4.14) keeps the value of the
# first descriptor that a process computes for most bins of all later ones.
_CLIP = 0.2


@dataclass
class HOG(DescriptorMethod):
    """Describes an image by the orientations of its edges, block by block; a score is a cosine, 0 to 1.

    Source: VPR-Bench (77ad30f), `HOG_VPR.py`: its five sizes, OpenCV's defaults for the rest, OpenCV's computation on
    a BGR image. At each pixel the colour channel with the strongest gradient counts, of equally strong ones blue.
    With the defaults a descriptor has 35,721 numbers (140 KiB). An image without any edge has the zero vector, which
    scores 0 everywhere (VPR-Bench: 0 / 0).
    """

    conformance_arguments: ClassVar[Mapping[str, Any]] = {"height": 96, "width": 96}

    height: int = 512  # pixels that every image is resized to
    width: int = 512
    interpolation: Literal["linear", "area"] = "linear"  # area: antialiased if images are larger
    block: int = 16  # pixels; its histograms are normalised together
    stride: int = 8  # pixels from one block to the next
    cell: int = 16  # pixels; each has a histogram
    bins: int = 9  # orientations a histogram
    signed: bool = False  # whether orientations run over 360 degrees, not 180
    gamma: bool = False  # whether the square root of the levels is taken first
    sigma: float | None = None  # pixels, of a block's Gaussian weights; None: block / 4

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        """Return unit vectors, (n_images, blocks * cells of a block * bins), one image in memory at a time.

        Raises BadInput if blocks do not fill the image or cells a block.
        """
        hog = self._make_descriptor()
        size, interpolation = (self.width, self.height), _INTERPOLATIONS[self.interpolation]
        codes = np.empty((len(images), hog.getDescriptorSize()), np.float32)
        # A pixel: resized, lengths in each channel, votes for two bins in up to four cells of each block that it is in.
        votes = 2 * min(4, (self.block // self.cell) ** 2) * (self.block / self.stride) ** 2
        pixels = len(images) * self.height * self.width
        count_operations(
            pixels * (3 * 4 + 3 * 2 + votes) + 3 * codes.size, pixels * 10 + 4 * codes.size
        )  # normalised three times
        for code, image in zip(codes, images, strict=True):
            resized = cv2.resize(image, size, interpolation=interpolation)
            code[:] = hog.compute(cv2.cvtColor(resized, cv2.COLOR_RGB2BGR))
            code /= max(float(np.linalg.norm(code)), 1e-12)
        return codes

    def _make_descriptor(self) -> cv2.HOGDescriptor:
        self._check_arguments()
        return cv2.HOGDescriptor(
            (self.width, self.height),
            (self.block, self.block),
            (self.stride, self.stride),
            (self.cell, self.cell),
            self.bins,
            _derivAperture=1,
            _winSigma=self.block / 4 if self.sigma is None else self.sigma,
            _histogramNormType=cv2.HOGDESCRIPTOR_L2HYS,
            _L2HysThreshold=_CLIP,
            _gammaCorrection=self.gamma,
            _signedGradient=self.signed,
        )

    def _check_arguments(self) -> None:
        """Raise BadInput for arguments under which OpenCV has no descriptor."""
        require_arguments(
            self,
            cell=(self.cell >= 1, "at least 1 pixel"),
            stride=(self.stride >= 1, "at least 1 pixel"),
            bins=(1 <= self.bins <= 255, "1 to 255"),
            sigma=(self.sigma is None or self.sigma > 0, "more than 0 pixels"),
        )
        if self.block < 1 or self.block % self.cell:
            raise BadInput(f"method.block={self.block}: give a multiple of method.cell={self.cell}")
        for name in ("height", "width"):
            if (length := getattr(self, name)) < self.block or (length - self.block) % self.stride:
                raise BadInput(
                    f"method.{name}={length}: blocks have to fill the image, "
                    f"give method.block={self.block} plus a multiple of method.stride={self.stride}"
                )

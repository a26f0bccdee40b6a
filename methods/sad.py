"""Sum of absolute differences: the pixels of two patch-normalised frames, subtracted."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
import numpy.typing as npt
import torch

from vprbench.images import Images
from vprbench.interface import Method, NotFittedError, Places, Scores, best_image_of_place
from vprbench.preprocess import PatchNormalisation, Variant


@dataclass
class SAD(Method):
    """Scores a place by minus the mean absolute difference in grey levels to its most similar reference image.

    Source: VPRTempo paper, section "Baseline methods"; preprocessing as the authors' own SAD (a41ba92).
    """

    preprocessing: Variant = "C"
    height: int = 28  # pixels
    width: int = 28
    patch: int = 7
    device: str = "cpu"

    _references: torch.Tensor | None = field(default=None, init=False, repr=False, compare=False)

    def fit(self, references: Images, places: Places) -> Self:
        """Keep the preprocessed references."""
        self._references = self._to_device(self.encode(references))
        self._places = places.copy()
        return self

    def encode(self, images: Images) -> npt.NDArray[np.uint8]:
        """Return the preprocessed pixels, (n_images, height * width), levels 0..255."""
        return PatchNormalisation(self.preprocessing, self.height, self.width, self.patch)(images)

    def match(self, codes: npt.NDArray[np.uint8]) -> Scores:
        """Return (n_queries, n_places) in grey levels, -255 to 0."""
        if self._references is None:
            raise NotFittedError("SAD has no map yet: call fit(references, places) first")
        # Sums of up to 65,793 whole levels are exact in float32, so neither batch nor order can change them.
        total = torch.cdist(self._to_device(codes), self._references, p=1)
        return best_image_of_place((total / -codes.shape[1]).cpu().numpy(), self._places)

    def _to_device(self, levels: npt.NDArray[np.uint8]) -> torch.Tensor:
        return torch.from_numpy(levels).to(self.device, torch.float32)

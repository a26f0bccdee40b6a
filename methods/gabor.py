"""A bank of Gabor filters over patch-normalised frames: a hand-made descriptor of local waves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vprbench.api import DescriptorMethod, Images

from .parts.filters.gabor import GaborBank


@dataclass
class Gabor(DescriptorMethod):
    """Describes an image by the responses of 32 Gabor filters in every 2x2 pixels; a score is a cosine.

    Source: the front end of lrp-666/VPRTempo (30635ee), `GaborBank`, without a network behind it. With the defaults a
    descriptor has 13,440 numbers (53 KiB). An image of one level has the zero vector, which scores 0 everywhere.
    """

    height: int = 32  # pixels
    width: int = 64
    patch: int = 11  # pixels, of the patch normalisation
    normalised: bool = True  # False: the responses as they are, with their signs
    block: int = 5  # cells, by whose energy responses are normalised
    epsilon: float = 0.1  # in shares of the grey levels

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        """Return unit vectors, (n_images, cells * 32)."""
        bank = GaborBank(self.height, self.width, self.patch, self.block, self.epsilon)
        codes = bank(images) if self.normalised else bank.compute_responses(images).reshape(len(images), bank.n_inputs)
        codes /= np.maximum(np.linalg.norm(codes, axis=1, keepdims=True), 1e-12)
        return codes

"""The colours of a coarse grid of cells as descriptor."""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from vprbench.api import DescriptorMethod, Images


@dataclass
class Thumbnail(DescriptorMethod):
    """Describes an image by the mean-free colours of `cells` x `cells` cells."""

    cells: int = 8

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        """Return unit vectors, (n_images, 3 * cells**2)."""
        small = [cv2.resize(image, (self.cells, self.cells), interpolation=cv2.INTER_AREA) for image in images]
        vectors = np.stack(small).reshape(len(small), -1).astype(np.float32)
        vectors -= vectors.mean(1, keepdims=True)
        return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-12)

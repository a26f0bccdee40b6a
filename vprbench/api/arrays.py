"""The arrays that harness and plug-ins exchange, by name and shape."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.uint8]  # (height, width, 3), RGB
Places = npt.NDArray[np.int64]  # (n_references,), the place that each reference image shows
Descriptors = npt.NDArray[np.float32]  # (n_images, n_dimensions); memory-mapped if they fill more than 1 GiB
Scores = npt.NDArray[np.float32]  # (n_queries, n_places), higher means more alike; -inf: no candidate

"""Arrays that grow at their end, and the numbers that new places have."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Places
from vprbench.errors import BadInput


class Growing:
    """Rows (n, ...) with room behind them that doubles when it is full; what was taken of them stays as it is."""

    def __init__(self, rows: npt.NDArray[Any]) -> None:
        """Begin with rows that are never written to."""
        self._room, self._n = rows, len(rows)

    @property
    def rows(self) -> npt.NDArray[Any]:
        """All rows, as one view."""
        return self._room[: self._n]

    def append(self, more: npt.NDArray[Any]) -> None:
        """Add rows of the same type and shape at the end."""
        n = self._n + len(more)
        if n > len(self._room):
            room = np.empty((max(n, 2 * self._n), *self._room.shape[1:]), self._room.dtype)
            room[: self._n] = self.rows
            self._room = room
        self._room[self._n : n] = more
        self._n = n


def require_new_places(places: Places, n_images: int, n_known: int) -> None:
    """Raise BadInput unless `places` (n_images,) are the numbers from `n_known` on, each at least once."""
    numbers = np.unique(places)
    if len(places) != n_images or not n_images or not np.array_equal(numbers, n_known + np.arange(len(numbers))):
        came = f"places {numbers[:3].tolist()} and so on, {len(places)} in all, came of {n_images} new images"
        raise BadInput(f"{came}: give the place of each, from {n_known} on without a gap")

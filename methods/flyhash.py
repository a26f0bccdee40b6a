"""FlyHash: sparse binary codes of patch-normalised frames, made as a fly's olfactory circuit makes them of smells."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Self

import numpy as np
import numpy.typing as npt
from scipy import sparse

from vprbench.api import Images, Method, NotFittedError, Places, Scores, best_image_of_place, count_operations

from .parts.checks import require_arguments
from .parts.filters.patches import PatchNormalisation, Variant

Winners = npt.NDArray[np.int32]  # (n_images, winners): numbers of units, ascending; -1 where fewer units fire

_TOGETHER = 256  # images whose units are summed together: bounds the memory


@dataclass
class FlyHash(Method):
    """Scores a place by the share of winning units that its most similar image has in common with the query, 0 to 1.

    Each unit sums a few pixels, drawn by `seed`; the frame's mean is subtracted from each of them; of the units above
    0 the `winners` largest fire (of equal ones the first), the others are silent. So a frame without contrast scores 0.
    Source: Dasgupta, Stevens and Navlakha, "A neural algorithm for a fundamental computing problem" (Science 2017):
    10 units a pixel, each sums a tenth of the pixels, 5 % win. Smells there are patch-normalised pixels here.
    """

    preprocessing: Variant = "C"
    height: int = 28  # pixels
    width: int = 28
    patch: int = 7
    units: int = 7840
    summed: int = 78  # pixels, by each unit
    winners: int = 392
    seed: int = 0

    _map: tuple[sparse.csr_array, Places] | None = field(default=None, init=False, repr=False, compare=False)

    def fit(self, references: Images, places: Places) -> Self:
        """Keep for every unit the references in which it wins, (units, n_references), and their places."""
        self._map = None
        self._map = sparse.csr_array(self._mark_firing(self.encode(references)).T), places.copy()
        return self

    def encode(self, images: Images) -> Winners:
        """Return the winners of each image, (n_images, winners), ascending, -1 in place of those that do not fire.

        Raises BadInput for sizes that do not fit one another.
        """
        self._check_arguments()
        levels = PatchNormalisation(self.preprocessing, self.height, self.width, self.patch)(images)
        sampling = _draw_sampling(self.units, levels.shape[1], self.summed, self.seed)
        winners = np.empty((len(levels), self.winners), np.int32)
        for start in range(0, len(levels), _TOGETHER):
            block = slice(start, start + _TOGETHER)
            winners[block] = self._choose_winners(levels[block], sampling)
        return winners

    def _choose_winners(self, levels: npt.NDArray[np.uint8], sampling: sparse.csr_array) -> Winners:
        count_operations(single=len(levels) * self.units * self.summed, kind="int64")
        pixels = np.ascontiguousarray(levels.T, np.int64)  # whole numbers: no rounding decides between two units
        above = (sampling @ pixels).T * len(pixels) - self.summed * pixels.sum(0)[:, None]  # (n_images, units)
        ranked = above * self.units + np.arange(self.units)[::-1]  # all differ: of equal units the first is larger
        best = np.argpartition(ranked, -self.winners, axis=1)[:, -self.winners :]
        fires = np.take_along_axis(above, best, axis=1) > 0
        return np.sort(np.where(fires, best, -1), axis=1).astype(np.int32)

    def match(self, codes: Winners) -> Scores:
        """Return the share of the `winners` that the best image of each place has too, (n_queries, n_places)."""
        if self._map is None:
            raise NotFittedError("FlyHash has no map yet: call fit(references, places) first")
        references, places = self._map
        # A unit has won in so many references.
        count_operations(single=np.diff(references.indptr)[codes[codes >= 0]].sum())
        common = (self._mark_firing(codes) @ references).toarray() / np.float32(self.winners)
        return best_image_of_place(common, places)

    def _mark_firing(self, winners: Winners) -> sparse.csr_array:
        """Return 1 for every unit that fires, else 0, (n_images, units)."""
        fires = winners >= 0
        ends = np.concatenate(([0], np.cumsum(fires.sum(1))))
        return sparse.csr_array((np.ones(ends[-1], np.float32), winners[fires], ends), (len(winners), self.units))

    def _check_arguments(self) -> None:
        n_pixels = self.height * self.width
        require_arguments(
            self,
            units=(self.units >= 1, "at least 1"),
            summed=(1 <= self.summed <= n_pixels, f"1 to the {n_pixels} pixels of a frame"),
            winners=(1 <= self.winners <= self.units, f"1 to method.units={self.units}"),
        )


@lru_cache(maxsize=4)
def _draw_sampling(n_units: int, n_pixels: int, n_summed: int, seed: int) -> sparse.csr_array:
    """Draw which pixels each unit sums, (n_units, n_pixels): 1 for each of `n_summed` of them, else 0."""
    generator = np.random.default_rng(seed)
    chosen = [np.sort(generator.choice(n_pixels, n_summed, replace=False)) for _ in range(n_units)]
    starts = np.arange(n_units + 1) * n_summed
    return sparse.csr_array(
        (np.ones(n_units * n_summed, np.int64), np.concatenate(chosen), starts), (n_units, n_pixels)
    )

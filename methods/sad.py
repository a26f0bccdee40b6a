"""Sum of absolute differences: the pixels of two small frames, patch-normalised or grey, subtracted."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

import numpy as np
import numpy.typing as npt
import torch
from numba import types

from vprbench.api import (
    Growing,
    Images,
    Method,
    NotFittedError,
    Places,
    Scores,
    best_image_of_place,
    compiled,
    count_operations,
    in_shares,
    require_new_places,
)

from .parts.filters.patches import Preprocessing, pixels

Levels = npt.NDArray[np.uint8]  # (n_images, n_pixels)

_TILE = 1 << 16  # bytes of references that stay in the cache while every query passes over them
_CHUNK = 1 << 22  # pixels whose differences cannot overflow 32 bits
_WORTH_A_THREAD = 1 << 25  # differences: about 0.8 ms of work, against 0.2 ms to start a thread and wait for it
_SHARES = 4  # a thread: whoever is ready first takes the next


@dataclass
class SAD(Method):
    """Scores a place by minus the mean absolute difference in grey levels to its most similar reference image.

    Source: VPRTempo paper, section "Baseline methods"; preprocessing as the authors' own SAD (a41ba92).
    """

    preprocessing: Preprocessing = "C"
    height: int = 28  # pixels
    width: int = 28
    patch: int = 7
    device: str = "cpu"

    _references: Growing | torch.Tensor | None = field(default=None, init=False, repr=False, compare=False)

    def fit(self, references: Images, places: Places) -> Self:
        """Keep the preprocessed references."""
        levels = self.encode(references)
        on_cpu = torch.device(self.device).type == "cpu"
        self._references = Growing(np.ascontiguousarray(levels)) if on_cpu else self._move_to_device(levels)
        self._places = Growing(places.copy())
        return self

    def extend(self, references: Images, places: Places) -> Self:
        """Append the preprocessed references of new places."""
        known = self._require_references()
        require_new_places(places, len(references), int(self._places.rows.max()) + 1)
        levels = self.encode(references)
        if isinstance(known, Growing):
            known.append(levels)
        else:
            self._references = torch.cat([known, self._move_to_device(levels)])
        self._places.append(places)
        return self

    def encode(self, images: Images) -> Levels:
        """Return the preprocessed pixels, (n_images, height * width), levels 0..255."""
        return pixels(images, self.preprocessing, self.height, self.width, self.patch)

    def match(self, codes: Levels) -> Scores:
        """Return (n_queries, n_places) in grey levels, -255 to 0."""
        known = self._require_references()
        shape = known.rows.shape if isinstance(known, Growing) else known.shape
        count_operations(single=3.0 * len(codes) * np.prod(shape), kind="int8")  # subtract, drop the sign, add
        if isinstance(known, Growing):
            return best_image_of_place(_compare_all(codes, known.rows), self._places.rows)
        # Sums of up to 65,793 whole levels are exact in float32, so neither batch nor order can change them.
        total = torch.cdist(self._move_to_device(codes), known, p=1)
        return best_image_of_place((total / -codes.shape[1]).cpu().numpy(), self._places.rows)

    def _require_references(self) -> Growing | torch.Tensor:
        if self._references is None:
            raise NotFittedError("SAD has no map yet: call fit(references, places) first")
        return self._references

    def map_bytes(self) -> int | None:
        """Return the bytes of the references."""
        known = self._references
        return None if known is None else (known.rows if isinstance(known, Growing) else known).nbytes

    def _move_to_device(self, levels: Levels) -> torch.Tensor:
        return torch.from_numpy(levels).to(self.device, torch.float32)


def _compare_all(codes: Levels, references: Levels) -> Scores:
    """Return minus the mean absolute differences, (n_queries, n_references), threads sharing the references."""
    n_references, n_pixels = references.shape
    if codes.dtype != np.uint8 or codes.ndim != 2 or codes.shape[1] != n_pixels:
        raise ValueError(f"codes of {codes.dtype} {codes.shape} came; this map compares uint8 (n_queries, {n_pixels})")
    codes = np.ascontiguousarray(codes)
    similarity = np.empty((len(codes), n_references), np.float32)
    worth = len(codes) * references.size // _WORTH_A_THREAD
    n_threads = min(torch.get_num_threads(), worth)
    if n_threads > 1:
        in_shares(
            lambda own: _compare(codes, references, own.start, own.stop, similarity), n_references, n_threads, _SHARES
        )
    else:
        _compare(codes, references, 0, n_references, similarity)
    return similarity


@compiled()
def _sum_differences(left, right):  # type: ignore[no-untyped-def]
    # In 32 bits throughout LLVM takes the processor's own sum of absolute differences (x86: psadbw); numba's 64 bits,
    # or max - min, cost 1.5 to 3 times as much.
    total = np.int32(0)
    for i in range(len(left)):
        difference = np.int32(np.int32(left[i]) - np.int32(right[i]))
        total = np.int32(total + np.int32(abs(difference)))
    return total


_LEVELS = types.Array(types.uint8, 2, "C", readonly=True)  # takes those that may be written to as well


@compiled(_LEVELS, _LEVELS, types.int64, types.int64, types.float32[:, ::1])
def _compare(codes, references, first, last, similarity):  # type: ignore[no-untyped-def]
    """Write the columns `first` to `last` of `similarity`; codes of one chunk are rounded once."""
    n_pixels = references.shape[1]
    rows = max(1, _TILE // max(1, n_pixels))
    for start in range(first, last, rows):
        end = min(start + rows, last)
        for query in range(len(codes)):
            for row in range(start, end):
                similarity[query, row] = -0.0
            for chunk in range(0, n_pixels, _CHUNK):
                code = codes[query, chunk : chunk + _CHUNK]
                for row in range(start, end):
                    total = _sum_differences(code, references[row, chunk : chunk + _CHUNK])
                    similarity[query, row] += np.float64(total) / -n_pixels

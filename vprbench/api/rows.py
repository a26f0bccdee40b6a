"""Exact inner products with a few vectors of a large map, read where they lie."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from llvmlite import ir
from numba import carray, types  # type: ignore[attr-defined]
from numba.extending import intrinsic

from vprbench.api.compiling import compiled
from vprbench.api.threads import in_shares
from vprbench.storage.shards import Shards

Vectors = npt.NDArray[np.float32]  # (n_images, n_dimensions)
Numbers = npt.NDArray[np.int64]

_WORTH_A_THREAD = 1 << 19  # numbers multiplied: about 0.2 ms


class Rows:
    """Vectors in shards, each mapped when it is first needed and from then on: to map one takes longer than to read."""

    def __init__(self, vectors: Shards) -> None:
        """Map none yet."""
        self._vectors = vectors
        self._mapped: dict[int, Vectors] = {}
        self._addresses = np.zeros(len(vectors.pieces), np.uint64)
        self._each = vectors.each

    def products(self, codes: Vectors, queries: Numbers, images: Numbers) -> Vectors:
        """Return the inner products of pairs of a query and an image, given by their numbers, (n_pairs,).

        They are summed in float64 and then rounded, so equal vectors give equal bits wherever they lie.
        """
        for number in np.unique(images // self._each).tolist():
            if number not in self._mapped:
                rows = self._mapped[number] = np.ascontiguousarray(self._vectors.pieces[number].rows())
                self._addresses[number] = rows.ctypes.data
        found = np.empty(len(images), np.float32)
        threads = min(torch.get_num_threads(), len(images) * codes.shape[1] // _WORTH_A_THREAD)
        whole = np.ascontiguousarray(codes), np.ascontiguousarray(queries), np.ascontiguousarray(images)

        def sum_some(own: slice) -> None:
            _sum(self._addresses, self._each, whole[0], whole[1][own], whole[2][own], found[own])

        in_shares(sum_some, len(images), threads)
        return found


@intrinsic
def _floats_at(typing_context, address):  # type: ignore[no-untyped-def]
    """Return a pointer to the numbers at an address."""
    del typing_context, address

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        del context, signature
        return builder.inttoptr(arguments[0], ir.FloatType().as_pointer())

    return types.CPointer(types.float32)(types.uint64), generate  # type: ignore[no-untyped-call]


@compiled(
    types.uint64[::1],
    types.int64,
    types.Array(types.float32, 2, "C", readonly=True),
    types.Array(types.int64, 1, "C", readonly=True),
    types.Array(types.int64, 1, "C", readonly=True),
    types.float32[::1],
    fastmath={"reassoc", "contract"},
)
def _sum(addresses: Any, each: Any, codes: Any, queries: Any, images: Any, found: Any) -> None:
    """Write the inner product of each pair to `found`; an address is that of `each` vectors."""
    n_dimensions = codes.shape[1]
    for pair in range(len(images)):
        shard, row = divmod(images[pair], each)
        vector = carray(_floats_at(addresses[shard] + np.uint64(4 * n_dimensions * row)), (n_dimensions,))  # type: ignore[call-arg]
        code = codes[queries[pair]]
        total = 0.0
        for k in range(n_dimensions):
            total += np.float64(vector[k]) * np.float64(code[k])
        found[pair] = total

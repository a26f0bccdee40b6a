"""Regions compared with regions: the mean over a query's regions of the cosine with the best region of a reference."""

from __future__ import annotations

import math
from concurrent.futures import ThreadPoolExecutor
from itertools import chain, pairwise

import numpy as np
import numpy.typing as npt
import torch
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from vprbench.api import compiled, takes

Regions = npt.NDArray[np.float32]  # (n_regions, d)
Tiles = npt.NDArray[np.float32]  # (n_references, n_tiles, d, TILE): regions of a reference side by side

_PRODUCT_BYTES = 256 << 20  # of the similarities that an accelerator holds at a time
# 12 sums of one vector register each, 2 registers of references and 1 of the query fit 16 registers, AVX2's.
_LANES = 16 if binding.get_host_cpu_features().get("avx512f") else 8  # float32 in the widest register
_ROWS = 6  # regions of the query whose sums are in registers
_VECTORS = 2  # of regions of a reference, with each of those rows
TILE = _VECTORS * _LANES
_SHARES = 4  # of the references for each thread: whoever is ready first takes the next
_FLOAT, _INT64 = ir.FloatType(), ir.IntType(64)
_VECTOR = ir.VectorType(_FLOAT, _LANES)
_FUSED = ("contract",)  # multiply and add at once, where the processor can


def mean_best_cosine(query: torch.Tensor, references: torch.Tensor) -> torch.Tensor:
    """Return for each reference (n_references, n_regions, d) the mean over the query's regions (n, d) of the best dot.

    The references are taken in blocks, so that memory stays bounded.
    """
    block = max(1, _PRODUCT_BYTES // (4 * references.shape[1] * len(query)))
    return torch.cat([(own @ query.T).amax(1).mean(1) for own in torch.split(references, block)])


def mean_best_cosine_in_tiles(query: Regions, references: Tiles) -> npt.NDArray[np.float32]:
    """Return what `mean_best_cosine` does, (n_references,), in threads that keep the products in registers."""
    takes(float(len(query)) * references.size)
    rows = np.zeros((-(-len(query) // _ROWS) * _ROWS, query.shape[1]), np.float32)  # those of padding add 0
    rows[: len(query)] = query
    references = np.ascontiguousarray(references)
    total = np.empty(len(references), np.float32)
    n_threads = max(1, min(torch.get_num_threads(), len(references)))
    ends = [len(references) * share // (_SHARES * n_threads) for share in range(_SHARES * n_threads + 1)]
    with ThreadPoolExecutor(n_threads) as threads:
        list(threads.map(lambda share: _write_totals(rows, references, *share, total), pairwise(ends)))
    return total / np.float32(len(query))


def in_tiles(regions: Regions) -> Tiles:
    """Return the regions (n_regions, d) of one reference as (n_tiles, d, TILE), the last one repeated to the end."""
    padded = np.pad(regions, ((0, -len(regions) % TILE), (0, 0)), mode="edge")
    return np.ascontiguousarray(padded.reshape(-1, TILE, regions.shape[1]).swapaxes(1, 2))


def from_tiles(tiles: Tiles, n_regions: int) -> npt.NDArray[np.float32]:
    """Return the regions of all references as they were, (n_references, n_regions, d)."""
    n_references, n_tiles, n_dimensions, width = tiles.shape
    regions = tiles.swapaxes(2, 3).reshape(n_references, n_tiles * width, n_dimensions)
    return np.ascontiguousarray(regions[:, :n_regions])


@intrinsic
def _total_of_best(typing_context, rows, tiles):  # type: ignore[no-untyped-def]
    """Return the sum over _ROWS rows (_ROWS, d) of the best dot with a region in the tiles (n_tiles, d, TILE).

    Spelt out in vectors: from the same loops over numbers LLVM makes code that takes 20 times as long.
    """
    del typing_context

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        arrays = zip(signature.args, arguments, strict=True)
        query, reference = (context.make_array(kind)(context, builder, value) for kind, value in arrays)
        n_tiles, n_dimensions, _ = cgutils.unpack_tuple(builder, reference.shape)  # type: ignore[no-untyped-call]
        best = [_variable(builder) for _ in range(_ROWS)]
        dots = [[_variable(builder) for _ in range(_VECTORS)] for _ in range(_ROWS)]
        for top in best:
            builder.store(_VECTOR([-math.inf] * _LANES), top)
        with cgutils.for_range(builder, n_tiles) as tile:
            for dot in chain(*dots):
                builder.store(_VECTOR([0.0] * _LANES), dot)
            tile_row = builder.mul(tile.index, n_dimensions)
            with cgutils.for_range(builder, n_dimensions) as dimension:
                place = builder.mul(builder.add(tile_row, dimension.index), _INT64(TILE))
                theirs = [_vector_at(builder, reference.data, place, lane) for lane in range(0, TILE, _LANES)]
                for row, own in enumerate(dots):
                    place = builder.add(builder.mul(_INT64(row), n_dimensions), dimension.index)
                    ours = _in_all_lanes(builder, builder.load(builder.gep(query.data, [place])))
                    for dot, their in zip(own, theirs, strict=True):
                        product = builder.fmul(ours, their, flags=_FUSED)
                        builder.store(builder.fadd(builder.load(dot), product, flags=_FUSED), dot)
            for top, own in zip(best, dots, strict=True):
                builder.store(_largest(builder, [builder.load(value) for value in (top, *own)]), top)
        total = _FLOAT(0.0)
        for vector in [builder.load(top) for top in best]:
            lanes = [builder.extract_element(vector, _INT64(lane)) for lane in range(_LANES)]
            total = builder.fadd(total, _largest(builder, lanes))
        return total

    return types.float32(rows, tiles), generate


def _variable(builder: ir.IRBuilder) -> ir.Value:
    """Make room for a vector; LLVM turns it into a register."""
    return cgutils.alloca_once(builder, _VECTOR)  # type: ignore[no-untyped-call]


def _vector_at(builder: ir.IRBuilder, numbers: ir.Value, place: ir.Value, lane: int) -> ir.Value:
    start = builder.gep(numbers, [builder.add(place, _INT64(lane))])
    return builder.load(builder.bitcast(start, _VECTOR.as_pointer()), align=4)


def _in_all_lanes(builder: ir.IRBuilder, number: ir.Value) -> ir.Value:
    nothing = _VECTOR(ir.Undefined)
    one = builder.insert_element(nothing, number, _INT64(0))
    return builder.shuffle_vector(one, nothing, ir.VectorType(ir.IntType(32), _LANES)([0] * _LANES))


def _largest(builder: ir.IRBuilder, values: list[ir.Value]) -> ir.Value:
    """Return the largest of numbers, or of vectors in each lane."""
    largest, *others = values
    for value in others:
        largest = builder.select(builder.fcmp_ordered(">", value, largest), value, largest)
    return largest


@compiled()
def _write_totals(rows, references, first, last, total):  # type: ignore[no-untyped-def]
    """Write the numbers `first` to `last` of `total`: the sum over the rows of the best dot with the reference."""
    for number in range(first, last):
        summed = 0.0
        for start in range(0, len(rows), _ROWS):
            summed += _total_of_best(rows[start : start + _ROWS], references[number])  # type: ignore[call-arg]
        total[number] = summed


# Compiled now, or read from the cache: no query waits for it.
_write_totals(np.zeros((_ROWS, 1), np.float32), np.zeros((1, 1, 1, TILE), np.float32), 0, 0, np.zeros(1, np.float32))

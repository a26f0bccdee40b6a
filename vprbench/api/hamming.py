"""Bits packed into words, and Hamming distances between them: each query compared with all references.

Compiled for vectors of 8 words: carry-save adders sum 8 words at a time into planes of ones, twos and fours, so that
one word in 8 has its bits counted (Harley and Seal). faiss.IndexBinaryFlat counts every word, one after another: a
sixth of the queries a second, and its complete scores take three times as long again.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from vprbench.api.arrays import Scores
from vprbench.api.compiling import compiled
from vprbench.api.threads import in_shares

Words = npt.NDArray[np.uint64]  # (n_images, n_words): bits packed, in any order that all share

_LANES = 8  # references side by side: 64 bits of each fill the widest registers
_GROUP = 8  # words that are summed before bits are counted
_TILE = 1 << 15  # bytes of references that stay in the nearest cache while every query passes over them
_WORTH_A_THREAD = 1 << 20  # words compared: about 0.2 ms
_SHARES = 4  # a thread: whoever is ready first takes the next
_INT64 = ir.IntType(64)
_VECTOR = ir.VectorType(_INT64, _LANES)


def packed(bits: npt.NDArray[Any]) -> Words:
    """Return truth values (n_images, n_bits) as words of 64 bits, (n_images, n_words), zeros at the end."""
    missing = -bits.shape[1] % 64
    return np.packbits(np.pad(bits.astype(bool), ((0, 0), (0, missing))), axis=1).view(np.uint64)


def in_blocks(codes: Words) -> Words:
    """Return a copy of references (n, n_words) in blocks of 8 side by side, as `similarity` takes them; 0 fills up."""
    padded = np.pad(codes, ((0, -len(codes) % _LANES), (0, 0)))
    return np.ascontiguousarray(padded.reshape(-1, _LANES, padded.shape[1]).swapaxes(1, 2))


def similarity(codes: Words, blocks: Words) -> Scores:
    """Return minus the bits in which codes (n_queries, n_words) and references differ, (n_queries, n_blocks * 8)."""
    n_blocks = len(blocks)
    scores = np.empty((len(codes), n_blocks * _LANES), np.float32)
    queries = np.ascontiguousarray(codes)
    threads = min(torch.get_num_threads(), len(codes) * blocks.size // _WORTH_A_THREAD)
    in_shares(lambda own: _compare(queries, blocks, scores, own.start, own.stop), n_blocks, threads, _SHARES)
    return scores


@intrinsic
def _write_similarity(typing_context, query, block, similarity):  # type: ignore[no-untyped-def]
    """Write minus the differing bits of a query (n_words,) and a block (n_words, _LANES) to `similarity` (_LANES,).

    Spelt out in vectors: from the same loops over words LLVM makes code that takes twice as long.
    """
    del typing_context

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        arrays = zip(signature.args, arguments, strict=True)
        ours, theirs, out = (context.make_array(kind)(context, builder, value) for kind, value in arrays)
        vectors = builder.bitcast(theirs.data, _VECTOR.as_pointer())
        planes = [_variable(builder) for _ in range(3)]  # sums of ones, twos and fours, bit by bit
        eights, others = _variable(builder), _variable(builder)  # counted
        n_words = builder.extract_value(ours.shape, 0)
        groups = builder.udiv(n_words, _INT64(_GROUP))

        def differing_in(place: ir.Value) -> ir.Value:
            own = _in_all_lanes(builder, builder.load(builder.gep(ours.data, [place])))
            return builder.xor(own, builder.load(builder.gep(vectors, [place]), align=8))

        with cgutils.for_range(builder, groups) as group:
            first = builder.mul(group.index, _INT64(_GROUP))
            carries = [differing_in(builder.add(first, _INT64(word))) for word in range(_GROUP)]
            for plane in planes:
                carries = [_add(builder, plane, *pair) for pair in zip(carries[::2], carries[1::2], strict=True)]
            builder.store(builder.add(builder.load(eights), _count(builder, carries[0])), eights)
        first = builder.mul(groups, _INT64(_GROUP))
        with cgutils.for_range(builder, builder.sub(n_words, first)) as word:  # fewer than a group
            counted = _count(builder, differing_in(builder.add(first, word.index)))
            builder.store(builder.add(builder.load(others), counted), others)
        total = builder.add(builder.load(others), builder.shl(builder.load(eights), _VECTOR([3] * _LANES)))
        for power, plane in enumerate(planes):
            counted = builder.shl(_count(builder, builder.load(plane)), _VECTOR([power] * _LANES))
            total = builder.add(total, counted)
        differing = builder.sitofp(total, ir.VectorType(ir.FloatType(), _LANES))
        target = builder.bitcast(out.data, differing.type.as_pointer())
        builder.store(builder.fneg(differing), target, align=4)
        return context.get_dummy_value()  # what numba takes for None

    return types.void(query, block, similarity), generate


def _variable(builder: ir.IRBuilder) -> ir.Value:
    """Make room for a vector of zeros; LLVM turns it into a register."""
    return cgutils.alloca_once_value(builder, _VECTOR([0] * _LANES))  # type: ignore[no-untyped-call]


def _in_all_lanes(builder: ir.IRBuilder, number: ir.Value) -> ir.Value:
    nothing = _VECTOR(ir.Undefined)
    one = builder.insert_element(nothing, number, _INT64(0))
    return builder.shuffle_vector(one, nothing, ir.VectorType(ir.IntType(32), _LANES)([0] * _LANES))


def _add(builder: ir.IRBuilder, plane: ir.Value, left: ir.Value, right: ir.Value) -> ir.Value:
    """Add two vectors to a plane, bit by bit, and return the carries.

    In this form, with nothing shared, both take three instructions of AVX-512, not four.
    """
    before = builder.load(plane)
    builder.store(builder.xor(builder.xor(before, left), right), plane)
    return builder.or_(builder.and_(right, builder.or_(before, left)), builder.and_(before, left))


def _count(builder: ir.IRBuilder, vector: ir.Value) -> ir.Value:
    """Return the number of set bits in each lane."""
    kind = ir.FunctionType(_VECTOR, [_VECTOR])
    counted = cgutils.get_or_insert_function(builder.module, kind, f"llvm.ctpop.v{_LANES}i64")  # type: ignore[no-untyped-call]
    return builder.call(counted, [vector])


_CODES = types.Array(types.uint64, 2, "C", readonly=True)
_BLOCKS = types.Array(types.uint64, 3, "C", readonly=True)


@compiled(_CODES, _BLOCKS, types.float32[:, ::1], types.int64, types.int64)
def _compare(codes, blocks, similarity, first, last):  # type: ignore[no-untyped-def]
    """Write the columns of the blocks `first` to `last` of `similarity` (n_queries, n_blocks * _LANES)."""
    rows = max(1, _TILE // (8 * _LANES * codes.shape[1]))
    for start in range(first, last, rows):
        for query in range(len(codes)):
            for block in range(start, min(start + rows, last)):
                own = similarity[query, block * _LANES : (block + 1) * _LANES]
                _write_similarity(codes[query], blocks[block], own)  # type: ignore[call-arg]

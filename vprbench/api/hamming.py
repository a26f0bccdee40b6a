"""Bits packed into words, and Hamming distances between them: each query compared with all references."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from numba import types
from numba.extending import intrinsic

from vprbench.api.arrays import Scores
from vprbench.api.compiling import compiled
from vprbench.api.threads import in_shares

Words = npt.NDArray[np.uint64]  # (n_images, n_words): bits packed, in any order that all share

_TILE = 1 << 12  # words of references that stay in the nearest cache while every query passes over them
_WORTH_A_THREAD = 1 << 20  # words compared: about 0.2 ms
_SHARES = 4  # a thread: whoever is ready first takes the next


def packed(bits: npt.NDArray[Any]) -> Words:
    """Return truth values (n_images, n_bits) as words of 64 bits, (n_images, n_words), zeros at the end."""
    missing = -bits.shape[1] % 64
    return np.packbits(np.pad(bits.astype(bool), ((0, 0), (0, missing))), axis=1).view(np.uint64)


def similarity(codes: Words, references: Words) -> Scores:
    """Return minus the bits in which codes (n_queries, n_words) and references differ, (n_queries, n_references)."""
    scores = np.empty((len(codes), len(references)), np.float32)
    queries, known = np.ascontiguousarray(codes), np.ascontiguousarray(references)
    threads = min(torch.get_num_threads(), len(codes) * known.size // _WORTH_A_THREAD)
    in_shares(lambda own: _compare(queries, known, scores, own.start, own.stop), len(known), threads, _SHARES)
    return scores


@intrinsic
def _count_bits(typing_context, word):  # type: ignore[no-untyped-def]
    """Return the number of set bits of a word: an instruction of the processor that numba has no name for."""
    del typing_context, word
    return types.int64(types.uint64), lambda context, builder, signature, words: builder.ctpop(words[0])


_CODES = types.Array(types.uint64, 2, "C", readonly=True)


@compiled(_CODES, _CODES, types.float32[:, ::1], types.int64, types.int64)
def _compare(codes, references, scores, first, last):  # type: ignore[no-untyped-def]
    """Write the columns `first` to `last` of `scores` (n_queries, n_references)."""
    n_words = codes.shape[1]
    together = max(1, _TILE // n_words)
    for start in range(first, last, together):
        for query in range(len(codes)):
            for reference in range(start, min(start + together, last)):
                differing = 0
                for word in range(n_words):
                    differing += _count_bits(codes[query, word] ^ references[reference, word])  # type: ignore[call-arg]
                scores[query, reference] = -differing

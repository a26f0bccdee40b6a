"""Bits packed into words, and the Hamming distances between them, which faiss counts."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Scores
from vprbench.api.nearest import import_faiss

Words = npt.NDArray[np.uint64]  # (n_images, n_words): bits packed, in any order that all share


def pack_bits(bits: npt.NDArray[Any]) -> Words:
    """Return truth values (n_images, n_bits) as words of 64 bits, (n_images, n_words), zeros at the end."""
    missing = -bits.shape[1] % 64
    return np.packbits(np.pad(bits.astype(bool), ((0, 0), (0, missing))), axis=1).view(np.uint64)


def compare_bits(codes: Words, references: Words) -> Scores:
    """Return minus the bits in which codes (n_queries, n_words) and references differ, (n_queries, n_references)."""
    faiss = import_faiss()
    differing = np.empty((len(codes), len(references)), np.int32)
    if differing.size:
        ours, theirs = (np.ascontiguousarray(words).view(np.uint8) for words in (codes, references))
        pointers = faiss.swig_ptr(ours), faiss.swig_ptr(theirs)
        faiss.hammings(*pointers, *differing.shape, ours.shape[1], faiss.swig_ptr(differing))
    return -differing.astype(np.float32)

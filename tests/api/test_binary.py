"""Packed bits and their Hamming distances, against bits counted one by one."""

import re

import numpy as np
import pytest
import torch

from vprbench.api.binary import BinaryMap
from vprbench.api.hamming import packed
from vprbench.errors import BadInput


def drawn(n, n_words, seed, share=0.5):
    """Random truth values, as many as fill the words."""
    return np.random.default_rng(seed).random((n, 64 * n_words)) < share


def counted(queries, references):
    """Minus the bits that differ, (n_queries, n_references), by truth values."""
    return np.array([-(query != references).sum(1) for query in queries]).reshape(len(queries), len(references))


@pytest.mark.parametrize("n_words", [1, 7, 8, 72])
def test_scores_are_minus_the_bits_that_differ(n_words):
    for n_references in (1, 8, 75):
        references, queries = drawn(n_references, n_words, 1), drawn(5, n_words, 2, 0.2)
        known, wanted = BinaryMap(packed(references), np.arange(n_references)), counted(queries, references)
        for n_queries in (0, 1, 5):
            scores = known.scores(packed(queries[:n_queries]))
            assert scores.dtype == np.float32
            assert np.array_equal(scores, wanted[:n_queries])
    bits = np.repeat([[False], [True]], 64 * 300, axis=1)
    assert BinaryMap(packed(bits), np.arange(2)).scores(packed(bits)).tolist() == [[0, -19200], [-19200, 0]]


def test_threads_and_layout_change_nothing():
    references, queries = drawn(900, 20, 1), drawn(200, 20, 2)
    known, codes, before = BinaryMap(packed(references), np.arange(900)), packed(queries), torch.get_num_threads()
    wanted = counted(queries, references)
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            assert np.array_equal(known.scores(codes), wanted)
            assert np.array_equal(known.scores(np.asfortranarray(codes)), wanted)
    finally:
        torch.set_num_threads(before)


def test_a_place_is_worth_its_most_similar_image_and_costs_all_of_them_in_whole_words():
    references, queries = drawn(30, 3, 1)[:, :130], drawn(4, 3, 2)[:, :130]
    known = BinaryMap(packed(references), np.arange(30) % 10)
    wanted = counted(queries, references).reshape(4, 3, 10).max(1)
    assert np.array_equal(known.scores(packed(queries)), wanted)
    assert known.bytes_per_place == 3 * 3 * 8


def test_codes_of_another_kind_or_length_are_refused():
    known = BinaryMap(packed(drawn(3, 2, 1)), np.arange(3))
    with pytest.raises(ValueError, match=re.escape("uint64 (5, 1) came; this map compares uint64 (n_queries, 2)")):
        known.scores(packed(drawn(5, 1, 2)))
    with pytest.raises(ValueError, match="codes of bool"):
        known.scores(drawn(5, 2, 2))
    with pytest.raises(BadInput, match=re.escape("references of uint64 (3, 2) came with places (2,)")):
        BinaryMap(packed(drawn(3, 2, 1)), np.arange(2))

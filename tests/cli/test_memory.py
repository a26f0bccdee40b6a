"""Large evaluations stay within bounded memory."""

import tracemalloc

import numpy as np

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.runs.answers import Answers

N_PLACES = 27_592  # Nordland, every frame
BLOCK = 128
MEGABYTE = 1_000_000


def peak_bytes(n_blocks):
    """The most memory that collecting the answers to so many blocks of queries takes; no image is read."""
    images = Images(lambda _: np.empty(0), [f"image {i}" for i in range(N_PLACES)])
    positives = tuple(np.array([i]) for i in range(N_PLACES))
    answers = Answers(Dataset("large", images, np.arange(N_PLACES), images, positives, {}), depth=100)
    scores = np.random.default_rng(0).random((BLOCK, N_PLACES), np.float32)
    tracemalloc.start()
    for _ in range(n_blocks):
        answers.add(BLOCK, scores)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert answers.scores is None
    return peak


def test_a_block_of_queries_against_27592_places_needs_little_and_more_blocks_add_only_what_is_kept():
    assert peak_bytes(1) < 150 * MEGABYTE
    kept_per_query = 2_000  # 100 places and scores of 4 bytes each, seven counts of 8, and what lists weigh
    assert peak_bytes(13) < peak_bytes(3) + 10 * BLOCK * kept_per_query

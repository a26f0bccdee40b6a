"""Large evaluations stay within bounded memory."""

import tracemalloc

import numpy as np

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.api.method import Method
from vprbench.runs.answers import QueryScoring
from vprbench.runs.scorers import choose_scorer
from vprbench.runs.stopwatch import Protocol, Stopwatch

N_PLACES = 27_592  # Nordland, every frame
BLOCK = 128
MEGABYTE = 1_000_000
SCORES = np.random.default_rng(0).random((BLOCK, N_PLACES), np.float32)


class Fixed(Method):
    """Reads no image and gives the same scores to each block."""

    def fit(self, references, places):
        return self

    def encode(self, images):
        return np.zeros((len(images), 1), np.float32)

    def match(self, codes):
        return SCORES[: len(codes)]


def peak_bytes(n_blocks):
    """Return the most memory that scoring so many blocks of queries takes beside the scores of one block."""
    images = Images(lambda _: np.zeros((1, 1, 3), np.uint8), [f"image {i}" for i in range(N_PLACES)])
    queries, positives = images[: n_blocks * BLOCK], tuple(np.array([i]) for i in range(n_blocks * BLOCK))
    dataset, method = Dataset("large", images, np.arange(N_PLACES), queries, positives, {}), Fixed()
    scoring = QueryScoring(Stopwatch(Protocol()), choose_scorer(method, N_PLACES, 100), dataset, depth=100)
    tracemalloc.start()
    scoring.score(None)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_a_block_of_queries_against_27592_places_needs_little_and_more_blocks_add_only_kept_answers():
    assert peak_bytes(1) < 150 * MEGABYTE
    kept_per_query = 2_000  # 100 places and scores of 4 bytes each, seven counts of 8, and what lists weigh
    assert peak_bytes(13) < peak_bytes(3) + 10 * BLOCK * kept_per_query

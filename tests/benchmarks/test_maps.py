"""Large maps of simulated descriptors: a query alone to each index, beside exact search."""

import os
import time
from itertools import cycle

import numpy as np
import pytest
from full_size import FULL

from vprbench.api import Search

AREA, WITHIN, AGAIN = (
    64,
    0.5,
    0.8,
)  # places around one centre; inner products of two of them, and of a query with its place
SIZES = os.environ.get("MAPS", "10000x64,100000x64,100000x512") if FULL else "600x16"
INDEXES = ("binary", "rabitq", "sq8", "ivfpq", "hnsw", "binary_hnsw")


def unit(vectors):
    vectors /= np.sqrt(np.einsum("...i,...i", vectors, vectors))[..., None]
    return vectors


@pytest.fixture(scope="module")
def simulated(size):
    """Return what draws a map and queries of it; the last one is kept."""
    kept = {}

    def drawn(places, dimensions):
        if (places, dimensions) not in kept:
            kept.clear()
            random = np.random.default_rng([places, dimensions])
            own = unit(random.standard_normal((-(-places // AREA), AREA, dimensions), np.float32))
            centres = unit(random.standard_normal((len(own), 1, dimensions), np.float32))
            own *= np.float32((1 - WITHIN) ** 0.5)
            own += centres * np.float32(WITHIN**0.5)
            references = unit(own.reshape(-1, dimensions)[:places])
            shown = references[np.linspace(0, places - 1, size(1000, 20)).astype(int)]
            noise = unit(random.standard_normal(shown.shape, np.float32))
            queries = unit(np.float32(AGAIN) * shown + np.float32((1 - AGAIN**2) ** 0.5) * noise)
            kept[places, dimensions] = references, queries, Search(references, np.arange(places))
        return kept[places, dimensions]

    return drawn


@pytest.mark.parametrize("index", INDEXES)
@pytest.mark.parametrize("sizes", SIZES.split(","))
def test_index(sizes, index, measure, simulated):
    places, dimensions = map(int, sizes.split("x"))
    references, queries, exact = simulated(places, dimensions)
    started = time.perf_counter()
    search = Search(references, np.arange(places), index, rerank=100)
    built = time.perf_counter() - started
    best, found = exact.nearest(queries, 10)[1], search.nearest(queries, 10)[1]
    shares = [100 * (best[:, :n, None] == found[:, None, :n]).any(2).mean() for n in (1, 10)]
    turn = cycle(range(len(queries)))

    def asked(searched):
        first = next(turn)
        return searched.nearest(queries[first : first + 1], 10)

    columns = {"build s": f"{built:.3g}", "index bytes a place": f"{search.bytes_per_place:,.0f}"}
    columns["found % of best 1 / 10"] = " / ".join(f"{share:.1f}" for share in shares)
    what = f"{places:,} x {dimensions}, {index}, best 100 compared again"
    measure(what, lambda: asked(search), beside={"exact search": lambda: asked(exact)}, **columns)

"""Matching: codes compared with all references, beside faiss and scipy on the same arrays."""

import numpy as np
import pytest
from scipy.spatial.distance import cdist

from vprbench.api import Search
from vprbench.api.nearest import compare_bits, import_faiss, pack_bits
from vprbench.metrics.ranking import choose_best_places

BEST = 100  # references that a library's search returns


def directions(n, n_dimensions):
    vectors = np.random.default_rng(0).standard_normal((n, n_dimensions), np.float32)
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("full", [1, 128, 3300])
def test_descriptors(full, measure, size):
    n, dimensions, queries = size(3300, 300), size(4096, 16), size(full, min(full, 300))
    references, codes = directions(n, dimensions), directions(n + queries, dimensions)[n:]
    exact, library = Search(references, np.arange(n)), import_faiss().IndexFlatIP(dimensions)
    library.add(references)

    def named():  # in blocks, as a run asks a whole traverse
        for first in range(0, queries, 128):
            choose_best_places(exact.scores(codes[first : first + 128]), BEST)

    ours, says = (named, f"best {BEST} named") if full > 128 else (lambda: exact.scores(codes), "all scores")
    beside = {f"faiss.IndexFlatIP, best {BEST}": lambda: library.search(codes, BEST)}
    measure(f"{queries} against {n:,} x {dimensions:,} floats, {says}", ours, queries, beside)


@pytest.mark.parametrize("queries", [1, 128])
def test_bits(queries, measure, size):
    n, bits = size(3300, 300), 2048
    codes = pack_bits(np.random.default_rng(0).integers(0, 2, (n + queries, bits)))
    library = import_faiss().IndexBinaryFlat(bits)
    library.add(codes[:n].view(np.uint8))
    references, asked = codes[:n], codes[n:]
    beside = {f"faiss.IndexBinaryFlat, best {BEST}": lambda: library.search(asked.view(np.uint8), BEST)}
    measure(f"{queries} against {n:,} x {bits:,} bits", lambda: compare_bits(asked, references), queries, beside)


def test_images_by_absolute_differences(measure, size, route, build):
    places = size(3300, 20)
    sad = build("sad", height=28, width=28).fit(*route(places).references(places))
    code, references = (
        sad.encode(images) for images in (route(places).queries(places, 1), route(places).references(places)[0])
    )
    beside = {"scipy cityblock": lambda: cdist(code.reshape(1, -1), references.reshape(places, -1), "cityblock")}
    measure(f"sad: 1 against {places:,} x 784 levels", lambda: sad.match(code), beside=beside)

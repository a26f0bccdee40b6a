"""The search of descriptors: exact against plain sums, approximate indexes against exact search, and packed bits."""

import tracemalloc

import faiss
import numpy as np
import pytest

from vprbench.api import nearest, search, search_indexes
from vprbench.api.binary import BinaryMethod
from vprbench.api.images import Images
from vprbench.api.nearest import pack_bits
from vprbench.api.search import Search, compare_best
from vprbench.errors import BadInput

N_IMAGES, N_DIMENSIONS = 2000, 64
PLACES = np.arange(N_IMAGES)
RETRIEVING = ("hnsw", "ivfpq", "rabitq", "binary", "binary_hnsw")
APPROXIMATE = (*RETRIEVING, "sq8")


def unit(vectors):
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


def clustered(n_images=N_IMAGES, n_dimensions=N_DIMENSIONS, seed=0):
    """Unit vectors around fifty centres, and a noisy copy of every eighth."""
    generator = np.random.default_rng(seed)
    centres = generator.standard_normal((50, n_dimensions))
    references = unit(
        centres[generator.integers(0, 50, n_images)] + 0.5 * generator.standard_normal((n_images, n_dimensions))
    )
    return references, unit(references[::8] + 0.05 * generator.standard_normal(references[::8].shape))


REFERENCES, CODES = clustered()


def of_places(scores, places):
    """The largest score of each place, (n_queries, n_places), of those of its images."""
    return np.stack([scores[:, places == place].max(1) for place in range(places.max() + 1)], axis=1)


def oracle(codes, references, places):
    return of_places(codes.astype(np.float64) @ references.astype(np.float64).T, places)


def layouts(n):
    return {
        "one image each": np.arange(n),
        "one image each, in another order": np.random.default_rng(3).permutation(n),
        "traverses": np.tile(np.arange(n // 2), 2),
        "unevenly": np.sort(np.append(np.arange(7), np.random.default_rng(4).integers(0, 7, n - 7)))[::-1].copy(),
        "all of one place": np.zeros(n, np.int64),
    }


def found_by_sorting(scores, n):
    """The best places, of equals the lower one first; similarity -inf and place -1 after the last."""
    rounded = scores.astype(np.float32)
    places = np.argsort(-rounded, axis=1, kind="stable")[:, :n]
    short = ((0, 0), (0, n - places.shape[1]))
    similarity = np.take_along_axis(rounded, places, axis=1)
    return np.pad(similarity, short, constant_values=-np.inf), np.pad(places, short, constant_values=-1)


@pytest.mark.parametrize("layout", layouts(8))
def test_exact_scores_are_those_of_float64_and_the_nearest_places_their_best_with_equals_in_order(layout, monkeypatch):
    monkeypatch.setattr(search, "_TOGETHER", 130)
    monkeypatch.setattr(search, "CELLS", 130 * 70)  # 70 queries together
    references, places = clustered(600, 20)[0], layouts(600)[layout]
    codes = unit(np.random.default_rng(1).standard_normal((300, 20)))
    wanted = oracle(codes, references, places)
    for n_queries in (0, 1, 300):
        scores = Search(references, places).scores(codes[:n_queries])
        assert (scores.dtype, scores.shape) == (np.float32, (n_queries, places.max() + 1))
        np.testing.assert_allclose(scores, wanted[:n_queries], atol=1e-6)
    n = 2200
    monkeypatch.setattr(nearest, "CELLS", 70 * 20)  # 70 images together, and 20 queries with these
    monkeypatch.setattr(nearest, "_FIRST", 50)
    references, _ = clustered(n, 20)
    references[[5, 60, 300, 1500, 2199]] = references[7]  # in several blocks
    codes = np.concatenate([references[[7]], unit(np.random.default_rng(1).standard_normal((20, 20)))])
    places = layouts(n)[layout]
    scores = np.full((len(codes), places.max() + 1), -np.inf)
    for image, place in enumerate(places):  # sums of the same terms in the same order, wherever an image lies
        product = np.array([np.sum(code.astype(np.float64) * references[image]) for code in codes])
        scores[:, place] = np.maximum(scores[:, place], product)
    similarity, found = Search(references, places).nearest(codes, 12)
    wanted_similarity, wanted = found_by_sorting(scores, 12)
    assert np.array_equal(found, wanted)
    np.testing.assert_allclose(similarity, wanted_similarity, rtol=1e-7)


@pytest.mark.parametrize("kind", APPROXIMATE)
def test_the_best_of_an_index_are_compared_again_exactly(kind):
    exact = oracle(CODES, REFERENCES, PLACES)
    index = Search(REFERENCES, PLACES, kind, rerank=60)
    scores = index.scores(CODES)
    similarity, wanted = index.nearest(CODES, 5)[0], found_by_sorting(scores, 5)
    assert np.array_equal(index.nearest(CODES, 5)[1], wanted[1])
    np.testing.assert_allclose(similarity, wanted[0], atol=1e-5)
    found = np.isfinite(scores)
    assert 55 < found.sum(1).mean() <= 60
    np.testing.assert_allclose(scores[found], exact[found], atol=1e-7)
    assert (scores.argmax(1) == exact.argmax(1)).mean() >= 0.99
    if kind in ("ivfpq", "rabitq"):  # of fewer lists less is found
        few = Search(REFERENCES, PLACES, kind, rerank=60, probes=1).scores(CODES)
        many = Search(REFERENCES, PLACES, kind, rerank=60, probes=1000).scores(CODES)
        one, all_of_them = ((each.argmax(1) == exact.argmax(1)).mean() for each in (few, many))
        assert 0.2 < one < 0.99 < all_of_them


@pytest.mark.parametrize("kind", ["sq8", "rabitq", "binary", "binary_hnsw"])
def test_an_index_of_a_map_in_a_file_is_built_part_by_part(kind, tmp_path, monkeypatch):
    for module, name in ((search_indexes, "_SAMPLED_BITS"), (search_indexes, "_SAMPLED"), (nearest, "CELLS")):
        monkeypatch.setattr(module, name, 1 << 18)
    np.save(tmp_path / "references.npy", clustered(5000, 512)[0])
    vectors = np.load(tmp_path / "references.npy", mmap_mode="r")
    Search(vectors[:300], np.arange(300), kind, rerank=5)  # so that what is imported is left out
    tracemalloc.start()
    Search(vectors, np.arange(5000), kind)
    assert tracemalloc.get_traced_memory()[1] < 0.6 * vectors.nbytes
    tracemalloc.stop()


@pytest.mark.parametrize("kind", APPROXIMATE)
def test_an_approximate_index_finds_nine_in_ten_of_the_exactly_best_with_about_their_scores(kind):
    def made():
        rerank = 50 if kind.startswith("binary") else 0  # bits alone tell too little of 64 dimensions
        return Search(REFERENCES.copy(), PLACES, kind, 50, rerank)

    index, exact = made(), oracle(CODES, REFERENCES, PLACES)
    scores = index.scores(CODES)
    assert (scores.argmax(1) == exact.argmax(1)).mean() >= 0.9
    found = np.isfinite(scores)
    # hnsw holds the vectors; half a step of 8 bits is 1/510 of a dimension's extent; product codes are coarse
    # and a bit a dimension coarser; what is compared again is exact
    tolerance = {"hnsw": 1e-5, "sq8": 0.01, "ivfpq": 0.25, "rabitq": 0.5}.get(kind, 1e-6)
    assert np.abs(scores[found] - exact[found]).max() < tolerance
    assert np.array_equal(made().scores(CODES), scores)
    singles = np.concatenate([index.scores(CODES[i : i + 1]) for i in range(40)])
    assert np.array_equal(np.isfinite(singles), found[:40])
    # faiss rounds the tables of a single query otherwise
    np.testing.assert_allclose(singles, scores[:40], atol=0.01 if kind == "rabitq" else 1e-5)


@pytest.mark.parametrize("kind", RETRIEVING)
def test_places_that_were_not_retrieved_are_no_candidates_and_of_several_images_the_best_counts(kind):
    scores = Search(REFERENCES, PLACES, kind, neighbours=7).scores(CODES)
    assert set(np.isfinite(scores).sum(1)) == {7}
    assert np.isneginf(scores[~np.isfinite(scores)]).all()
    each = Search(REFERENCES, PLACES, kind).scores(CODES)
    places = np.random.default_rng(5).permutation(PLACES // 40)
    best = of_places(each, places)
    assert np.isfinite(best).sum() < np.isfinite(each).sum()  # so that some images share their place
    assert np.array_equal(Search(REFERENCES, places, kind).scores(CODES), best)
    all_of_them = Search(REFERENCES[:300], PLACES[:300], kind, neighbours=1_000_000).scores(CODES)
    assert np.isfinite(all_of_them).sum(1).max() <= 300


@pytest.mark.parametrize(
    ("spoilt", "wanted"),
    [
        ({"kind": "lsh"}, r"method\.index=lsh .*exact, sq8, hnsw, ivfpq, rabitq, binary, binary_hnsw"),
        ({"neighbours": 0}, r"method\.neighbours=0: give at least 1"),
        ({"rerank": -1}, r"rerank=-1.*0 or more"),
        ({"probes": -1}, r"probes=-1.*0 or more"),
        ({"places": np.arange(3)}, r"\(2000, 64\) .*\(3,\)"),
        ({"references": np.zeros((0, 4), np.float32)}, "0 came"),
        ({"references": REFERENCES[:255], "places": np.arange(255), "kind": "ivfpq"}, "256.*255.*sq8"),
    ],
)
def test_what_cannot_be_searched_is_refused(spoilt, wanted):
    with pytest.raises(BadInput, match=wanted):
        Search(**{"references": REFERENCES, "places": PLACES, **spoilt})
    index = Search(REFERENCES, PLACES)
    for answer in (index.scores, lambda codes: index.nearest(codes, 1)):
        with pytest.raises(ValueError, match=r"\(2.*63\).*\(n_queries.*64\)"):
            answer(np.zeros((2, 63), np.float32))


@pytest.mark.parametrize(
    ("kind", "wanted"),
    [
        ("exact", 4 * 64),
        ("hnsw", 4 * 64 + 4 * 64),  # twice 32 links on the lowest layer, few above
        # a byte for every 4 numbers, and the number of the image; centroids of sqrt(2000) lists and of 256 codes
        ("ivfpq", 16 + 8 + 4 * 64 * (45 + 256) / N_IMAGES),
        # bits, two numbers, that of the image; centroids of 2000 / 39 lists; a rotation
        ("rabitq", 8 + 8 + 8 + 4 * 64 * (51 + 64) / N_IMAGES),
        ("binary", 8),
        ("binary_hnsw", 8 + 4 * 32),
        ("sq8", 64),
    ],
)
def test_bytes_of_a_place_count_what_answers_need(kind, wanted):
    one_each = Search(REFERENCES, PLACES, kind).bytes_per_place
    assert round(wanted) <= one_each <= 1.1 * wanted + 5
    assert Search(REFERENCES, PLACES // 2, kind).bytes_per_place == pytest.approx(2 * one_each, abs=2)


@pytest.mark.parametrize(("kind", "index"), [("hnsw", faiss.IndexHNSWFlat), ("binary_hnsw", faiss.IndexBinaryHNSW)])
def test_a_graph_is_made_by_one_thread_and_leaves_faiss_its_threads(kind, index, monkeypatch):
    # Of several threads the fastest would decide what is linked, another one each time.
    add, seen, before = index.add, [], faiss.omp_get_max_threads()
    monkeypatch.setattr(index, "add", lambda *given: seen.append(faiss.omp_get_max_threads()) or add(*given))
    try:
        faiss.omp_set_num_threads(3)
        Search(REFERENCES[:300], np.arange(300), kind)
        assert (seen, faiss.omp_get_max_threads()) == ([1], 3)
    finally:
        faiss.omp_set_num_threads(before)


BEST_FIRST = np.linspace(1, 0, 20, dtype=np.float32)  # the best are 0 to 9


@pytest.mark.parametrize(
    ("scores", "exact", "shares"),
    [
        (BEST_FIRST + 0.3, BEST_FIRST, [1, 1]),
        (np.where(np.isin(np.arange(20), [0, 4, 7]), -0.5, BEST_FIRST), BEST_FIRST, [0, 0.7]),
        (np.where(np.arange(20) < 4, BEST_FIRST, -np.inf), BEST_FIRST, [1, 0.4]),  # four were retrieved
        ([0.9, 1, 0.5, *[0] * 9], [1, 1, 0.5, *[0] * 9], [1, 1]),  # as good as the best
        ([0.1, 0.2, -np.inf], [0.1, 0.2, 0.3], [0, 2 / 3]),  # fewer than ten
    ],
)
def test_what_an_index_agrees_on_are_the_places_as_good_as_the_exactly_best(scores, exact, shares):
    found = compare_best(np.array([scores], np.float32), np.array([exact], np.float32))
    assert found.tolist() == [pytest.approx(shares)]


def drawn(n, n_words, seed, share=0.5):
    """Random truth values, as many as fill the words."""
    return np.random.default_rng(seed).random((n, 64 * n_words)) < share


class Signs(BinaryMethod):
    def encode(self, images):
        return np.stack([image[0, :, 0].copy().view(np.uint64) for image in images])


def map_of(words, places=None):
    """A map of given bits, which are the rows of its references."""
    images = Images.from_arrays(words.view(np.uint8)[:, None, :, None].repeat(3, axis=3))
    return Signs().fit(images, np.arange(len(words)) if places is None else places)


class Flat(BinaryMethod):
    def encode(self, images):
        return np.zeros((len(images), 1, 2), np.uint64)


def counted(queries, references):
    """Minus the bits that differ, (n_queries, n_references), by truth values."""
    return np.array([-(query != references).sum(1) for query in queries]).reshape(len(queries), len(references))


@pytest.mark.parametrize("n_words", [1, 7, 8, 72])
def test_scores_are_minus_the_bits_that_differ(n_words):
    for n_references in (1, 8, 75):
        references, queries = drawn(n_references, n_words, 1), drawn(5, n_words, 2, 0.2)
        known, wanted = map_of(pack_bits(references)), counted(queries, references)
        for n_queries in (0, 1, 5):
            scores = known.match(pack_bits(queries[:n_queries]))
            assert scores.dtype == np.float32
            assert np.array_equal(scores, wanted[:n_queries])
            assert np.array_equal(known.match(np.asfortranarray(pack_bits(queries[:n_queries]))), scores)
    bits = np.repeat([[False], [True]], 64 * 300, axis=1)
    assert map_of(pack_bits(bits)).match(pack_bits(bits)).tolist() == [[0, -19200], [-19200, 0]]


@pytest.mark.parametrize("layout", layouts(8))
def test_a_place_is_worth_its_most_similar_image_and_costs_all_of_them_in_whole_words(layout):
    references, queries, places = drawn(30, 3, 1)[:, :130], drawn(4, 3, 2)[:, :130], layouts(30)[layout]
    known, wanted = map_of(pack_bits(references), places), of_places(counted(queries, references), places)
    for n_queries in (0, 4):
        assert np.array_equal(known.match(pack_bits(queries[:n_queries])), wanted[:n_queries])
    assert known.bytes_per_place == 30 * 3 * 8 // (places.max() + 1)


def test_bits_of_another_kind_are_refused():
    known = map_of(pack_bits(drawn(3, 2, 1)))
    for codes, told in ((pack_bits(drawn(5, 1, 2)), r"uint64 \(5, 1\) .*\(n_queries, 2\)"), (drawn(5, 2, 2), "bool")):
        with pytest.raises(ValueError, match=told):
            known.match(codes)
    with pytest.raises(BadInput, match=r"encode returned uint64 \(1, 1, 2\)"):
        Flat().fit(Images.from_arrays(np.zeros((1, 1, 1, 3), np.uint8)), np.arange(1))

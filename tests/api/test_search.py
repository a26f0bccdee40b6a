"""The search of descriptors: exact against plain sums in float64, approximate indexes against exact search."""

from __future__ import annotations

import os
import pickle
import re
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from checkout import ROOT

from vprbench.api import bit_indexes, nearest, search, search_indexes
from vprbench.api.nearest import Nearest, Part
from vprbench.api.search import Audit, Search, agreement
from vprbench.api.search_indexes import Kind
from vprbench.storage.shards import Writer

Vectors = npt.NDArray[np.float32]


N_IMAGES, N_DIMENSIONS = 2000, 64
RETRIEVING: tuple[Kind, ...] = ("hnsw", "ivfpq", "rabitq", "binary", "binary_hnsw")
APPROXIMATE: tuple[Kind, ...] = (*RETRIEVING, "sq8")


def unit(vectors: npt.NDArray[Any]) -> Vectors:
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


def clustered(n_images: int = N_IMAGES, n_dimensions: int = N_DIMENSIONS, seed: int = 0) -> tuple[Vectors, Vectors]:
    """Unit vectors around fifty centres, and a noisy copy of every eighth."""
    generator = np.random.default_rng(seed)
    centres = generator.standard_normal((50, n_dimensions))
    references = unit(
        centres[generator.integers(0, 50, n_images)] + 0.5 * generator.standard_normal((n_images, n_dimensions))
    )
    return references, unit(references[::8] + 0.05 * generator.standard_normal(references[::8].shape))


def oracle(codes: Vectors, references: Vectors, places: npt.NDArray[np.int64]) -> npt.NDArray[np.float64]:
    """Inner products in float64, and of each place the largest."""
    products = codes.astype(np.float64) @ references.astype(np.float64).T
    return np.stack([products[:, places == place].max(1) for place in range(places.max() + 1)], axis=1)


def layouts(n: int) -> dict[str, npt.NDArray[np.int64]]:
    return {
        "one image each": np.arange(n),
        "one image each, in another order": np.random.default_rng(3).permutation(n),
        "traverses": np.tile(np.arange(n // 2), 2),
        "neighbours": np.arange(n) // 4,
        "unevenly": np.sort(np.append(np.arange(7), np.random.default_rng(4).integers(0, 7, n - 7)))[::-1].copy(),
        "all of one place": np.zeros(n, np.int64),
    }


# Exact


@pytest.mark.parametrize("n_queries", [0, 1, 2, 300])
@pytest.mark.parametrize("layout", layouts(8))
def test_exact_scores_are_those_of_float64(layout: str, n_queries: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "_TOGETHER", 130)
    monkeypatch.setattr(search, "CELLS", 130 * 70)  # 70 queries together
    references, _ = clustered(600, 20)
    codes, places = unit(np.random.default_rng(1).standard_normal((300, 20)))[:n_queries], layouts(600)[layout]
    scores = Search(references, places).scores(codes)
    assert (scores.dtype, scores.shape) == (np.float32, (n_queries, places.max() + 1))
    np.testing.assert_allclose(scores, oracle(codes, references, places), atol=1e-6)


def test_references_may_lie_in_a_file(tmp_path: Any) -> None:
    references, codes = clustered()
    np.save(tmp_path / "references.npy", references)
    mapped = np.load(tmp_path / "references.npy", mmap_mode="r")
    places = np.arange(N_IMAGES)
    for kind in ("exact", *APPROXIMATE):
        assert np.array_equal(
            Search(mapped, places, kind).scores(codes), Search(references, places, kind).scores(codes)
        )


# The nearest places alone


def found_by_sorting(scores: npt.NDArray[np.float64], n: int) -> tuple[Vectors, npt.NDArray[np.int64]]:
    """The best places, of equals the lower one first; similarity -inf and place -1 after the last."""
    rounded = scores.astype(np.float32)
    places = np.argsort(-rounded, axis=1, kind="stable")[:, :n]
    short = ((0, 0), (0, n - places.shape[1]))
    similarity = np.take_along_axis(rounded, places, axis=1)
    return np.pad(similarity, short, constant_values=-np.inf), np.pad(places, short, constant_values=-1)


@pytest.fixture
def in_small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nearest, "CELLS", 70 * 20)  # 70 images together, and 20 queries with these
    monkeypatch.setattr(nearest, "_CELLS_OF_A_PART", 1)  # the images of a shard
    monkeypatch.setattr(nearest, "_FIRST", 50)


@pytest.mark.usefixtures("in_small_blocks")
@pytest.mark.parametrize("layout", layouts(8))
def test_the_nearest_places_are_those_of_all_scores_with_equals_in_the_order_of_places(layout: str) -> None:
    n = 2200
    references, _ = clustered(n, 20)
    references[[5, 60, 300, 1500, 2199]] = references[7]  # in several blocks and parts
    codes = np.concatenate([references[[7]], unit(np.random.default_rng(1).standard_normal((40, 20)))])
    places = layouts(n)[layout]
    scores = np.full((len(codes), places.max() + 1), -np.inf)
    for image, place in enumerate(places):  # sums of the same terms in the same order, wherever an image lies
        product = np.array([np.sum(code.astype(np.float64) * references[image]) for code in codes])
        scores[:, place] = np.maximum(scores[:, place], product)
    similarity, found = Search(references, places).nearest(codes, 12)
    wanted_similarity, wanted = found_by_sorting(scores, 12)
    assert np.array_equal(found, wanted)
    np.testing.assert_allclose(similarity, wanted_similarity, rtol=1e-7)


@pytest.mark.usefixtures("in_small_blocks")
def test_a_map_in_files_searched_by_other_processes_gives_the_same_bits(tmp_path: Path) -> None:
    references, codes = clustered(2200, 20)
    writer = Writer(tmp_path, len(references))
    for rows in writer.missing():
        writer.write(rows, [references[rows]])

    def elsewhere(function: Callable[[Part], Nearest], parts: Sequence[Part]) -> Iterator[Nearest]:
        assert len(parts) == 3
        return (pickle.loads(pickle.dumps(function))(pickle.loads(pickle.dumps(part))) for part in parts)

    places = np.arange(2200) // 2
    here = Search(references, places).nearest(codes, 5)
    for searched in (references, writer.shards()):
        there = Search(searched, places).nearest(codes, 5, mapped=elsewhere)
        assert all(np.array_equal(*both) for both in zip(here, there, strict=True))
    one_by_one = [Search(references, places).nearest(code[None], 5) for code in codes[:30]]
    assert np.array_equal(np.concatenate([similarity for similarity, _ in one_by_one]), here[0][:30])


@pytest.mark.parametrize("kind", APPROXIMATE)
def test_the_nearest_places_of_an_approximate_index_are_those_it_scores_best(kind: Kind) -> None:
    references, codes = clustered()
    index = Search(references, np.arange(N_IMAGES) // 3, kind, neighbours=40)
    scores = index.scores(codes).astype(np.float64)
    similarity, places = index.nearest(codes, 5)
    wanted_similarity, wanted = found_by_sorting(scores, 5)
    assert np.array_equal(places[np.isfinite(similarity)], wanted[np.isfinite(wanted_similarity)])
    np.testing.assert_allclose(similarity, wanted_similarity, atol=1e-5)


# Approximate


@pytest.mark.parametrize("kind", APPROXIMATE)
def test_the_best_of_an_index_are_compared_again_exactly(kind: Kind) -> None:
    references, codes = clustered()
    exact = oracle(codes, references, np.arange(N_IMAGES))
    scores = Search(references, np.arange(N_IMAGES), kind, rerank=60).scores(codes)
    found = np.isfinite(scores)
    assert 55 < found.sum(1).mean() <= 60
    np.testing.assert_allclose(scores[found], exact[found], atol=1e-7)
    assert (scores.argmax(1) == exact.argmax(1)).mean() >= 0.99


@pytest.mark.parametrize("kind", ["ivfpq", "rabitq"])
def test_of_more_lists_more_is_found(kind: Kind) -> None:
    references, codes = clustered()
    exact = oracle(codes, references, np.arange(N_IMAGES)).argmax(1)
    one, all_of_them = (
        (
            Search(references, np.arange(N_IMAGES), kind, rerank=100, probes=probes).scores(codes).argmax(1) == exact
        ).mean()
        for probes in (1, 1000)
    )
    assert 0.2 < one < all_of_them
    assert all_of_them > 0.99


@pytest.mark.parametrize("kind", ["sq8", "rabitq", "binary", "binary_hnsw"])
def test_an_index_of_a_map_in_files_is_built_part_by_part(
    kind: Kind, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bit_indexes, "_SAMPLED", 1 << 20)
    monkeypatch.setattr(search_indexes, "_SAMPLED", 1 << 20)
    monkeypatch.setattr(bit_indexes, "_ADDED", 1 << 20)
    writer = Writer(tmp_path, 20_000)
    for rows in writer.missing():
        writer.write(rows, [clustered(rows.stop - rows.start, 512, rows.start)[0]])
    vectors = writer.shards()
    Search(vectors[:300], np.arange(300), kind, rerank=5)  # so that what is imported is left out
    tracemalloc.start()
    Search(vectors, np.arange(20_000), kind)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.6 * vectors.nbytes


@pytest.fixture(scope="module", params=APPROXIMATE)
def approximate(request: pytest.FixtureRequest) -> Search:
    return Search(clustered()[0], np.arange(N_IMAGES), request.param, 50, rerank_of(request.param))


def rerank_of(kind: Kind) -> int:
    """Bits alone tell too little of 64 dimensions."""
    return 50 if kind.startswith("binary") else 0


def test_an_approximate_index_finds_nine_in_ten_of_the_exactly_best(approximate: Search) -> None:
    references, codes = clustered()
    exact = oracle(codes, references, np.arange(N_IMAGES))
    assert (approximate.scores(codes).argmax(1) == exact.argmax(1)).mean() >= 0.9


def test_scores_of_what_an_index_finds_are_about_the_inner_products(approximate: Search) -> None:
    references, codes = clustered()
    scores, exact = approximate.scores(codes), oracle(codes, references, np.arange(N_IMAGES))
    found = np.isfinite(scores)
    # hnsw holds the vectors; half a step of 8 bits is 1/510 of a dimension's extent; product codes are coarse
    # and a bit a dimension coarser; what is compared again is exact
    tolerance = {"hnsw": 1e-5, "sq8": 0.01, "ivfpq": 0.25, "rabitq": 0.5}.get(approximate.kind, 1e-6)
    assert np.abs(scores[found] - exact[found]).max() < tolerance


def test_single_queries_and_batches_get_the_same(approximate: Search) -> None:
    _, codes = clustered()
    singles = np.concatenate([approximate.scores(codes[i : i + 1]) for i in range(40)])
    together = approximate.scores(codes[:40])
    assert np.array_equal(np.isfinite(singles), np.isfinite(together))
    # faiss rounds the tables of a single query otherwise
    np.testing.assert_allclose(singles, together, atol=0.01 if approximate.kind == "rabitq" else 1e-5)


def test_the_same_references_give_the_same_scores(approximate: Search) -> None:
    references, codes = clustered()
    again = Search(references.copy(), np.arange(N_IMAGES), approximate.kind, 50, rerank_of(approximate.kind))
    assert np.array_equal(again.scores(codes), approximate.scores(codes))


@pytest.mark.parametrize("kind", RETRIEVING)
def test_places_that_were_not_retrieved_are_no_candidates(kind: Kind) -> None:
    references, codes = clustered()
    scores = Search(references, np.arange(N_IMAGES), kind, neighbours=7).scores(codes)
    assert set(np.isfinite(scores).sum(1)) == {7}
    assert np.isneginf(scores[~np.isfinite(scores)]).all()


@pytest.mark.parametrize("kind", RETRIEVING)
def test_of_several_retrieved_images_of_a_place_the_best_counts(kind: Kind) -> None:
    references, codes = clustered()
    each = Search(references, np.arange(N_IMAGES), kind).scores(codes)
    places = np.random.default_rng(5).permutation(np.arange(N_IMAGES) // 40)
    best = np.stack([each[:, places == place].max(1) for place in range(places.max() + 1)], axis=1)
    assert np.isfinite(best).sum() < np.isfinite(each).sum()  # so that some images share their place
    assert np.array_equal(Search(references, places, kind).scores(codes), best)


def test_eight_bits_score_every_place_and_of_several_images_the_best() -> None:
    references, codes = clustered()
    places = layouts(N_IMAGES)["unevenly"]
    np.testing.assert_allclose(
        Search(references, places, "sq8").scores(codes), oracle(codes, references, places), atol=0.01
    )


def test_eight_bits_are_decoded_as_faiss_does(monkeypatch: pytest.MonkeyPatch) -> None:
    import faiss

    monkeypatch.setattr(search_indexes, "CELLS", 77 * N_DIMENSIONS)  # 77 images at a time
    references, codes = clustered()
    theirs = faiss.IndexScalarQuantizer(N_DIMENSIONS, faiss.ScalarQuantizer.QT_8bit, faiss.METRIC_INNER_PRODUCT)
    theirs.train(references)
    theirs.add(references)
    decoded = theirs.reconstruct_n(0, N_IMAGES)
    found = Search(references, np.arange(N_IMAGES), "sq8").scores(codes)
    np.testing.assert_allclose(found, codes @ decoded.T, atol=1e-5)


@pytest.mark.parametrize("kind", RETRIEVING)
def test_no_more_neighbours_are_retrieved_than_there_are(kind: Kind) -> None:
    references, codes = clustered(300)
    scores = Search(references, np.arange(300), kind, neighbours=1_000_000).scores(codes)
    assert np.isfinite(scores).sum(1).max() <= 300


@pytest.mark.parametrize("n_dimensions", [30, 62, 65, 2051])
def test_product_codes_take_any_number_of_dimensions(n_dimensions: int) -> None:
    references, codes = clustered(300, n_dimensions)
    scores = Search(references, np.arange(300), "ivfpq").scores(codes)
    exact = oracle(codes, references, np.arange(300))
    assert (scores.argmax(1) == exact.argmax(1)).mean() >= 0.9


@pytest.mark.parametrize("kind", ["hnsw", "sq8", "rabitq", "binary", "binary_hnsw"])
@pytest.mark.parametrize("n_images", [1, 2, 30])
def test_few_references_are_enough(kind: Kind, n_images: int) -> None:
    references, _ = clustered(30)
    scores = Search(references[:n_images], np.arange(n_images), kind, rerank=30).scores(references)
    np.testing.assert_allclose(scores, references @ references[:n_images].T, atol=0.01)


def test_product_codes_say_how_many_references_they_need_and_nothing_else(capfd: pytest.CaptureFixture[str]) -> None:
    references, _ = clustered(256)
    Search(references, np.arange(256), "ivfpq")
    assert capfd.readouterr() == ("", "")
    with pytest.raises(ValueError, match=r"256.*255.*sq8"):
        Search(references[:255], np.arange(255), "ivfpq")


# What it refuses


@pytest.mark.parametrize(
    ("spoilt", "wanted"),
    [
        ({"rerank": -1}, r"rerank=-1.*0 or more"),
        ({"probes": -1}, r"probes=-1.*0 or more"),
        ({"places": np.arange(3)}, r"\(300, 64\) .*\(3,\)"),
        ({"references": np.zeros((0, 4), np.float32)}, "0 came"),
    ],
)
def test_what_cannot_be_searched_is_refused(spoilt: dict[str, Any], wanted: str) -> None:
    with pytest.raises(ValueError, match=wanted):
        Search(**{"references": clustered(300)[0], "places": np.arange(300), **spoilt})


@pytest.mark.parametrize("kind", ["exact", *APPROXIMATE])
def test_codes_of_another_length_are_refused(kind: Kind) -> None:
    index = Search(clustered(300)[0], np.arange(300), kind)
    with pytest.raises(ValueError, match=r"\(2.*63\).*\(n_queries.*64\)"):
        index.scores(np.zeros((2, 63), np.float32))


# What it costs


@pytest.mark.parametrize(
    ("kind", "wanted"),
    [
        ("exact", 4 * 64),
        ("hnsw", 4 * 64 + 4 * 64),  # twice 32 links on the lowest layer, few above
        ("ivfpq", 16 + 8),  # a byte for every 4 numbers, and the number of the image; centroids on top
        ("rabitq", 8 + 8 + 8 + 4 * 64 * 256 / 10_000),  # bits, two numbers, that of the image; centroids; a rotation
        ("binary", 8),
        ("binary_hnsw", 8 + 4 * 32),
        ("sq8", 64),
    ],
)
def test_bytes_of_a_place_count_what_answers_need(kind: Kind, wanted: int) -> None:
    references, _ = clustered(10_000)
    one_each = Search(references, np.arange(10_000), kind).bytes_per_place
    assert wanted <= one_each <= 1.1 * wanted + 10
    two_each = Search(references, np.arange(10_000) // 2, kind).bytes_per_place
    assert two_each == pytest.approx(2 * one_each, abs=2)


def bytes_beside_scores(index: Search, codes: Vectors) -> int:
    """The most memory that scoring takes, the scores left out."""
    tracemalloc.start()
    scores = index.scores(codes)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak - scores.nbytes


@pytest.mark.parametrize("layout", ["one image each", "traverses", "one image each, in another order"])
@pytest.mark.parametrize("kind", ["exact", "sq8"])
def test_scoring_needs_little_more_memory_than_its_scores(kind: Kind, layout: str) -> None:
    references = np.random.default_rng(0).random((300_000, 16), np.float32)
    index = Search(references, layouts(300_000)[layout], kind)
    # three intermediate results of 64 MiB
    assert bytes_beside_scores(index, references[:128].copy()) < 220_000_000


def test_eight_bits_are_made_floats_block_by_block() -> None:
    references = np.random.default_rng(0).random((30_000, 2048), np.float32)
    index = Search(references, np.arange(30_000), "sq8")
    assert bytes_beside_scores(index, references[:4].copy()) < 80_000_000 < references.nbytes


@pytest.mark.parametrize("threads", [1, 3])
def test_methods_import_faiss_when_they_need_it_and_with_the_threads_that_were_pinned(threads: int) -> None:
    code = (
        "import sys, vprbench.methods.anyloc, vprbench.methods.densevlad.method; assert 'faiss' not in sys.modules; "
        f"from vprbench.api import search_indexes; from vprbench.run import machine; machine.pin_threads({threads}); "
        "print(search_indexes.faiss_module().omp_get_max_threads())"
    )
    free = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run([sys.executable, "-c", code], env=free, capture_output=True, text=True, check=True)
    assert done.stdout == f"{threads}\n"


def test_faiss_is_imported_in_one_place() -> None:
    texts = {
        path: path.read_text(encoding="utf-8") for top in ("methods", "vprbench") for path in (ROOT / top).rglob("*.py")
    }
    assert [path.name for path, text in texts.items() if re.search(r"^ *import faiss$", text, re.MULTILINE)] == [
        "search_indexes.py"
    ]


def test_a_graph_is_made_by_one_thread_and_leaves_faiss_its_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    # Of several threads the fastest would decide what is linked, another one each time.
    import faiss

    seen = []
    add = faiss.IndexHNSWFlat.add

    def watched(index: Any, vectors: Vectors) -> None:
        seen.append(faiss.omp_get_max_threads())
        add(index, vectors)

    monkeypatch.setattr(faiss.IndexHNSWFlat, "add", watched)
    before = faiss.omp_get_max_threads()
    try:
        faiss.omp_set_num_threads(3)
        Search(clustered(300)[0], np.arange(300), "hnsw")
        assert (seen, faiss.omp_get_max_threads()) == ([1], 3)
    finally:
        faiss.omp_set_num_threads(before)


# How it is compared with exact search


def test_an_audit_tells_which_of_the_best_are_missing_and_takes_equals_for_one_another() -> None:
    references = np.eye(30, dtype=np.float32)
    codes = np.linspace(1, 0.1, 30, dtype=np.float32)[None]  # the nearest are 0, 1, 2, ...
    spoilt = references.copy()
    spoilt[[0, 3, 8]] = 0
    exact = Search(references, np.arange(30))
    assert Search(spoilt, np.arange(30)).audit(exact, codes) == Audit(0, pytest.approx(0.7))
    codes[0, 10:13] = codes[0, :10].min()  # as good as the tenth
    spoilt[8] = references[8]
    assert Search(spoilt, np.arange(30)).audit(exact, codes) == Audit(0, pytest.approx(1))
    assert exact.audit(exact, codes) == Audit(1, 1)


BEST_FIRST = np.linspace(1, 0, 20, dtype=np.float32)[None]  # the best are 0 to 9
MISSED = BEST_FIRST.copy()
MISSED[0, [0, 4, 7]] = -0.5
TIED = np.array([[1, 1, 0.5, 0, 0, 0, 0, 0, 0, 0, 0, 0]], np.float32)
NAMED_SECOND = TIED.copy()
NAMED_SECOND[0, 0] = 0.9  # its equal is named first
THREE = np.array([[0.1, 0.2, 0.3]], np.float32)


@pytest.mark.parametrize(
    ("scores", "exact", "shares"),
    [
        (BEST_FIRST + np.float32(0.3), BEST_FIRST, [1, 1]),
        (MISSED, BEST_FIRST, [0, 0.7]),
        (np.where(np.arange(20) < 4, BEST_FIRST, -np.inf), BEST_FIRST, [1, 0.4]),
        (np.full_like(BEST_FIRST, -np.inf), BEST_FIRST, [0, 0]),
        (NAMED_SECOND, TIED, [1, 1]),
        (np.array([[0.1, 0.2, -np.inf]], np.float32), THREE, [0, 2 / 3]),
    ],
    ids=["the same", "three missed", "four retrieved", "none retrieved", "as good as the best", "fewer than ten"],
)
def test_what_an_index_agrees_on_are_the_places_as_good_as_the_exactly_best(
    scores: Vectors, exact: Vectors, shares: list[float]
) -> None:
    assert agreement(scores.astype(np.float32), exact).tolist() == [pytest.approx(shares)]

"""SAD's compiled matching: whole numbers in int64, PyTorch's distance, and any layout, length and thread."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch

from vprbench.api.arrays import Scores
from vprbench.api.images import Images
from vprbench.methods import sad
from vprbench.methods.sad import SAD, Levels


class Pixels(SAD):
    """SAD on raw pixels: its codes are made by hand."""

    def encode(self, images: Images) -> Levels:
        return np.stack([image[:, :, 0].ravel() for image in images])


def fitted(references: Levels, places: npt.NDArray[np.int64] | None = None) -> SAD:
    places = np.arange(len(references)) if places is None else places
    return Pixels().fit(Images.from_arrays(list(references[:, None])), places)


def codes(n: int, n_pixels: int, seed: int) -> Levels:
    return np.random.default_rng(seed).integers(0, 256, (n, n_pixels), dtype=np.uint8)


def oracle(queries: Levels, references: Levels) -> Scores:
    """Return minus the mean absolute differences: whole numbers in int64, one division, one rounding."""
    totals = [np.abs(query.astype(np.int64) - references.astype(np.int64)).sum(1) for query in queries]
    return (np.array(totals).reshape(len(queries), len(references)) / -queries.shape[1]).astype(np.float32)


def same_bits(left: Scores, right: Scores) -> bool:
    return left.dtype == right.dtype and left.shape == right.shape and left.tobytes() == right.tobytes()


@pytest.fixture
def threads() -> Iterator[None]:
    """Give back the number of threads that a test changes."""
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("n_queries", [1, 2, 9, 130])
@pytest.mark.parametrize("n_references", [1, 7, 300])
@pytest.mark.parametrize("n_pixels", [1, 63, 64, 65, 784])
def test_scores_are_those_of_int64(n_pixels: int, n_references: int, n_queries: int) -> None:
    references, queries = codes(n_references, n_pixels, seed=1), codes(n_queries, n_pixels, seed=2)
    assert same_bits(fitted(references).match(queries), oracle(queries, references))


def test_scores_have_the_bits_that_pytorch_gives_on_other_devices() -> None:
    references, queries = codes(300, 784, seed=1), codes(9, 784, seed=2)
    references[5] = queries[3]  # a difference of nothing: minus zero
    method = fitted(references)
    compiled = method.match(queries)
    method._references = method._to_device(references)
    assert same_bits(compiled, method.match(queries))
    assert np.signbit(compiled[3, 5])


@pytest.mark.parametrize("n_pixels", [1, 64, 65, 784, 70_001])
def test_black_against_white_is_255_levels_at_any_length(n_pixels: int) -> None:
    levels = np.repeat(np.array([[0], [255]], np.uint8), n_pixels, axis=1)
    assert fitted(levels).match(levels).tolist() == [[0, -255], [-255, 0]]


def test_sums_beyond_32_bits_do_not_wrap() -> None:
    n_pixels = 2**31 // 255 + 1000
    levels = np.repeat(np.array([[0], [255]], np.uint8), n_pixels, axis=1)
    assert fitted(levels).match(levels) == pytest.approx(np.array([[0, -255], [-255, 0]]), rel=1e-6)


def test_chunks_and_tiles_leave_nothing_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sad, "_TILE", 700)
    monkeypatch.setattr(sad, "_CHUNK", 60)
    references, queries = codes(31, 200, seed=1), codes(5, 200, seed=2)
    similarity = np.full((5, 31), np.nan, np.float32)
    sad._compare.py_func(queries, references, 0, 31, similarity)
    assert similarity == pytest.approx(oracle(queries, references), rel=1e-6)


def test_a_kernel_writes_its_own_columns_only() -> None:
    references, queries = codes(31, 50, seed=1), codes(3, 50, seed=2)
    similarity = np.full((3, 31), 7, np.float32)
    sad._compare(queries, references, 10, 20, similarity)
    assert same_bits(similarity[:, 10:20].copy(), oracle(queries, references[10:20]))
    assert np.all(similarity[:, :10] == 7)
    assert np.all(similarity[:, 20:] == 7)


@pytest.mark.parametrize("layout", ["readonly", "every other row", "every other pixel", "backwards", "by columns"])
def test_codes_may_lie_anyhow(layout: str) -> None:
    references, many = codes(20, 65, seed=1), codes(18, 130, seed=2)
    queries = {
        "readonly": many[:, :65].copy(),
        "every other row": many[::2, :65],
        "every other pixel": many[:, ::2],
        "backwards": many[::-1, 64::-1],
        "by columns": np.asfortranarray(many[:, :65]),
    }[layout]
    queries.flags.writeable = False
    before = queries.copy()
    assert same_bits(fitted(references).match(queries), oracle(before, references))
    assert np.array_equal(queries, before)


@pytest.mark.parametrize("layout", ["readonly", "by columns"])
def test_references_may_lie_anyhow(layout: str) -> None:
    class Laid(Pixels):
        def encode(self, images: Images) -> Levels:
            levels = np.asfortranarray(super().encode(images)) if layout == "by columns" else super().encode(images)
            levels.flags.writeable = False
            return levels

    references, queries = codes(20, 65, seed=1), codes(3, 65, seed=2)
    method = Laid().fit(Images.from_arrays(list(references[:, None])), np.arange(20))
    assert same_bits(method.match(queries), oracle(queries, references))


@pytest.mark.parametrize("n_references", [1, 2, 301])
@pytest.mark.parametrize("n_threads", [1, 2, 5])
def test_any_number_of_threads_gives_the_same(
    n_references: int, n_threads: int, monkeypatch: pytest.MonkeyPatch, threads: None
) -> None:
    monkeypatch.setattr(sad, "_WORTH_A_THREAD", 1)
    torch.set_num_threads(n_threads)
    references, queries = codes(n_references, 784, seed=1), codes(9, 784, seed=2)
    assert same_bits(fitted(references).match(queries), oracle(queries, references))


def started(monkeypatch: pytest.MonkeyPatch, n_references: int, n_queries: int) -> int:
    """Return how many threads were asked to help the caller's."""
    asked = []

    class Counted(ThreadPoolExecutor):
        def submit(self, *arguments: Any, **named: Any) -> Future[Any]:
            asked.append(arguments)
            return super().submit(*arguments, **named)

    with Counted(2) as pool:
        monkeypatch.setattr(sad, "_helpers", lambda: pool)
        sad._similarity(codes(n_queries, 784, seed=1), codes(n_references, 784, seed=2))
    return len(asked)


def test_no_answer_waits_for_helpers_that_never_come(monkeypatch: pytest.MonkeyPatch, threads: None) -> None:
    class Asleep:
        def submit(self, *_: Any) -> Future[Any]:
            return Future()

    monkeypatch.setattr(sad, "_WORTH_A_THREAD", 1)
    monkeypatch.setattr(sad, "_helpers", Asleep)
    torch.set_num_threads(2)
    references, queries = codes(30, 784, seed=1), codes(9, 784, seed=2)
    assert same_bits(fitted(references).match(queries), oracle(queries, references))


@pytest.mark.parametrize(("n_references", "n_queries", "others"), [(3300, 1, 0), (3300, 128, 1), (27_592, 1, 1)])
def test_threads_are_started_only_where_that_pays(
    n_references: int, n_queries: int, others: int, monkeypatch: pytest.MonkeyPatch, threads: None
) -> None:
    torch.set_num_threads(2)
    assert started(monkeypatch, n_references, n_queries) == others


def test_no_thread_is_started_where_pytorch_may_use_one(monkeypatch: pytest.MonkeyPatch, threads: None) -> None:
    torch.set_num_threads(1)
    assert started(monkeypatch, 3300, 128) == 0


def test_several_threads_may_match_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sad, "_WORTH_A_THREAD", 1 << 16)
    references = codes(300, 784, seed=1)
    method = fitted(references)
    asked = [codes(1 + n % 5, 784, seed=n) for n in range(40)]
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(method.match, asked))
    assert all(same_bits(scores, oracle(queries, references)) for queries, scores in zip(asked, answers, strict=True))


def test_of_several_traverses_the_most_similar_image_of_a_place_counts() -> None:
    references, queries = codes(21, 784, seed=1), codes(9, 784, seed=2)
    places = np.random.default_rng(3).permutation(np.repeat(np.arange(7), 3))
    each = oracle(queries, references)
    best = np.stack([each[:, places == place].max(1) for place in range(7)], axis=1)
    assert same_bits(fitted(references, places).match(queries), best)


def test_matching_takes_little_more_memory_than_its_scores() -> None:
    method, queries = fitted(codes(3000, 784, seed=1)), codes(128, 784, seed=2)
    method.match(queries)  # the first call makes threads
    tracemalloc.start()
    scores = method.match(queries)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < scores.nbytes + 200_000


@pytest.mark.parametrize(
    ("wrong", "came"),
    [
        (np.zeros((2, 9), np.uint8), r"uint8 \(2, 9\)"),
        (np.zeros(10, np.uint8), r"uint8 \(10,\)"),
        (np.zeros((2, 10), np.float32), r"float32 \(2, 10\)"),
    ],
)
def test_codes_that_do_not_fit_the_map_are_refused(wrong: npt.NDArray[np.generic], came: str) -> None:
    method = fitted(codes(3, 10, seed=1))
    with pytest.raises(ValueError, match=came + r" came; this map compares uint8 \(n_queries, 10\)"):
        method.match(wrong)

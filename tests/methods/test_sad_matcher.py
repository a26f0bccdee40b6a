"""SAD's compiled matching: whole numbers in int64, PyTorch's distance, and any layout, length and thread."""

from __future__ import annotations

import re
import tracemalloc
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any
from unittest.mock import Mock

import numpy as np
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


def fitted(references: Levels) -> SAD:
    return Pixels().fit(Images.from_arrays(list(references[:, None])), np.arange(len(references)))


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


@pytest.mark.parametrize("n_pixels", [1, 64, 65, 784, 70_001, 2**31 // 255 + 1000])  # the last sum takes 33 bits
def test_black_against_white_is_255_levels_at_any_length(n_pixels: int) -> None:
    levels = np.repeat(np.array([[0], [255]], np.uint8), n_pixels, axis=1)
    assert fitted(levels).match(levels) == pytest.approx(np.array([[0, -255], [-255, 0]]), rel=1e-6)


def test_chunks_and_tiles_leave_nothing_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sad, "_TILE", 700)
    monkeypatch.setattr(sad, "_CHUNK", 60)
    references, queries = codes(31, 200, seed=1), codes(5, 200, seed=2)
    similarity = np.full((5, 31), np.nan, np.float32)
    sad._compare.py_func(queries, references, 0, 31, similarity)
    assert similarity == pytest.approx(oracle(queries, references), rel=1e-6)


LAYOUTS: dict[str, Callable[[Levels], Levels]] = {
    "rows": lambda many: many[:18, :65].copy(),
    "every other row": lambda many: many[::2, :65],
    "every other pixel": lambda many: many[:18, ::2],
    "backwards": lambda many: many[17::-1, 64::-1],
    "by columns": lambda many: np.asfortranarray(many[:18, :65]),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_codes_and_references_may_lie_anyhow_and_are_not_written_to(layout: str, monkeypatch) -> None:
    references, queries = (LAYOUTS[layout](codes(36, 130, seed)) for seed in (1, 2))
    references.flags.writeable = queries.flags.writeable = False
    monkeypatch.setattr(Pixels, "encode", lambda *_: references)
    before = queries.copy()
    assert same_bits(fitted(references).match(queries), oracle(before, references))
    assert np.array_equal(queries, before)


@pytest.mark.parametrize("n_references", [1, 2, 301])
@pytest.mark.parametrize("n_threads", [1, 2, 5])
def test_any_number_of_threads_gives_the_same(
    n_references: int, n_threads: int, monkeypatch: pytest.MonkeyPatch, threads: None
) -> None:
    monkeypatch.setattr(sad, "_WORTH_A_THREAD", 1)
    torch.set_num_threads(n_threads)
    references, queries = codes(n_references, 784, seed=1), codes(9, 784, seed=2)
    assert same_bits(fitted(references).match(queries), oracle(queries, references))


@pytest.mark.parametrize(
    ("n_threads", "n_references", "n_queries", "others"),
    [(2, 3300, 1, 0), (2, 3300, 128, 1), (2, 27_592, 1, 1), (1, 3300, 128, 0)],
)
def test_threads_are_started_only_if_that_pays_and_pytorch_may_use_them(
    n_threads: int, n_references: int, n_queries: int, others: int, monkeypatch: pytest.MonkeyPatch, threads: None
) -> None:
    with ThreadPoolExecutor(2) as pool:
        helpers = Mock(wraps=pool)
        monkeypatch.setattr(sad, "_helpers", lambda: helpers)
        torch.set_num_threads(n_threads)
        fitted(codes(n_references, 784, seed=1)).match(codes(n_queries, 784, seed=2))
    assert helpers.submit.call_count == others


def test_no_answer_waits_for_helpers_that_never_come(monkeypatch: pytest.MonkeyPatch, threads: None) -> None:
    class Asleep:
        def submit(self, *_: Any) -> Future[Any]:
            return Future()

    monkeypatch.setattr(sad, "_WORTH_A_THREAD", 1)
    monkeypatch.setattr(sad, "_helpers", Asleep)
    torch.set_num_threads(2)
    references, queries = codes(30, 784, seed=1), codes(9, 784, seed=2)
    assert same_bits(fitted(references).match(queries), oracle(queries, references))


def test_several_threads_may_match_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sad, "_WORTH_A_THREAD", 1 << 16)
    references = codes(300, 784, seed=1)
    method = fitted(references)
    asked = [codes(1 + n % 5, 784, seed=n) for n in range(40)]
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(method.match, asked))
    assert all(same_bits(scores, oracle(queries, references)) for queries, scores in zip(asked, answers, strict=True))


def test_matching_takes_little_more_memory_than_its_scores() -> None:
    method, queries = fitted(codes(3000, 784, seed=1)), codes(128, 784, seed=2)
    method.match(queries)  # the first call makes threads
    tracemalloc.start()
    scores = method.match(queries)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < scores.nbytes + 200_000


@pytest.mark.parametrize(("shape", "dtype"), [((2, 9), "uint8"), ((10,), "uint8"), ((2, 10), "float32")])
def test_codes_that_do_not_fit_the_map_are_refused(shape: tuple[int, ...], dtype: str) -> None:
    with pytest.raises(ValueError, match=re.escape(f"{dtype} {shape}")):
        fitted(codes(3, 10, seed=1)).match(np.zeros(shape, dtype))

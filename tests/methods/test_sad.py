"""SAD: its compiled matching against whole numbers in int64 and PyTorch."""

import numpy as np
import pytest
from threads import torch_threads

from vprbench.api.images import Images
from vprbench.methods import sad
from vprbench.methods.sad import SAD


class Pixels(SAD):
    """SAD on raw pixels: its codes are made by hand."""

    def encode(self, images):
        return np.stack([image[:, :, 0].ravel() for image in images])


def fitted(references):
    return Pixels().fit(Images.from_arrays(list(references[:, None])), np.arange(len(references)))


def codes(n, n_pixels, seed):
    return np.random.default_rng(seed).integers(0, 256, (n, n_pixels), dtype=np.uint8)


def oracle(queries, references):
    """Return minus the mean absolute differences: whole numbers in int64, one division, one rounding."""
    totals = [np.abs(query.astype(np.int64) - references.astype(np.int64)).sum(1) for query in queries]
    return (np.array(totals).reshape(len(queries), len(references)) / -queries.shape[1]).astype(np.float32)


def same_bits(left, right):
    return left.dtype == right.dtype and left.shape == right.shape and left.tobytes() == right.tobytes()


@pytest.mark.parametrize(
    ("n_pixels", "n_references", "n_queries", "threads"),
    [(1, 7, 2, 1), (63, 1, 1, 2), (65, 300, 9, 1), (784, 7, 130, 1), (784, 301, 9, 5)],
)
def test_scores_are_those_of_int64_whatever_the_number_of_threads(
    n_pixels, n_references, n_queries, threads, monkeypatch
):
    monkeypatch.setattr(sad, "_WORTH_A_THREAD", 1)
    references, queries = codes(n_references, n_pixels, seed=1), codes(n_queries, n_pixels, seed=2)
    with torch_threads(threads):
        assert same_bits(fitted(references).match(queries), oracle(queries, references))


def test_scores_have_the_bits_that_pytorch_gives_on_other_devices():
    references, queries = codes(300, 784, seed=1), codes(9, 784, seed=2)
    references[5] = queries[3]  # a difference of nothing: minus zero
    method = fitted(references)
    compiled = method.match(queries)
    assert method.map_bytes() == references.nbytes
    method._references = method._move_to_device(references)
    assert same_bits(compiled, method.match(queries))
    assert np.signbit(compiled[3, 5])
    assert method.map_bytes() == 4 * references.size
    assert SAD().map_bytes() is None


@pytest.mark.parametrize("n_pixels", [64, 70_001, 2**31 // 255 + 1000])  # the last sum takes 33 bits
def test_black_against_white_is_255_levels_at_any_length(n_pixels):
    levels = np.repeat(np.array([[0], [255]], np.uint8), n_pixels, axis=1)
    assert fitted(levels).match(levels) == pytest.approx(np.array([[0, -255], [-255, 0]]), rel=1e-6)

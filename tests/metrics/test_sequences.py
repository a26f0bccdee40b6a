"""Scores of sequences against plain loops, and what holds whatever the scores are."""

import math

import numpy as np
import pytest

from vprbench.metrics import sequences

N_QUERIES, N_PLACES = 23, 17
QUERY_BREAKS, PLACE_BREAKS = [4, 5, 14], [6, 13]


def matrix(seed=0):
    scores = np.random.default_rng(seed).normal(size=(N_QUERIES, N_PLACES)).astype(np.float32)
    scores[3, 7] = scores[20, 1] = -np.inf
    return scores


def slow(scores, offsets, query_breaks, place_breaks):
    """The mean over the cells (q + k, p + m) that the query has; -inf where the place lacks one of them."""

    def joined(first, second, breaks):
        return not any(min(first, second) < at <= max(first, second) for at in breaks)

    found = np.full(scores.shape, -np.inf, np.float32)
    for q in range(len(scores)):
        for p in range(scores.shape[1]):
            cells = []
            for k, m in offsets:
                if 0 <= q + k < len(scores) and joined(q, q + k, query_breaks):
                    inside = 0 <= p + m < scores.shape[1] and joined(p, p + m, place_breaks)
                    cells.append(float(scores[q + k, p + m]) if inside else -math.inf)
            found[q, p] = sum(cells) / len(cells)
    return found


def fast(scores, asked, breaks=True, step=1.0):
    queries, places = (QUERY_BREAKS, PLACE_BREAKS) if breaks else (None, None)
    queries, places = sequences.stretches(N_QUERIES, queries), sequences.stretches(N_PLACES, places)
    found, counts = sequences.sequence_scores(scores, asked, queries, places, step)
    return found, counts.tolist()


@pytest.mark.parametrize("breaks", [False, True])
@pytest.mark.parametrize(
    ("asked", "steps"),
    [
        (sequences.Sequences(1), [0]),
        (sequences.Sequences(3), [-2, -1, 0]),
        (sequences.Sequences(4, "centred"), [-2, -1, 0, 1]),
        (sequences.Sequences(5, "centred"), [-2, -1, 0, 1, 2]),
        (sequences.Sequences(4, "lens"), [-1, 0, 1, 2]),
        (sequences.Sequences(40), list(range(-39, 1))),  # longer than the journey
    ],
)
def test_a_sequence_is_the_mean_along_the_diagonal(asked, steps, breaks, monkeypatch):
    monkeypatch.setattr(sequences, "_BLOCK_CELLS", 7 * N_PLACES)
    queries, places = (QUERY_BREAKS, PLACE_BREAKS) if breaks else ([], [])
    found, counts = fast(matrix(), asked, breaks)
    np.testing.assert_allclose(found, slow(matrix(), [(k, k) for k in steps], queries, places), rtol=1e-6)
    if breaks and steps == [-2, -1, 0]:  # the counts say how full each window is
        assert counts == [1, 2, 3, 3, 1, 1, 2, *[3] * 7, 1, 2, *[3] * 7]


def test_of_several_velocities_the_best_mean_counts_and_a_step_may_be_several_places():
    scores = matrix(1)
    ways = [
        [(-3, -2), (-2, -2), (-1, -1), (0, 0)],  # 0.8: -2.4, -1.6, -0.8
        [(-3, -3), (-2, -2), (-1, -1), (0, 0)],
        [(-3, -4), (-2, -2), (-1, -1), (0, 0)],  # 1.2: -3.6, -2.4, -1.2
    ]
    found, _ = fast(scores, sequences.Sequences(4, velocities=(0.8, 1.0, 1.2)))
    wanted = np.maximum.reduce([slow(scores, way, QUERY_BREAKS, PLACE_BREAKS) for way in ways])
    np.testing.assert_allclose(found, wanted, rtol=1e-6)
    twice, _ = fast(scores, sequences.Sequences(2), step=2.0)
    np.testing.assert_allclose(twice, slow(scores, [(-1, -2), (0, 0)], QUERY_BREAKS, PLACE_BREAKS), rtol=1e-6)


@pytest.mark.parametrize("width", [2, 5, 10, 100])
def test_local_contrast_is_that_of_openseqslam(width):
    scores = matrix()
    scores[11] = 0.25  # all alike
    wanted = np.zeros_like(scores)
    for q in range(N_QUERIES):
        for p in range(N_PLACES):
            near = [i for i in range(p - width // 2, p + width // 2 + 1) if 0 <= i < N_PLACES]
            near = [i for i in near if not any(min(i, p) < at <= max(i, p) for at in PLACE_BREAKS)]
            values = np.array([scores[q, i] for i in near if scores[q, i] > -np.inf], np.float64)
            spread = values.std(ddof=1) if len(values) > 1 else 0.0
            wanted[q, p] = (float(scores[q, p]) - values.mean()) / spread if spread > 1e-7 else 0.0
    wanted[~np.isfinite(scores)] = -np.inf
    found = sequences.local_contrast(scores, width, sequences.stretches(N_PLACES, PLACE_BREAKS))
    np.testing.assert_allclose(found, wanted, rtol=1e-4, atol=1e-5)


def test_the_filter_is_the_forward_pass_of_its_hidden_markov_model():
    scores, asked = matrix(2), sequences.Filter(back=-1, ahead=2, ratio=3.0)
    low, high = np.quantile(scores[0].astype(float), [0.025, 0.975])
    moves = np.array([[float(-1 <= to - at <= 2) for to in range(N_PLACES)] for at in range(N_PLACES)])
    belief = np.ones(N_PLACES)
    found = sequences.filter_scores(scores, asked, sequences.stretches(N_QUERIES, QUERY_BREAKS))
    for query in range(N_QUERIES):
        prior = np.ones(N_PLACES) if query in (0, *QUERY_BREAKS) else belief @ moves
        belief = prior * np.exp(scores[query].astype(float) * math.log(3.0) / (high - low))
        belief /= belief.sum()
        np.testing.assert_allclose(np.exp(found[query]), belief, rtol=1e-4)
    assert (sequences.Filter().back, sequences.Filter().ahead, sequences.Filter().ratio) == (0, 2, 5.0)


def test_a_filter_that_is_lost_begins_anew_and_hopeless_queries_have_no_candidate():
    scores = np.full((4, 9), -np.inf, np.float32)
    scores[0, 0] = scores[1, 8] = scores[3, 4] = 1.0  # nobody moves 8 places, and query 2 is nowhere
    found = sequences.filter_scores(scores, sequences.Filter(), sequences.stretches(4, None))
    assert [np.flatnonzero(row > -np.inf).tolist() for row in found] == [[0], [8], [], [4]]
    assert not np.isnan(found).any()


def test_what_cannot_be_is_refused():
    for kind, options in (
        *((sequences.Sequences, {"velocities": wrong}) for wrong in ((0.0,), (math.inf,), ())),
        *((sequences.Sequences, {"contrast": wrong}) for wrong in (1, -2)),
        (sequences.Sequences, {"length": 0}),
        (sequences.Sequences, {"window": "lens", "contrast": 4}),
        (sequences.Filter, {"back": 3}),
        *((sequences.Filter, {"ratio": wrong}) for wrong in (1.0, math.inf)),
    ):
        with pytest.raises(ValueError, match=next(iter(options))):
            kind(**({"length": 2} if kind is sequences.Sequences else {}) | options)

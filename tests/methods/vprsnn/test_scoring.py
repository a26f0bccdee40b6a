"""VPRSNN's neurons: which place each speaks for, and what they say of a query."""

from fractions import Fraction

import numpy as np
import pytest

from vprbench.methods.vprsnn import scoring
from vprbench.methods.vprsnn.scoring import Responses


def network(seed, n_places=23, per_module=5, n_neurons=9):
    """Return modules in shuffled order, the last with fewer places; neurons fired for none, some or all of theirs.

    Places were shown up to three times, with so few spikes that several often drew equally many a presentation.
    """
    random = np.random.default_rng(seed)
    places = np.full(-(-n_places // per_module) * per_module, -1)
    places[:n_places] = random.permutation(n_places)
    places = places.reshape(-1, per_module)
    shape = len(places), n_neurons, per_module
    fired = random.random(shape) < random.choice([0, 0.3, 1], shape[:2])[:, :, None]
    shown = np.where(places >= 0, random.integers(0, 4, places.shape), 0)
    sums = np.where(fired & (shown > 0)[:, None], random.integers(1, 9, shape), 0)
    return Responses(sums.astype(np.float32), shown, places)


def labels_slowly(learnt):
    """Find the module's first place to which a neuron gave most spikes a presentation, -1 if it never fired."""
    found = np.full(learnt.sums.shape[:2], -1)
    for (module, neuron), _ in np.ndenumerate(found):
        shown, places = learnt.shown[module].tolist(), learnt.places[module].tolist()
        means = [Fraction(int(spikes), max(n, 1)) for spikes, n in zip(learnt.sums[module, neuron], shown, strict=True)]
        found[module, neuron] = places[means.index(max(means))] if any(means) else -1
    return found


def standard_slowly(responses, spoken_for, silenced, n_places):
    """Score place by place: spikes of the place's neurons by the number of them."""
    scores, heard = np.zeros((len(responses), n_places)), responses * ~silenced
    for place in set(spoken_for.ravel().tolist()) - {-1}:
        scores[:, place] = heard[:, spoken_for == place].mean(axis=1)
    return scores.astype(np.float32)


def weighted_slowly(responses, learnt, silenced, n_places):
    """Score place by place from the spikes (n_neurons, n_places) of the training."""
    memory = np.zeros((silenced.size, n_places))
    for neuron, sums in enumerate(learnt.sums.reshape(silenced.size, -1)):
        for place, spikes in zip(learnt.places[neuron // silenced.shape[1]].tolist(), sums, strict=True):
            memory[neuron, place] += spikes * (place >= 0)
    n_known, total = np.count_nonzero(memory, axis=1), np.maximum(memory.sum(axis=1, keepdims=True), 1)
    heard = (responses * ~silenced).reshape(len(responses), silenced.size)
    shared = heard / np.where(n_known >= 0.02 * n_places, np.maximum(n_known, 1), 1)
    memory[memory / total <= 0.1] = 0
    involved = (heard != 0) @ memory / np.maximum(memory.sum(axis=0), 1)
    return (shared @ (memory / total) * involved).astype(np.float32)


@pytest.mark.parametrize("n_places", [23, 180])  # weighted: neurons of one place are divided, or those of four alone
@pytest.mark.parametrize(
    ("seed", "n_queries", "block_cells"), [(0, 7, 1), (1, 7, 61), (3, 7, 1 << 20), (0, 0, 1 << 20)]
)
def test_places_spoken_for_and_scores_are_those_of_slow_loops_in_blocks_of_any_size(
    monkeypatch, seed, n_queries, block_cells, n_places
):
    learnt = network(seed)
    random, shape = np.random.default_rng([seed, 1]), learnt.sums.shape[:2]
    responses = random.integers(1, 8, (n_queries, *shape)) * (random.random((n_queries, *shape)) < 0.3)
    silenced = random.random(shape) < 0.2
    spoken_for = scoring.assign_places(learnt)
    assert np.array_equal(spoken_for, labels_slowly(learnt))
    assert not np.isin(np.arange(23), spoken_for).all()
    assert (spoken_for == -1).any()
    monkeypatch.setattr(scoring, "_BLOCK_CELLS", block_cells)
    ways = [
        (scoring.score_standard, standard_slowly, spoken_for, np.uint8),
        (scoring.score_weighted, weighted_slowly, learnt, np.int64),
    ]
    for fast, slow, given, kind in ways:
        found = fast(responses.astype(kind), given, silenced, n_places)
        expected = slow(responses, given, silenced, n_places)
        assert (found.dtype, found.shape) == (np.float32, expected.shape)
        assert np.allclose(found, expected, rtol=1e-6, atol=0)


def test_a_query_is_normalised_from_its_lowest_score_to_a_sum_of_one():
    scores = np.array([[2, 5, 3, 2], [0, 0, 0, 8], [0, 0, 0, 0], [-np.inf] * 4], np.float32)
    before = scores.copy()
    # (s - min) / (max - min): 0, 1, 1/3, 0, whose sum is 4/3; where all are equal they stay
    expected = np.array([[0, 3 / 4, 1 / 4, 0], [0, 0, 0, 1], [0, 0, 0, 0], [-np.inf] * 4])
    assert scoring.normalise_scores(scores) == pytest.approx(expected, rel=1e-6)
    assert np.array_equal(scores, before)

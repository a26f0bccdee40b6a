"""VPRSNN's neurons: which place each speaks for, what they say of a query, who is silenced, and for which threshold."""

import numpy as np
import numpy.typing as npt
import pytest

from vprbench.methods.vprsnn import scoring
from vprbench.methods.vprsnn.scoring import Responses, labels
from vprbench.methods.vprsnn.training_sets import modules

Array = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


def network(seed, n_places=23, per_module=5, n_neurons=9):
    """Return modules in shuffled order, the last with fewer places; neurons fired for none, some or all of theirs."""
    random = np.random.default_rng(seed)
    groups = modules(n_places, per_module, "shuffled", seed, 4)
    places = np.full((len(groups), per_module), -1)
    for module, group in enumerate(groups):
        places[module, : len(group)] = group
    shape = len(groups), n_neurons, per_module
    fired = random.random(shape) < random.choice([0, 0.3, 1], shape[:2])[:, :, None]
    sums = np.where(fired & (places >= 0)[:, None], random.integers(1, 40, shape), 0)
    return Responses(sums.astype(np.float32), np.where(places >= 0, 10, 0), places)


def one_module(sums, shown=None, places=None):
    """Return a module of neurons that gave `sums` (n_neurons, n_labels) in five presentations of each label."""
    n = len(sums[0])
    labelled = np.array([places or range(n)], np.int64)
    return Responses(np.array([sums], np.float32), np.array([shown or [5] * n]), labelled)


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


@pytest.mark.parametrize(
    ("learnt", "expected"),
    [
        pytest.param(one_module([[3, 9, 4], [7, 0, 1]]), [1, 0], id="most spikes"),
        pytest.param(one_module([[8, 6]], shown=[4, 2]), [1], id="2 and 3 a presentation"),
        pytest.param(one_module([[0, 6, 6, 2], [4, 1, 4, 4]]), [1, 0], id="of equals the first"),
        pytest.param(one_module([[1, 2, 7]], shown=[3, 6, 21]), [0], id="equal means of different sums"),
        pytest.param(one_module([[5, 5]], places=[17, 3]), [17], id="first in the module, not on the route"),
        pytest.param(one_module([[0, 0, 0], [0, 0, 1]]), [-1, 2], id="never fired"),
        pytest.param(one_module([[0, 2], [0, 0]], shown=[0, 3]), [1, -1], id="a label that was not shown"),
        pytest.param(one_module([[2, 0, 0]], [5, 0, 0], [3, -1, -1]), [3], id="a smaller last module"),
    ],
)
def test_a_neuron_speaks_for_the_place_with_most_spikes_a_presentation(learnt, expected):
    assert labels(learnt).tolist() == [expected]
    assert labels(learnt).dtype == np.int64


def test_more_than_a_tenth_of_the_spikes_speak_for_a_place_and_are_divided_from_a_fiftieth_of_the_places_on():
    sums = np.array([[[9, 1], [0, 0]], [[17, 2], [0, 0]]], np.float32)  # 1 of 10, 2 of 19
    learnt = Responses(sums, np.full((2, 2), 10), np.array([[0, 1], [2, 3]]))
    scores = scoring.weighted(np.array([[[1, 0], [1, 0]]]), learnt, np.zeros((2, 2), np.bool_), 1000)
    assert scores[0, :4] == pytest.approx([9 / 10, 0, 17 / 19, 2 / 19], rel=1e-6)
    learnt = Responses(np.array([[[90, 5, 5]]], np.float32), np.full((1, 3), 10), np.array([[7, 8, 9]]))
    for n_places, divided in ((150, 1 / 3), (151, 1.0)):
        score = scoring.weighted(np.array([[[1]]]), learnt, np.zeros((1, 1), np.bool_), n_places)[0, 7]
        assert score == pytest.approx(divided * 0.9, rel=1e-6)


@pytest.mark.parametrize("n_places", [23, 180])  # weighted: neurons of one place are divided, or those of four alone
@pytest.mark.parametrize(
    ("seed", "n_queries", "block_cells"), [(0, 7, 1), (1, 7, 61), (3, 7, 1 << 20), (0, 0, 1 << 20)]
)
def test_scores_are_those_of_a_loop_over_queries_and_places_in_blocks_of_any_size(
    monkeypatch, seed, n_queries, block_cells, n_places
):
    learnt = network(seed)
    random, shape = np.random.default_rng([seed, 1]), learnt.sums.shape[:2]
    responses = random.integers(1, 8, (n_queries, *shape)) * (random.random((n_queries, *shape)) < 0.3)
    silenced = random.random(shape) < 0.2
    spoken_for = labels(learnt)
    assert not np.isin(np.arange(23), spoken_for).all()
    assert (spoken_for == -1).any()
    monkeypatch.setattr(scoring, "_BLOCK_CELLS", block_cells)
    standard = scoring.standard(responses.astype(np.uint8), spoken_for, silenced, n_places)
    assert standard.dtype == np.float32
    assert np.allclose(standard, standard_slowly(responses, spoken_for, silenced, n_places), rtol=1e-6, atol=0)
    weighted = scoring.weighted(responses, learnt, silenced, n_places)
    expected = weighted_slowly(responses, learnt, silenced, n_places)
    assert weighted.dtype == np.float32
    assert weighted.shape == expected.shape
    assert np.allclose(weighted, expected, rtol=1e-6, atol=0)


def test_a_query_is_normalised_from_its_lowest_score_to_a_sum_of_one():
    scores = np.array([[2, 5, 3, 2], [0, 0, 0, 8], [0, 0, 0, 0], [-np.inf] * 4], np.float32)
    before = scores.copy()
    # (s - min) / (max - min): 0, 1, 1/3, 0, whose sum is 4/3; where all are equal they stay
    expected = np.array([[0, 3 / 4, 1 / 4, 0], [0, 0, 0, 1], [0, 0, 0, 0], [-np.inf] * 4])
    assert scoring.normalised(scores) == pytest.approx(expected, rel=1e-6)
    assert np.array_equal(scores, before)


def test_a_query_to_which_no_neuron_that_counts_responds_matches_no_place():
    responses, silent = np.array([[[0, 0]], [[5, 0]], [[5, 1]]]), [-np.inf] * 2
    for silenced, expected in (([], [silent, [5, 0], [5, 1]]), ([0], [silent, silent, [0, 1]]), ([0, 1], [silent] * 3)):
        mute = np.isin([[0, 1]], silenced)
        found = scoring.no_match(scoring.standard(responses, np.array([[0, 1]]), mute, 2), responses[:, ~mute])
        assert found.tolist() == expected
        assert found.dtype == np.float32


SILENT = [-np.inf, -np.inf]


def test_a_neuron_is_hyperactive_from_the_threshold_on_and_none_for_a_threshold_of_0():
    assert scoring.hyperactive(np.array([[0, 19, 20], [21, 5, 40]]), 20).tolist() == [[0, 0, 1], [1, 0, 1]]
    assert not scoring.hyperactive(np.array([[0, 7, 3000]]), 0).any()


@pytest.mark.parametrize(
    ("scores", "right", "best"),
    [
        pytest.param({0: [[0, 1], [1, 0]], 5: [[1, 0], [0, 1]], 10: [[1, 0], [1, 0]]}, [0, 1], 5, id="highest recall"),
        pytest.param({10: [[1, 0]], 0: [[1, 0]], 5: [[1, 0]]}, [0], 10, id="of equals the first"),
        pytest.param({0: [[3, 3, 0], [0, 3, 3]], 20: [[2, 1, 0], [3, 0, 0]]}, [0, 1], 20, id="a tie is wrong"),
        pytest.param({0: [SILENT, [1, 0], SILENT], 5: [[1, 0], [1, 0], SILENT]}, [0, 0, 0], 5, id="silence is wrong"),
    ],
)
def test_the_threshold_with_the_highest_recall_at_one_is_chosen(scores, right, best):
    found = scoring.best_threshold(lambda t: np.array(scores[t], np.float32), np.array(right), [*scores])
    assert found == best

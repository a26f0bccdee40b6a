"""What VPRSNN's neurons say of a query: standard and weighted scores, silenced neurons, silent queries, thresholds."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from vprbench.api.arrays import Scores
from vprbench.methods.vprsnn import scoring
from vprbench.methods.vprsnn.scoring import Learnt, labels
from vprbench.methods.vprsnn.training_sets import modules
from vprbench.metrics.accuracy import average_precision, pr_curve, recall_at
from vprbench.metrics.ranking import outcome

Array = npt.NDArray[np.int64]
Mask = npt.NDArray[np.bool_]


def network(seed: int, n_places: int = 23, per_module: int = 5, n_neurons: int = 9) -> Learnt:
    """Return modules in shuffled order, the last with fewer places; neurons fired for none, some or all of theirs."""
    random = np.random.default_rng(seed)
    groups = modules(n_places, per_module, "shuffled", seed, 4)
    places = np.full((len(groups), per_module), -1)
    for module, group in enumerate(groups):
        places[module, : len(group)] = group
    shape = len(groups), n_neurons, per_module
    fired = random.random(shape) < random.choice([0, 0.3, 1], shape[:2])[:, :, None]
    sums = np.where(fired & (places >= 0)[:, None], random.integers(1, 40, shape), 0)
    return Learnt(sums.astype(np.float32), np.where(places >= 0, 10, 0), places)


def drawn_responses(seed: int, n_queries: int, learnt: Learnt) -> Array:
    random = np.random.default_rng([seed, 1])
    shape = n_queries, *learnt.sums.shape[:2]
    return random.integers(1, 8, shape) * (random.random(shape) < 0.3)


def drawn_mask(seed: int, learnt: Learnt, share: float = 0.2) -> Mask:
    return np.random.default_rng([seed, 2]).random(learnt.sums.shape[:2]) < share


def nobody(learnt_or_labels: Learnt | Array) -> Mask:
    of = learnt_or_labels.sums[..., 0] if isinstance(learnt_or_labels, Learnt) else learnt_or_labels
    return np.zeros(of.shape, np.bool_)


def standard_one_by_one(responses: Array, spoken_for: Array, silenced: Mask, n_places: int) -> Scores:
    """Score query by query and place by place: spikes of the place's neurons by the number of them."""
    scores = np.zeros((len(responses), n_places))
    for query, heard in enumerate(responses):
        spikes = [0 if mute else int(count) for mute, count in zip(silenced.ravel(), heard.ravel(), strict=True)]
        for place in range(n_places):
            own = [n for n, label in enumerate(spoken_for.ravel().tolist()) if label == place]
            if own:
                scores[query, place] = sum(spikes[n] for n in own) / len(own)
    return scores.astype(np.float32)


def weighted_one_by_one(responses: Array, learnt: Learnt, silenced: Mask, n_places: int) -> Scores:
    """Score query by query and place by place, with a dictionary of training spikes for each neuron."""
    memory: list[dict[int, float]] = []
    for module, neurons in enumerate(learnt.sums):
        for sums in neurons:
            by_place = zip(learnt.places[module].tolist(), sums.tolist(), strict=True)
            memory.append({place: spikes for place, spikes in by_place if spikes > 0})
    scores = np.zeros((len(responses), n_places))
    for query, heard in enumerate(responses):
        spikes = np.where(silenced, 0, heard).ravel().astype(float)
        for place in range(n_places):
            own = [n for n, c in enumerate(memory) if place in c and c[place] / sum(c.values()) > 0.1]
            if not own:
                continue
            total = 0.0
            for n in own:
                t = spikes[n]
                if len(memory[n]) >= 0.02 * n_places:
                    t /= len(memory[n])
                total += t * memory[n][place] / sum(memory[n].values())
            involved = sum(memory[n][place] for n in own if spikes[n] != 0) / sum(memory[n][place] for n in own)
            scores[query, place] = total * involved
    return scores.astype(np.float32)


# --- hyperactive neurons ----------------------------------------------------------------------------------------


def test_a_neuron_is_hyperactive_from_the_threshold_on() -> None:
    assert scoring.hyperactive(np.array([[0, 19, 20], [21, 5, 40]]), 20).tolist() == [
        [False, False, True],
        [True, False, True],
    ]


def test_a_threshold_of_zero_silences_nobody() -> None:
    assert not scoring.hyperactive(np.array([[0, 7, 3000]]), 0).any()


# --- standard ---------------------------------------------------------------------------------------------------


def test_a_place_scores_the_mean_spikes_of_its_neurons_in_whichever_module_they_are() -> None:
    spoken_for = np.array([[2, 0, 2], [1, -1, 1]])
    responses = np.array([[[4, 1, 1], [0, 9, 3]], [[0, 0, 7], [6, 0, 0]]])
    scores = scoring.standard(responses, spoken_for, nobody(spoken_for), 3)
    assert scores.tolist() == [[1, 1.5, 2.5], [0, 3, 3.5]]
    assert scores.dtype == np.float32


def test_a_place_no_neuron_learnt_scores_zero() -> None:
    spoken_for = np.array([[3, 0]])
    assert scoring.standard(np.array([[[2, 5]]]), spoken_for, nobody(spoken_for), 5).tolist() == [[5, 0, 0, 2, 0]]


def test_neurons_that_speak_for_no_place_are_not_heard() -> None:
    spoken_for = np.array([[-1, 0, -1]])
    assert scoring.standard(np.array([[[9, 0, 9]]]), spoken_for, nobody(spoken_for), 2).tolist() == [[0, 0]]


def test_a_silenced_neuron_is_not_heard_but_the_mean_is_over_it_too() -> None:
    spoken_for = np.array([[0, 0, 1]])
    silenced = np.array([[True, False, False]])
    assert scoring.standard(np.array([[[6, 3, 1]]]), spoken_for, silenced, 2).tolist() == [[1.5, 1]]


def test_a_place_all_of_whose_neurons_are_silenced_scores_zero() -> None:
    spoken_for = np.array([[0, 0, 1]])
    silenced = np.array([[True, True, False]])
    assert scoring.standard(np.array([[[6, 3, 1]]]), spoken_for, silenced, 2).tolist() == [[0, 1]]


@pytest.mark.parametrize("seed", range(3))
def test_standard_scores_are_those_of_a_loop_over_queries_and_places(seed: int) -> None:
    learnt = network(seed)
    responses, silenced, spoken_for = drawn_responses(seed, 7, learnt), drawn_mask(seed, learnt), labels(learnt)
    assert not np.isin(np.arange(23), spoken_for).all()
    assert (spoken_for == -1).any()
    expected = standard_one_by_one(responses, spoken_for, silenced, 23)
    assert np.array_equal(scoring.standard(responses, spoken_for, silenced, 23), expected)


# --- weighted ---------------------------------------------------------------------------------------------------


def test_a_weighted_score_by_hand() -> None:
    # Of 200 places a neuron counts as involved in many from 4 on. Neuron 0: 30 of its 40 spikes were for place 0, 10
    # for place 1. Neuron 1: 20 for place 0 alone. Neuron 2: four places, of which place 3 drew no more than a tenth.
    sums = np.array([[[30, 10, 0, 0], [20, 0, 0, 0], [20, 20, 50, 10]]], np.float32)
    learnt = Learnt(sums, np.full((1, 4), 10), np.array([[0, 1, 2, 3]]))
    scores = scoring.weighted(np.array([[[4, 0, 2]]]), learnt, nobody(learnt), 200)
    place_0 = (4 * 30 / 40 + 2 / 4 * 20 / 100) * (30 + 20) / (30 + 20 + 20)
    place_1 = (4 * 10 / 40 + 2 / 4 * 20 / 100) * 1
    place_2 = 2 / 4 * 50 / 100 * 1
    assert scores[0, :4] == pytest.approx([place_0, place_1, place_2, 0], rel=1e-6)
    assert not scores[0, 4:].any()


def test_a_tenth_of_the_spikes_is_not_enough_to_speak_for_a_place_and_a_little_more_is() -> None:
    sums = np.array([[[9, 1], [0, 0]], [[17, 2], [0, 0]]], np.float32)  # 1 of 10, 2 of 19
    learnt = Learnt(sums, np.full((2, 2), 10), np.array([[0, 1], [2, 3]]))
    scores = scoring.weighted(np.array([[[1, 0], [1, 0]]]), learnt, nobody(learnt), 1000)
    assert scores[0, :4] == pytest.approx([9 / 10, 0, 17 / 19, 2 / 19], rel=1e-6)


@pytest.mark.parametrize(("n_places", "expected"), [(150, 1 / 3), (151, 1.0)])
def test_spikes_are_divided_from_a_fiftieth_of_the_places_on(n_places: int, expected: float) -> None:
    learnt = Learnt(np.array([[[90, 5, 5]]], np.float32), np.full((1, 3), 10), np.array([[7, 8, 9]]))
    score = scoring.weighted(np.array([[[1]]]), learnt, nobody(learnt), n_places)[0, 7]
    assert score == pytest.approx(expected * 0.9, rel=1e-6)


def test_a_place_scores_less_where_neurons_that_learnt_it_keep_silent() -> None:
    sums = np.array([[[10, 0], [30, 0], [0, 10]]], np.float32)
    learnt = Learnt(sums, np.full((1, 2), 10), np.array([[0, 1]]))
    scores = scoring.weighted(np.array([[[3, 0, 3]], [[0, 3, 3]]]), learnt, nobody(learnt), 1000)
    assert scores[:, :2] == pytest.approx(np.array([[3 / 4, 3], [9 / 4, 3]]), rel=1e-6)


def test_a_silenced_neuron_counts_in_the_weighted_score_as_one_that_keeps_silent() -> None:
    learnt = network(5)
    responses, silenced = drawn_responses(5, 6, learnt), drawn_mask(5, learnt, 0.5)
    silent = np.where(silenced, 0, responses)
    assert not np.array_equal(silent, responses)
    found = scoring.weighted(responses, learnt, silenced, 23)
    assert np.allclose(found, scoring.weighted(silent, learnt, nobody(learnt), 23), rtol=1e-6)


def test_a_place_that_drew_no_spikes_has_a_weighted_score_of_zero() -> None:
    learnt = Learnt(np.array([[[4, 0], [0, 0]]], np.float32), np.full((1, 2), 10), np.array([[1, 0]]))
    assert scoring.weighted(np.array([[[2, 6]]]), learnt, nobody(learnt), 1000)[0, :2].tolist() == [0, 2]


@pytest.mark.parametrize("n_places", [23, 180])  # neurons of one place are divided, or those of four alone
@pytest.mark.parametrize("seed", range(3))
def test_weighted_scores_are_those_of_a_loop_over_queries_and_places(seed: int, n_places: int) -> None:
    learnt = network(seed)
    responses, silenced = drawn_responses(seed, 7, learnt), drawn_mask(seed, learnt)
    found = scoring.weighted(responses, learnt, silenced, n_places)
    expected = weighted_one_by_one(responses, learnt, silenced, n_places)
    assert found.dtype == np.float32
    assert np.allclose(found, expected, rtol=1e-6, atol=0)


# --- queries in blocks ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("block_cells", [1, 61, 200])  # below one query, one query, three of seven
def test_scores_do_not_depend_on_how_many_queries_are_taken_at_once(
    monkeypatch: pytest.MonkeyPatch, block_cells: int
) -> None:
    learnt = network(1)
    responses, silenced = drawn_responses(1, 7, learnt), drawn_mask(1, learnt)
    whole = [
        scoring.standard(responses, labels(learnt), silenced, 23),
        scoring.weighted(responses, learnt, silenced, 23),
    ]
    monkeypatch.setattr(scoring, "_BLOCK_CELLS", block_cells)
    assert np.array_equal(scoring.standard(responses, labels(learnt), silenced, 23), whole[0])
    assert np.array_equal(scoring.weighted(responses, learnt, silenced, 23), whole[1])


def test_no_query_has_no_scores() -> None:
    learnt = network(0)
    none = drawn_responses(0, 0, learnt)
    assert scoring.standard(none, labels(learnt), nobody(learnt), 23).shape == (0, 23)
    assert scoring.weighted(none, learnt, nobody(learnt), 23).shape == (0, 23)
    assert scoring.no_match(np.empty((0, 23), np.float32), none).shape == (0, 23)


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.int32])
def test_small_whole_numbers_do_not_overflow(kind: type[np.integer]) -> None:
    spoken_for = np.zeros((1, 600), np.int64)
    scores = scoring.standard(np.full((1, 1, 600), 120, kind), spoken_for, nobody(spoken_for), 1)
    assert scores.tolist() == [[120]]


# --- several networks -------------------------------------------------------------------------------------------


def test_scores_of_networks_that_shuffled_their_places_differently_add_up_place_by_place() -> None:
    n_places = 40
    total = np.zeros((n_places, n_places), np.float32)
    for seed in (0, 10):
        places = np.stack(modules(n_places, 10, "shuffled", seed, 5))
        learnt = Learnt(np.tile(np.eye(10, dtype=np.float32), (4, 1, 1)), np.ones((4, 10), np.int64), places)
        responses = np.zeros((n_places, 4, 10), np.int64)
        for module, neuron in np.ndindex(4, 10):
            responses[places[module, neuron], module, neuron] = 3  # the neuron that learnt the place that is shown
        total += scoring.standard(responses, labels(learnt), nobody(learnt), n_places)
    assert np.array_equal(total, 6 * np.eye(n_places))


# --- normalisation ----------------------------------------------------------------------------------------------


def test_a_query_is_normalised_from_its_lowest_score_to_its_highest_and_then_to_a_sum_of_one() -> None:
    scores = np.array([[2, 5, 3, 2], [0, 0, 0, 8]], np.float32)
    # (s - min) / (max - min): 0, 1, 1/3, 0, whose sum is 4/3
    assert scoring.normalised(scores) == pytest.approx(np.array([[0, 3 / 4, 1 / 4, 0], [0, 0, 0, 1]]), rel=1e-6)


def test_normalisation_leaves_the_order_of_places_and_its_input_as_they_are() -> None:
    scores = np.random.default_rng(0).random((5, 30)).astype(np.float32)
    before = scores.copy()
    result = scoring.normalised(scores)
    assert np.array_equal(result.argsort(1), scores.argsort(1))
    assert result.sum(1) == pytest.approx(np.ones(5), rel=1e-5)
    assert np.array_equal(scores, before)


def test_a_query_that_tells_no_places_apart_is_not_normalised() -> None:
    scores = np.array([[0, 0], [-np.inf, -np.inf], [0, 4]], np.float32)
    assert scoring.normalised(scores).tolist() == [[0, 0], [-np.inf, -np.inf], [0, 1]]


# --- silent queries ---------------------------------------------------------------------------------------------


def test_a_query_to_which_nobody_responds_matches_no_place_and_the_others_keep_their_scores() -> None:
    responses = np.array([[[0, 0], [0, 0]], [[0, 0], [2, 0]]])
    spoken_for = np.array([[0, 1], [2, 2]])
    scores = scoring.standard(responses, spoken_for, nobody(spoken_for), 3)
    given = scoring.no_match(scores, responses)
    assert given.tolist() == [[-np.inf] * 3, [0, 0, 1]]
    assert given.dtype == np.float32


def test_a_silent_query_is_judged_a_miss_even_where_the_right_place_is_the_first() -> None:
    responses = np.array([[[0, 0]], [[0, 1]], [[0, 0]]])
    spoken_for = np.array([[0, 1]])
    scores = scoring.no_match(scoring.standard(responses, spoken_for, nobody(spoken_for), 2), responses)
    judged = outcome(scores, [np.array([0]), np.array([1]), np.array([1])])
    for n in (1, 2):  # at every depth: it is no guess, and no candidate either
        recall = recall_at(judged, n)
        assert recall is not None
        assert (recall.expected, recall.pessimistic, recall.optimistic) == (1 / 3, 1 / 3, 1 / 3)
    curve = pr_curve(judged, "A")  # it retrieves nothing, so it is no false positive
    assert curve is not None
    assert curve.precision.tolist() == [1, 1]
    assert average_precision(curve) == pytest.approx(1 / 3)


def test_a_query_to_which_only_silenced_neurons_respond_matches_no_place() -> None:
    responses = np.array([[[5, 0]], [[5, 1]]])
    silenced = np.array([[True, False]])
    scores = scoring.standard(responses, np.array([[0, 1]]), silenced, 2)
    assert scoring.no_match(scores, responses[:, ~silenced]).tolist() == [[-np.inf, -np.inf], [0, 1]]


def test_where_every_neuron_is_silenced_no_query_matches_a_place() -> None:
    responses = np.ones((2, 1, 3), np.int64)
    silenced = np.ones((1, 3), np.bool_)
    scores = scoring.standard(responses, np.array([[0, 1, 1]]), silenced, 2)
    assert np.isneginf(scoring.no_match(scores, responses[:, ~silenced])).all()


# --- the threshold by held-out places ---------------------------------------------------------------------------


def given(by_threshold: dict[int, list[list[float]]]) -> Callable[[int], Scores]:
    return lambda threshold: np.array(by_threshold[threshold], np.float32)


def test_the_threshold_with_the_highest_recall_at_one_is_chosen_and_all_recalls_are_told() -> None:
    scores = given(
        {
            0: [[0, 1, 0], [1, 0, 0], [1, 0, 0]],
            5: [[1, 0, 0], [0, 1, 0], [1, 0, 0]],
            10: [[1, 0, 0], [0, 0, 1], [1, 0, 0]],
        }
    )
    best, recalls = scoring.best_threshold(scores, np.array([0, 1, 2]), (0, 5, 10))
    assert best == 5
    assert recalls == pytest.approx({0: 0, 5: 2 / 3, 10: 1 / 3})


@pytest.mark.parametrize("candidates", [(0, 5, 10), (10, 5, 0)])
def test_of_equal_thresholds_it_is_the_first_candidate(candidates: tuple[int, ...]) -> None:
    scores = given({0: [[1, 0]], 5: [[1, 0]], 10: [[1, 0]]})
    assert scoring.best_threshold(scores, np.array([0]), candidates)[0] == candidates[0]


def test_a_tie_for_the_best_place_counts_as_wrong_in_the_choice() -> None:
    scores = given({0: [[3, 3, 0], [0, 3, 3]], 20: [[2, 1, 0], [3, 0, 0]]})
    assert scoring.best_threshold(scores, np.array([0, 1]), (0, 20)) == (20, {0: 0, 20: 0.5})


def test_a_silent_query_counts_as_wrong_in_the_choice() -> None:
    silent = [-np.inf, -np.inf]
    scores = given({0: [[1, 0], [0, 1], [0, 1]], 5: [silent, [1, 0], silent]})
    assert scoring.best_threshold(scores, np.array([0, 0, 0]), (0, 5)) == (0, {0: 1 / 3, 5: 1 / 3})


def test_silencing_a_neuron_that_fires_for_everything_is_found_to_help() -> None:
    # Neuron 0 learnt place 0 and fires most, whatever is shown; the others fire for their places.
    spoken_for = np.array([[0, 1], [0, 2]])
    responses = np.array([[[9, 0], [1, 0]], [[9, 4], [0, 0]], [[9, 0], [0, 4]]])
    reactions = np.array([[30, 6], [6, 5]])

    def scores(threshold: int) -> Scores:
        silenced = scoring.hyperactive(reactions, threshold)
        return scoring.no_match(scoring.standard(responses, spoken_for, silenced, 3), responses[:, ~silenced])

    best, recalls = scoring.best_threshold(scores, np.array([0, 1, 2]), (0, 5, 10, 40))
    assert best == 10
    assert recalls == pytest.approx({0: 1 / 3, 5: 0, 10: 1, 40: 1 / 3})

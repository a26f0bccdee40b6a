"""Asking a trained VPRTempo network: a single query, a batch and several networks against Eq. 1 in float64."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
import torch

from vprbench.methods.vprtempo.network import Network
from vprbench.methods.vprtempo.query import LinearQuery, MeanQuery, Query, SpikingQuery, asking
from vprbench.methods.vprtempo.rules import PAPER, REFERENCE, V1, Rules

Floats = npt.NDArray[np.float64]
Spikes = npt.NDArray[np.float32]  # (n_queries, n_pixels)

N_PIXELS = 20
SIZES = [[5, 5, 3], [7], [1], [2, 1]]  # places of each module


def tensor(array: npt.NDArray[np.floating]) -> torch.Tensor:
    return torch.from_numpy(array.astype(np.float32))


def network(sizes: Sequence[int], n_features: int = 37, n_pixels: int = N_PIXELS, seed: int = 0) -> Network:
    """Draw a network in which about half of all neurons spike and some reach the clip."""
    draw, modules = np.random.default_rng(seed), len(sizes)
    return Network(
        features=tensor(draw.normal(0, 1.2 / n_pixels**0.5, (modules, n_features, n_pixels))),
        constant=tensor(draw.uniform(0, 0.1, (modules, n_features))),
        feature_thresholds=tensor(draw.uniform(0, 0.2, (modules, n_features))),
        outputs=tuple(tensor(draw.normal(0, 3 / n_features**0.5, (n_features, size))) for size in sizes),
        output_thresholds=tuple(tensor(draw.uniform(0, 0.2, size)) for size in sizes),
    )


def shown(count: int, n_pixels: int = N_PIXELS, seed: int = 1) -> Spikes:
    return np.random.default_rng(seed).uniform(0, 1, (count, n_pixels)).astype(np.float32)


def feature_spikes(asked: Network, x: Floats, clip: float) -> Floats:
    """Return the feature spikes (modules, n_features) of one input by Eq. 1."""
    parts = (asked.features, asked.constant, asked.feature_thresholds)
    weights, constant, thresholds = (part.numpy().astype(np.float64) for part in parts)
    return np.clip(weights @ x + constant - thresholds, 0, clip)


def eq_1(asked: Network, spikes: Spikes, rules: Rules) -> Floats:
    """Return the scores (n_queries, n_places) by Eq. 1 in both layers, query by query and module by module."""
    rows = []
    for x in spikes.astype(np.float64):
        above = [
            weights.numpy().astype(np.float64).T @ active - thresholds.numpy().astype(np.float64)
            for weights, thresholds, active in zip(
                asked.outputs, asked.output_thresholds, feature_spikes(asked, x, rules.clip), strict=True
            )
        ]
        row = np.clip(np.concatenate(above), 0, rules.clip)
        if rules.silent_winner and not row.any():
            row[above[0].argmax()] = 0.5
        rows.append(row)
    return np.array(rows)


def products(members: Sequence[Network], spikes: Spikes) -> Floats:
    """Return the mean over the members of W_o W_f x, (n_queries, n_places)."""
    scores = [
        np.concatenate(
            [
                w_o.numpy().astype(np.float64).T @ (w_f.numpy().astype(np.float64) @ spikes.T.astype(np.float64))
                for w_f, w_o in zip(member.features, member.outputs, strict=True)
            ]
        ).T
        for member in members
    ]
    return np.mean(scores, axis=0)


def one_by_one(query: Query, spikes: Spikes) -> Spikes:
    return np.concatenate([query.scores(x[None]) for x in spikes])


def in_a_batch(query: Query, spikes: Spikes) -> Spikes:
    return query.scores(spikes)


WAYS = pytest.mark.parametrize("ask", [one_by_one, in_a_batch])
Ask = Callable[[Query, Spikes], Spikes]
RULES = pytest.mark.parametrize("rules", [PAPER, V1, replace(PAPER, clip=0.3)], ids=["paper", "v1", "clip 0.3"])
KINDS = pytest.mark.parametrize("rules", [PAPER, V1, REFERENCE], ids=["paper", "v1", "reference"])


# --- Eq. 1 ------------------------------------------------------------------------------------------------------


def test_a_query_worked_by_hand_passes_constant_thresholds_and_clip_of_both_layers() -> None:
    # Features: 1 * 0.5 + 0.1 - 0.2 = 0.4;  2 * 1 + 0 - 0.5 = 1.5, clipped to 0.9;  -1 * 0.5 + 0.1 = -0.4, silent.
    # Places: 0.4 + 0.5 * 0.9 - 0.25 = 0.6;  0.4 - 0.9 = -0.5, silent;  2 * 0.9 - 0.1 = 1.7, clipped to 0.9.
    asked = Network(
        features=torch.tensor([[[1.0, 0.0], [0.0, 2.0], [-1.0, 0.0]]]),
        constant=torch.tensor([[0.1, 0.0, 0.1]]),
        feature_thresholds=torch.tensor([[0.2, 0.5, 0.0]]),
        outputs=(torch.tensor([[1.0, 1.0, 0.0], [0.5, -1.0, 2.0], [9.0, 9.0, 9.0]]),),
        output_thresholds=(torch.tensor([0.25, 0.0, 0.1]),),
    )
    spikes = np.array([[0.5, 1.0]] * 2, np.float32)
    for ask in (one_by_one, in_a_batch):
        assert ask(SpikingQuery(asked, PAPER), spikes) == pytest.approx(np.array([[0.6, 0.0, 0.9]] * 2), abs=1e-6)


@WAYS
@RULES
@pytest.mark.parametrize("sizes", SIZES, ids=str)
def test_a_spiking_query_is_eq_1(sizes: list[int], rules: Rules, ask: Ask) -> None:
    asked, spikes = network(sizes), shown(9)
    expected = eq_1(asked, spikes, rules)
    assert ask(SpikingQuery(asked, rules), spikes) == pytest.approx(expected, abs=1e-6)


def test_the_networks_of_these_tests_have_silent_graded_and_clipped_neurons_in_both_layers() -> None:
    asked, spikes = network([5, 5, 3]), shown(9)
    features = np.array([feature_spikes(asked, x, 0.9) for x in spikes.astype(np.float64)])
    for layer in (features, eq_1(asked, spikes, PAPER)):
        assert min(np.mean(layer == 0), np.mean(layer == 0.9), np.mean((layer > 0) & (layer < 0.9))) > 0.03


def chosen(active: Sequence[int], n_features: int) -> Spikes:
    """Return an input under which a network of one pixel a feature has these active."""
    x = np.zeros(n_features, np.float32)
    x[list(active)] = np.random.default_rng(len(active)).uniform(0.4, 1, len(active))
    return x


@WAYS
@pytest.mark.parametrize("rules", [PAPER, V1], ids=["paper", "v1"])
@pytest.mark.parametrize("count", [0, 1, 2, 7, 8, 9, 15, 16, 17, 29, 30])
def test_any_number_of_active_features_is_added_up(count: int, rules: Rules, ask: Ask) -> None:
    asked = network([5, 5, 3], n_features=30, n_pixels=30)
    one_pixel_a_feature = torch.eye(30).repeat(3, 1, 1)
    asked = replace(asked, features=one_pixel_a_feature, feature_thresholds=asked.constant + 0.3)
    active = np.random.default_rng(2).permutation(30)[:count].tolist()
    spikes = np.stack([chosen(active, 30), chosen(sorted(active), 30)])
    spiking = feature_spikes(asked, spikes[0].astype(np.float64), 0.9)
    assert [np.flatnonzero(row).tolist() for row in spiking] == [sorted(active)] * 3
    assert ask(SpikingQuery(asked, rules), spikes) == pytest.approx(eq_1(asked, spikes, rules), abs=1e-6)


@WAYS
def test_modules_may_have_different_numbers_of_active_features(ask: Ask) -> None:
    asked = network([4, 4, 2], n_features=24, n_pixels=24)
    thresholds = torch.full((3, 24), 5.0)
    thresholds[1, :9] = 0  # module 0 has none active, module 1 has 9, module 2 has all
    thresholds[2] = 0
    asked = replace(asked, features=torch.eye(24).repeat(3, 1, 1), feature_thresholds=thresholds)
    spikes = shown(3, 24) + np.float32(0.01)
    assert ask(SpikingQuery(asked, PAPER), spikes) == pytest.approx(eq_1(asked, spikes, PAPER), abs=1e-6)


@pytest.mark.parametrize("n_pixels", [1, 7, 8, 9, 65])
@WAYS
def test_any_number_of_pixels_is_added_up(n_pixels: int, ask: Ask) -> None:
    asked, spikes = network([4, 1], n_pixels=n_pixels), shown(3, n_pixels)
    assert ask(SpikingQuery(asked, PAPER), spikes) == pytest.approx(eq_1(asked, spikes, PAPER), abs=1e-6)


@pytest.mark.parametrize("count", [2, 255, 256, 257, 513])
@KINDS
def test_a_batch_of_any_size_answers_every_query_in_its_place(rules: Rules, count: int) -> None:
    asked, spikes = network([5, 5, 3]), shown(count)
    expected = products([asked], spikes) if rules is REFERENCE else eq_1(asked, spikes, rules)
    assert asking([asked], rules).scores(spikes) == pytest.approx(expected, abs=2e-6)


def test_a_single_query_reads_no_output_weights_of_silent_features() -> None:
    asked, spikes = network([5, 3]), shown(1)
    expected = eq_1(asked, spikes, PAPER)
    spiking = feature_spikes(asked, spikes[0].astype(np.float64), 0.9)
    for weights, active in zip(asked.outputs, spiking, strict=True):
        assert (active == 0).any()
        weights[torch.from_numpy(active == 0)] = torch.nan
    assert SpikingQuery(asked, PAPER).scores(spikes) == pytest.approx(expected, abs=1e-6)


# --- the silent winner of v1 ------------------------------------------------------------------------------------


def silent_everywhere_but(query: int, count: int) -> tuple[Network, Spikes]:
    """Return a network that answers one of `count` queries, the only one that shows its first pixel."""
    asked = network([5, 5, 3])
    features = asked.features.clone()
    features[:, 0, 0] = 3
    outputs = tuple(-weights.abs() for weights in asked.outputs)
    outputs[2][0, 1] = 500
    spikes = shown(count)
    spikes[:, 0] = 0
    features[:, 0, 1:] = -1
    spikes[query] = 0
    spikes[query, 0] = 1
    return replace(asked, features=features, outputs=outputs), spikes


@WAYS
def test_v1_lets_module_0_answer_where_all_are_silent_and_only_there(ask: Ask) -> None:
    asked, spikes = silent_everywhere_but(4, 9)
    expected = eq_1(asked, spikes, V1)
    assert expected[4, 11] == 0.9
    assert [np.count_nonzero(row == 0.5) for row in expected] == [1, 1, 1, 1, 0, 1, 1, 1, 1]
    assert len(set(expected.argmax(1).tolist())) > 2  # not always the same place
    assert ask(SpikingQuery(asked, V1), spikes) == pytest.approx(expected, abs=1e-6)


@WAYS
def test_paper_gives_zeros_where_all_are_silent(ask: Ask) -> None:
    asked, spikes = silent_everywhere_but(4, 9)
    found = ask(SpikingQuery(asked, PAPER), spikes)
    assert np.flatnonzero(found.any(1)).tolist() == [4]


@WAYS
def test_v1_falls_back_on_the_lowest_threshold_where_not_even_a_feature_spikes(ask: Ask) -> None:
    asked = replace(network([3, 2]), constant=torch.zeros(2, 37))
    asked = replace(
        asked, output_thresholds=(torch.tensor([0.3, 0.1, 0.2]), torch.tensor([0.0, 0.05]))
    )  # the other module's are lower still
    black = np.zeros((2, N_PIXELS), np.float32)
    assert ask(SpikingQuery(asked, V1), black).tolist() == [[0, 0.5, 0, 0, 0]] * 2


# --- the public code's query ------------------------------------------------------------------------------------


@WAYS
@pytest.mark.parametrize("sizes", SIZES, ids=str)
def test_a_linear_query_is_the_product_of_both_weight_matrices(sizes: list[int], ask: Ask) -> None:
    asked, spikes = network(sizes), shown(9)
    assert ask(LinearQuery([asked]), spikes) == pytest.approx(products([asked], spikes), abs=2e-6)


@WAYS
@pytest.mark.parametrize("count", [2, 3])
def test_a_linear_query_of_several_networks_is_the_mean_of_theirs(count: int, ask: Ask) -> None:
    members, spikes = [network([5, 3], seed=seed) for seed in range(count)], shown(9)
    assert ask(LinearQuery(members), spikes) == pytest.approx(products(members, spikes), abs=2e-6)


# --- several networks -------------------------------------------------------------------------------------------


@WAYS
@pytest.mark.parametrize("rules", [PAPER, V1], ids=["paper", "v1"])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_several_spiking_networks_answer_with_their_mean_score(count: int, rules: Rules, ask: Ask) -> None:
    members, spikes = [network([5, 3], seed=seed) for seed in range(count)], shown(9)
    expected = np.mean([eq_1(member, spikes, rules) for member in members], axis=0)
    assert ask(asking(members, rules), spikes) == pytest.approx(expected, abs=1e-6)


def test_the_mean_of_scores_worked_by_hand() -> None:
    class Says:
        def __init__(self, row: list[float]) -> None:
            self.row = row

        def scores(self, spikes: Spikes) -> Spikes:
            return np.array([self.row] * len(spikes), np.float32)

    found = MeanQuery([Says([1, 2]), Says([0, 5]), Says([5, -1])]).scores(shown(2))
    assert (found.dtype, found.tolist()) == (np.float32, [[2.0, 2.0], [2.0, 2.0]])


# --- what a query leaves alone ----------------------------------------------------------------------------------


@pytest.fixture(params=["paper", "v1", "reference", "paper of two", "reference of two"])
def query(request: pytest.FixtureRequest) -> Query:
    name, _, several = request.param.partition(" of ")
    members = [network([5, 5, 3], seed=seed) for seed in range(2 if several else 1)]
    return asking(members, {"paper": PAPER, "v1": V1, "reference": REFERENCE}[name])


@pytest.mark.parametrize("count", [1, 2, 300])
def test_a_query_leaves_its_input_as_it_was(query: Query, count: int) -> None:
    spikes = shown(count)
    before = spikes.copy()
    query.scores(spikes)
    assert np.array_equal(spikes, before)


@pytest.mark.parametrize("later", [1, 2, 9])
@pytest.mark.parametrize("first", [1, 2, 9])
def test_an_answer_stays_as_it_was_whatever_is_asked_later(query: Query, first: int, later: int) -> None:
    answer = query.scores(shown(first))
    kept = answer.copy()
    query.scores(shown(later, seed=2))
    assert np.array_equal(answer, kept)


@pytest.mark.parametrize("count", [1, 9])
def test_an_answer_may_be_written_to_without_harm_to_later_ones(query: Query, count: int) -> None:
    answer = query.scores(shown(count))
    kept = answer.copy()
    answer[:] = 7
    assert np.array_equal(query.scores(shown(count)), kept)


def test_a_single_answer_does_not_depend_on_the_queries_before(query: Query) -> None:
    first = query.scores(shown(1))
    query.scores(shown(1, seed=2))
    query.scores(shown(9, seed=3))
    assert np.array_equal(query.scores(shown(1)), first)


@pytest.mark.parametrize("count", [1, 9])
def test_spikes_that_cannot_be_written_to_are_taken(query: Query, count: int) -> None:
    spikes = shown(count)
    expected = query.scores(spikes)
    spikes.flags.writeable = False
    assert query.scores(spikes) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("count", [1, 9])
def test_spikes_may_lie_apart_in_memory(query: Query, count: int) -> None:
    apart = np.repeat(np.repeat(shown(count), 2, axis=0), 3, axis=1)[::2, ::3]
    assert not apart.flags.c_contiguous
    assert query.scores(apart) == pytest.approx(query.scores(shown(count)), abs=1e-6)


@pytest.mark.parametrize("count", [0, 1, 2, 300])
def test_scores_are_finite_float32_a_row_for_each_query(query: Query, count: int) -> None:
    found = query.scores(shown(count))
    assert (found.dtype, found.shape) == (np.float32, (count, 13))
    assert np.isfinite(found).all()


# --- threads and libraries --------------------------------------------------------------------------------------


@pytest.fixture
def threads() -> Iterator[Callable[[int], None]]:
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@WAYS
@KINDS
def test_the_number_of_threads_changes_no_score(rules: Rules, ask: Ask, threads: Callable[[int], None]) -> None:
    asked, spikes = network([60, 60, 30], n_features=300, n_pixels=200), shown(40, 200)
    found = []
    for count in (1, 2):
        threads(count)
        found.append(ask(asking([asked], rules), spikes))
    assert found[0] == pytest.approx(found[1], abs=1e-6)


@WAYS
@KINDS
def test_without_onednn_a_query_gives_the_same(rules: Rules, ask: Ask, monkeypatch: pytest.MonkeyPatch) -> None:
    asked, spikes = network([5, 5, 3]), shown(300)
    expected = ask(asking([asked], rules), spikes)
    monkeypatch.setattr(torch.backends.mkldnn, "is_available", lambda: False)
    monkeypatch.setattr(torch.Tensor, "to_mkldnn", lambda _: pytest.fail("oneDNN was used"))
    assert ask(asking([asked], rules), spikes) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("name", "kind", "kernels"),
    [
        ("query", "SpikingQuery", ("_feature_spikes", "_add_active")),
        ("quantised", "Int8SpikingQuery", ("_multiply", "_write_levels")),
    ],
)
def test_the_first_query_waits_for_no_compiler(name: str, kind: str, kernels: tuple[str, ...]) -> None:
    where = importlib.import_module(f"vprbench.methods.vprtempo.{name}").__file__
    specification = importlib.util.spec_from_file_location(f"vprbench.methods.vprtempo.{name}_anew", where)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    compiled = [len(getattr(module, kernel).signatures) for kernel in kernels]
    getattr(module, kind)(network([5, 3]), PAPER).scores(shown(1))
    assert compiled == [len(getattr(module, kernel).signatures) for kernel in kernels] == [1, 1]


def test_several_threads_may_ask_one_network_at_once() -> None:
    query, spikes = SpikingQuery(network([40, 40, 7]), PAPER), shown(64)
    expected = np.concatenate([query.scores(one[None]) for one in spikes])
    with ThreadPoolExecutor(4) as threads:
        for _ in range(20):
            found = np.concatenate(list(threads.map(lambda one: query.scores(one[None]), spikes)))
            assert np.array_equal(found, expected)

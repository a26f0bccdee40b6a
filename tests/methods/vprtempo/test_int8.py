"""VPRTempo in 8 bits: its numbers against the scheme written down once more, and how near the float network is."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, get_args

import numpy as np
import numpy.typing as npt
import pytest
import torch
from checkout import ROOT
from tempo_networks import SIZES, WAYS, Ask, Floats, Spikes, double, network, one_by_one, one_layer, one_matrix, shown

from vprbench.api.dataset import Dataset
from vprbench.api.images import Images
from vprbench.errors import BadInput
from vprbench.methods.vprtempo.int8 import VPRTempoInt8
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.methods.vprtempo.network import Network
from vprbench.methods.vprtempo.quantised import Int8LinearQuery, Int8SpikingQuery
from vprbench.methods.vprtempo.query import Query
from vprbench.methods.vprtempo.rules import PAPER, V1, Rules, RuleSet
from vprbench.metrics import accuracy
from vprbench.metrics.ranking import outcome
from vprbench.plugins import networks
from vprbench.plugins.conformance import check
from vprbench.plugins.rules import EXTENDED_RULE, Journey
from vprbench.plugins.rules import RULES as CONFORMANCE


def linear(rows: npt.ArrayLike) -> Int8LinearQuery:
    """Return the query of a linear network whose one matrix has these rows."""
    return Int8LinearQuery([one_layer(np.asarray(rows, np.float32).T)])


# --- the scheme, written down once more in float64 --------------------------------------------------------------


def in_127_steps(weights: Floats) -> tuple[Floats, Floats]:
    """Return whole steps (n_out, n_in) and the size of a step of each row (n_out,)."""
    size = np.abs(weights).max(1) / 127
    return np.round(weights / np.where(size > 0, size, 1)[:, None]), size  # np.round takes halves to the even side


def in_255_levels(activation: Floats, most: float) -> Floats:
    return np.clip(np.round(activation * 255 / most), 0, 255)


def affine(weights: Floats, bias: Floats, levels: Floats, most: float) -> Floats:
    """Return (n_queries, n_out) of levels (n_queries, n_in), by whole sums."""
    steps, size = in_127_steps(weights)
    return (levels @ steps.T) * size * most / 255 + bias


def spiking_in_8_bits(asked: Network, spikes: Spikes, rules: Rules) -> Floats:
    levels = in_255_levels(spikes.astype(np.float64), 1)
    parts = []
    for module, outputs in enumerate(asked.outputs):
        bias = double(asked.constant[module]) - double(asked.feature_thresholds[module])
        active = in_255_levels(affine(double(asked.features[module]), bias, levels, 1), rules.clip)
        parts.append(affine(double(outputs).T, -double(asked.output_thresholds[module]), active, rules.clip))
    scores = np.clip(np.concatenate(parts, axis=1), 0, rules.clip)
    if rules.silent_winner:
        for row, first in zip(scores, parts[0], strict=True):
            if not row.any():
                row[first.argmax()] = 0.5
    return scores


@WAYS
@pytest.mark.parametrize(
    "rules", [PAPER, V1, replace(PAPER, clip=0.3), replace(PAPER, clip=1.0)], ids=["paper", "v1", "clip 0.3", "clip 1"]
)
@SIZES
def test_a_spiking_query_follows_the_scheme(sizes: list[int], rules: Rules, ask: Ask) -> None:
    asked, spikes = network(sizes), shown(9)
    expected = spiking_in_8_bits(asked, spikes, rules)
    assert ask(Int8SpikingQuery(asked, rules), spikes) == pytest.approx(expected, abs=1e-5)


@WAYS
@pytest.mark.parametrize("members", [1, 3])
@SIZES
def test_a_linear_query_follows_the_scheme_on_the_mean_matrix(sizes: list[int], members: int, ask: Ask) -> None:
    asked, spikes = [network(sizes, seed=seed) for seed in range(members)], shown(9)
    levels = in_255_levels(spikes.astype(np.float64), 1)
    matrix = one_matrix(asked)
    expected = affine(matrix, np.zeros(len(matrix)), levels, 1)
    assert ask(Int8LinearQuery(asked), spikes) == pytest.approx(expected, abs=1e-5)


@WAYS
def test_weights_halfway_between_two_steps_go_to_the_even_one(ask: Ask) -> None:
    # The largest weight is 127, so a step is 1; one pixel at a time is shown in full.
    found = ask(linear([[127, 0.5, 1.5, 2.5, -0.5, -1.5, -2.5, 3.4, 0]]), np.eye(9, dtype=np.float32))
    assert found[:, 0] == pytest.approx([127, 0, 2, 2, 0, -2, -2, 3, 0], abs=1e-5)


@WAYS
def test_activations_halfway_between_two_levels_go_to_the_even_one_and_end_at_the_clip(ask: Ask) -> None:
    # No weight, so features say their constant; the clip of 255 makes a level 1; the place of each repeats it.
    constant = torch.tensor([[0.5, 1.5, 2.5, 3.4, 254.5, 300.0, -4.0]])
    asked = Network(torch.zeros(1, 7, 2), constant, torch.zeros(1, 7), (torch.eye(7),), (torch.zeros(7),))
    found = ask(Int8SpikingQuery(asked, replace(PAPER, clip=255.0)), np.ones((9, 2), np.float32))
    assert found == pytest.approx(np.array([[0, 2, 2, 3, 254, 255, 0]] * 9), abs=1e-4)


@WAYS
def test_input_spikes_have_255_levels_up_to_1(ask: Ask) -> None:
    x = np.array([0, 0.4 / 255, 0.6 / 255, 100.4 / 255, 100.6 / 255, 254.4 / 255, 1, 1.5, -0.2], np.float32)
    found = ask(linear([[1.0, 0.0]]), np.stack([x, x], axis=1))
    assert found[:, 0] * 255 == pytest.approx([0, 0, 1, 100, 101, 254, 255, 255, 0], abs=1e-4)


# --- one query and many -----------------------------------------------------------------------------------------

KINDS = pytest.mark.parametrize(
    "make",
    [lambda n: Int8SpikingQuery(n, PAPER), lambda n: Int8SpikingQuery(n, V1), lambda n: Int8LinearQuery([n])],
    ids=["paper", "v1", "linear"],
)
Make = Callable[[Network], Query]


@KINDS
@pytest.mark.parametrize("count", [1, 7, 8, 9, 300])
@SIZES
def test_a_query_scores_in_a_batch_of_any_size_to_the_bit_as_alone(sizes: list[int], count: int, make: Make) -> None:
    query, spikes = make(network(sizes)), shown(count)
    assert np.array_equal(query.scores(spikes), one_by_one(query, spikes))


@KINDS
@pytest.mark.parametrize(("n_features", "n_pixels"), [(2, 2), (3, 5), (8, 7), (9, 64), (130, 65)])
def test_layers_of_any_width_score_in_a_batch_to_the_bit_as_alone(n_features: int, n_pixels: int, make: Make) -> None:
    query, spikes = make(network([6, 3], n_features, n_pixels)), shown(9, n_pixels)
    assert np.array_equal(query.scores(spikes), one_by_one(query, spikes))


@pytest.mark.parametrize("n_places", [2, 3, 8])
def test_a_network_of_one_pixel_scores_in_a_batch_to_the_bit_as_alone(n_places: int) -> None:
    query, spikes = linear(np.ones((n_places, 1))), np.ones((9, 1), np.float32)
    assert np.array_equal(query.scores(spikes), one_by_one(query, spikes))


# --- extremes ---------------------------------------------------------------------------------------------------


@WAYS
@pytest.mark.parametrize("n_pixels", [2, 31, 784, 3136])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_largest_sums_do_not_overflow(n_pixels: int, sign: int, ask: Ask) -> None:
    found = ask(linear(np.full((3, n_pixels), sign)), np.ones((9, n_pixels), np.float32))
    assert found == pytest.approx(np.full((9, 3), sign * n_pixels), rel=1e-6)


LARGEST_SUMS_IN_A_BATCH = """
import numpy as np, torch
from vprbench.methods.vprtempo.quantised import _Layer
layer = _Layer(np.ones((3, 64), np.float32), np.zeros(3, np.float32), np.float32(1))
print(layer(np.full((9, 64), 255, np.uint8)).tolist() == [[64.0] * 3] * 9)
"""


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="only oneDNN on x86 can be told to do less")
def test_the_largest_sums_do_not_overflow_on_a_processor_with_avx2_alone() -> None:
    done = subprocess.run(
        [sys.executable, "-c", LARGEST_SUMS_IN_A_BATCH],
        env={**os.environ, "PYTHONPATH": str(ROOT), "ONEDNN_MAX_CPU_ISA": "AVX2"},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert done.stdout.strip() == "True"


@WAYS
def test_weights_of_every_place_lie_in_127_steps_of_its_own(ask: Ask) -> None:
    # 126.6 of 127 steps are the 127th, 126.4 the 126th, to both sides.
    row = np.array([127, 126.6, 126.4, -127, -126.6, -126.4]) / 127
    found = ask(linear([row, row * 1e-4]), np.tile(np.eye(6, dtype=np.float32), (2, 1)))[:6]
    steps = np.array([127, 127, 126, -127, -127, -126]) / 127
    assert found[:, 0] == pytest.approx(steps, rel=1e-6)
    assert found[:, 1] == pytest.approx(steps * 1e-4, rel=1e-6)


@WAYS
@pytest.mark.parametrize("size", [0.0, 1e-45, 1e-40])
def test_places_of_no_or_hardly_any_weight_score_nothing(size: float, ask: Ask) -> None:
    found = ask(linear([[size, -size, size], [1, 0, 0]]), np.ones((9, 3), np.float32))
    assert found == pytest.approx(np.array([[0.0, 1.0]] * 9), abs=1e-6)


@WAYS
def test_a_feature_without_weights_says_its_constant_less_its_threshold(ask: Ask) -> None:
    asked = Network(
        features=torch.zeros(1, 2, 3),
        constant=torch.tensor([[0.45, 0.1]]),
        feature_thresholds=torch.tensor([[0.0, 0.3]]),
        outputs=(torch.tensor([[1.0], [1.0]]),),
        output_thresholds=(torch.tensor([0.25]),),
    )
    found = ask(Int8SpikingQuery(asked, PAPER), np.ones((9, 3), np.float32))
    assert found == pytest.approx(np.full((9, 1), 0.2), abs=0.9 / 510 + 1e-6)


# --- how far from the float network -----------------------------------------------------------------------------


def test_a_linear_score_is_off_by_no_more_than_half_a_step_and_half_a_level_an_input() -> None:
    # |w x - w' x'| <= |w - w'| x' + |w| |x - x'|, with |w - w'| <= step / 2 and |x - x'| <= 1 / 510.
    asked, spikes = network([5, 5, 3]), shown(50)
    matrix, x = one_matrix([asked]), spikes.astype(np.float64)
    step = np.abs(matrix).max(1) / 127
    bound = (x + 1 / 510).sum(1)[:, None] * step / 2 + np.abs(matrix).sum(1) / 510
    error = np.abs(Int8LinearQuery([asked]).scores(spikes) - x @ matrix.T)
    assert (error <= bound + 1e-5).all()
    assert error.max() > bound.min() / 100  # it is no float network


def test_a_spiking_score_is_off_by_no_more_than_the_errors_of_both_layers() -> None:
    # As above for the features, whose own rounding adds half a level; clipping never widens a difference.
    asked, spikes = network([6, 6, 1]), shown(50)
    x, clip = spikes.astype(np.float64), 0.9
    found, start = Int8SpikingQuery(asked, PAPER).scores(spikes), 0
    for module, outputs in enumerate(asked.outputs):
        w_f, w_o = double(asked.features[module]), double(outputs).T
        active = np.clip(x @ w_f.T + double(asked.constant[module] - asked.feature_thresholds[module]), 0, clip)
        scores = np.clip(active @ w_o.T - double(asked.output_thresholds[module]), 0, clip)
        step_f, step_o = np.abs(w_f).max(1) / 127, np.abs(w_o).max(1) / 127
        off = (x + 1 / 510).sum(1)[:, None] * step_f / 2 + np.abs(w_f).sum(1) / 510 + clip / 510
        bound = off @ np.abs(w_o).T + (active + off).sum(1)[:, None] * step_o / 2
        own = slice(start, start := start + len(w_o))
        assert (np.abs(found[:, own] - scores) <= bound + 1e-5).all()


# --- ties -------------------------------------------------------------------------------------------------------


def test_places_that_only_rounding_makes_alike_count_by_chance() -> None:
    # 64.1 and 64.4 of 127 steps are both the 64th: the float network would always find place 1.
    query = linear(np.array([[127, 64.1, 0], [127, 64.4, 0], [0, 0, 127]]) / 127)
    scores = query.scores(np.array([[0.2, 0.9, 0.1]] * 4, np.float32))
    recall = accuracy.recall_at(outcome(scores, [np.array([1])] * 3 + [np.array([2])]), 1)
    assert recall is not None
    assert (recall.expected, recall.pessimistic, recall.optimistic) == (0.375, 0.0, 0.75)


# --- the method -------------------------------------------------------------------------------------------------

SMALL: dict[str, Any] = {"max_module": 8, "height": 12, "width": 12}  # modules of 8, 8 and 4 places
WORLD = Journey.draw(0)
RULE_SETS = pytest.mark.parametrize("rules", get_args(RuleSet))
_CLASS = "vprbench.methods.vprtempo.int8.VPRTempoInt8"


@cache
def fitted(kind: type[VPRTempo], rules: RuleSet, **arguments: Any) -> VPRTempo:
    return kind(rules=rules, **SMALL, **arguments).fit(Images.from_arrays(WORLD.references), WORLD.places)


@RULE_SETS
def test_the_trained_network_is_that_of_vprtempo(rules: RuleSet) -> None:
    states = [fitted(kind, rules).state() for kind in (VPRTempo, VPRTempoInt8)]
    assert states[0].keys() == states[1].keys()
    assert all(np.array_equal(array, states[1][name]) for name, array in states[0].items())


@RULE_SETS
def test_scores_and_best_places_are_nearly_the_float_ones(rules: RuleSet) -> None:
    images = Images.from_arrays([*WORLD.references, *WORLD.queries])
    floating, found = (fitted(kind, rules).query(images) for kind in (VPRTempo, VPRTempoInt8))
    assert np.mean(floating.argmax(1) == found.argmax(1)) >= 0.95
    assert 0 < np.abs(found - floating).max() < 0.05 * np.abs(floating).max()


@pytest.mark.parametrize("rules", ["reference", "v1"])
def test_the_8_bit_method_keeps_the_contract_under_other_rules_too(rules: RuleSet) -> None:
    results = list(check({"_target_": _CLASS, "rules": rules}))
    assert [result.rule for result in results] == [r for r in CONFORMANCE if (r, rules) != (EXTENDED_RULE, "v1")]
    assert [str(result) for result in results if result.state != "kept"] == []


@pytest.mark.parametrize(
    ("trained", "asked"), [(VPRTempo, VPRTempoInt8), (VPRTempoInt8, VPRTempo)], ids=["float to int8", "int8 to float"]
)
def test_a_stored_network_answers_in_either_way(tmp_path: Path, trained: type[VPRTempo], asked: type[VPRTempo]) -> None:
    references = Images.from_arrays(WORLD.references)
    right = tuple(np.array([place]) for place in WORLD.right.tolist())
    dataset = Dataset("world", references, WORLD.places, Images.from_arrays(WORLD.queries), right, {})
    method = fitted(trained, "paper")
    where = networks.prepare(networks.Files(save=tmp_path / "x.safetensors"), method, SMALL, dataset)
    assert where is not None
    networks.save(where, method, "", 0.0, 0.0)
    loaded = asked(**SMALL)
    networks.load(where.path, loaded, where.origin)
    assert np.array_equal(loaded.query(dataset.queries), fitted(asked, "paper").query(dataset.queries))


def test_more_inputs_than_32_bits_can_sum_are_refused_before_the_training() -> None:
    references = Images.from_arrays([np.zeros((30, 30, 3), np.uint8)] * 8)
    with pytest.raises(BadInput, match="features_per_pixel=100"):
        VPRTempoInt8(features_per_pixel=100.0, max_module=8).fit(references, np.arange(8))

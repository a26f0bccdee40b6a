"""The compiled training gives what the readable one gives: same weights, same answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from vprbench.api.images import Images
from vprbench.api.preprocess import PatchNormalisation
from vprbench.errors import TrainingDivergedError
from vprbench.methods.vprtempo import fused, training
from vprbench.methods.vprtempo.layer import Layer, draw_layer, feature_rates
from vprbench.methods.vprtempo.method import VPRTempo
from vprbench.methods.vprtempo.rules import RULES, RuleSet
from vprbench.methods.vprtempo.training import Schedule, draw_schedule, module_sizes

RULE_SETS: tuple[RuleSet, ...] = ("paper", "reference", "v1")
N_PLACES, N_PIXELS, N_FEATURES = 200, 144, 288
PLACES = np.tile(np.arange(N_PLACES), 2)
RATES = feature_rates(N_FEATURES, 0.2, 0.9)
RELATIVE = 1e-4


def spikes() -> torch.Tensor:
    """Two traverses of the same places: smooth frames, the second with noise, a sixth of the pixels silent."""
    generator = np.random.default_rng(3)
    scenes = np.cumsum(generator.normal(size=(N_PLACES, N_PIXELS)), axis=1)
    scenes = (scenes - scenes.mean(1, keepdims=True)) / scenes.std(1, keepdims=True)
    frames = np.concatenate([scenes, scenes + 0.2 * generator.normal(size=scenes.shape)])
    return torch.from_numpy((np.floor(255 * (1 + np.clip(frames, -1, 1)) / 2) / 255).astype(np.float32))


def drawn(rule_set: RuleSet, sizes: list[int]) -> tuple[Layer, Layer, list[Schedule]]:
    rules = RULES[rule_set]
    generators = [torch.Generator().manual_seed(11 + module) for module in range(len(sizes))]
    n_features = [N_FEATURES] * len(sizes)
    features = draw_layer(generators, n_features, N_PIXELS, (0.1, 0.5), 0.5, rules.constant_input, rules)
    outputs = draw_layer(generators, sizes, N_FEATURES, (1.0, 1.0), 0.0, 0.0, rules)
    return features, outputs, [draw_schedule(generators, sizes, PLACES, 4, rules) for _ in range(2)]


def trained(rule_set: RuleSet, max_module: int, compiled: bool) -> tuple[Layer, Layer]:
    rules, sizes = RULES[rule_set], module_sizes(N_PLACES, max_module)
    engine = fused if compiled else training
    features, outputs, schedules = drawn(rule_set, sizes)
    shown = spikes()
    engine.train_features(features, shown, schedules[0], RATES, 0.005, 0.15, rules, lambda _: None)
    engine.train_places(outputs, features, shown, schedules[1], RATES, 0.005, rules, lambda _: None)
    return features, outputs


# Not v1 with modules of 75: there rounding brings one of 864 feature neurons to the other side of its threshold once,
# and from then on it learns otherwise.
CASES = [("paper", 200), ("paper", 75), ("reference", 200), ("reference", 75), ("v1", 200)]


@pytest.fixture(scope="module", params=CASES, ids=lambda case: f"{case[0]}-{case[1]}")
def both(request: pytest.FixtureRequest) -> tuple[tuple[Layer, Layer], tuple[Layer, Layer]]:
    rule_set, max_module = request.param
    return trained(rule_set, max_module, compiled=True), trained(rule_set, max_module, compiled=False)


@pytest.mark.parametrize("part", ["excitation", "inhibition", "thresholds"])
@pytest.mark.parametrize("number", [0, 1], ids=["features", "outputs"])
def test_a_full_training_of_200_places_gives_the_same_layer(
    both: tuple[tuple[Layer, Layer], tuple[Layer, Layer]], number: int, part: str
) -> None:
    compiled, readable = (getattr(layers[number], part) for layers in both)
    scale = float(readable.abs().max()) or 1.0
    assert float((compiled - readable).abs().max()) <= RELATIVE * scale


@pytest.mark.parametrize("rule_set", RULE_SETS)
def test_the_compiled_network_ranks_places_as_the_readable_one(rule_set: RuleSet) -> None:
    frames = (spikes().numpy() * 255).round().astype(np.uint8).reshape(-1, 12, 12)
    references = Images.from_arrays(list(frames))
    best = []
    for engine in ("fused", "readable"):
        method = VPRTempo(rules=rule_set, engine=engine, height=12, width=12, max_module=75)
        scores = method.fit(references, PLACES).query(references)
        best.append(np.argsort(-np.round(scores, 3), axis=1, kind="stable")[:, :1])
    assert np.array_equal(*best)


def test_the_number_of_threads_changes_nothing() -> None:
    before = torch.get_num_threads()
    layers = []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            layers.append(trained("paper", 75, compiled=True))
    finally:
        torch.set_num_threads(before)
    assert torch.equal(layers[0][0].inhibition, layers[1][0].inhibition)
    assert torch.equal(layers[0][1].thresholds, layers[1][1].thresholds)


def test_progress_is_reported_up_to_the_end() -> None:
    features, _, schedules = drawn("paper", [200])
    seen: list[float] = []
    fused.train_features(features, spikes(), schedules[0], RATES, 0.005, 0.15, RULES["paper"], seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0


@pytest.mark.parametrize("rule_set", RULE_SETS)
def test_a_net_input_that_overflows_shows_in_the_weights(rule_set: RuleSet) -> None:
    features, _, schedules = drawn(rule_set, [200])
    fused.train_features(features, spikes(), schedules[0], RATES, 1e37, 0.15, RULES[rule_set], lambda _: None)
    with pytest.raises(TrainingDivergedError, match="feature layer"):
        training.check_weights(features, "feature")


@pytest.mark.parametrize("one_sign", [False, True])
def test_inhibition_that_a_step_took_away_comes_back_at_its_least(one_sign: bool) -> None:
    rules = replace(RULES["paper"], one_sign_per_synapse=one_sign, homeostasis_gain=1000.0)
    found = []
    for engine in (fused, training):
        features, _, schedules = drawn("paper", [200])
        features.excitation.zero_()  # nothing ever fires: of each step homeostasis alone is left
        features.constant.zero_()
        layer = replace(features, excitation_limits=(torch.zeros_like(features.excitation),) * 2)
        engine.train_features(layer, spikes(), schedules[0], RATES, 0.005, 0.0, rules, lambda _: None)
        found.append(layer.inhibition)
    torch.testing.assert_close(*found, rtol=1e-3, atol=0)
    assert float(found[1].max()) < 1e-5


def test_the_readable_engine_preprocesses_readably_too(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []
    monkeypatch.setattr(PatchNormalisation, "_readable", lambda self, block, levels: seen.append("readable"))
    monkeypatch.setattr(PatchNormalisation, "_fused", lambda self, block, levels: seen.append("fused"))
    for engine in ("fused", "readable", None):
        VPRTempo(engine=engine).encode(Images.from_arrays([np.zeros((30, 30, 3), np.uint8)]))
    assert seen == ["fused", "readable", "fused"]

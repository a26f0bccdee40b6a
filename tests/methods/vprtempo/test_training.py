"""What each module of VPRTempo is shown, that modules learn apart, and that a diverged network is refused."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest
import torch
import vprtempo_oracle as oracle

from vprbench.errors import TrainingDivergedError
from vprbench.methods.vprtempo.layer import Layer, draw_layer, feature_rates
from vprbench.methods.vprtempo.rules import PAPER, REFERENCE, V1, Rules
from vprbench.methods.vprtempo.training import (
    Schedule,
    Training,
    check_weights,
    check_winners,
    draw_schedule,
    module_sizes,
    train_features,
    train_places,
)

SIZES = [12, 12, 5]  # places of each module
TRAVERSES = np.tile(np.arange(29), 2)  # the place of each of 58 reference images
EPOCHS = 4
ALL_RULES = pytest.mark.parametrize("rules", [REFERENCE, PAPER, V1], ids=["reference", "paper", "v1"])


def generators(seeds: Sequence[int] = (0, 1, 2)) -> list[torch.Generator]:
    return [torch.Generator().manual_seed(seed) for seed in seeds]


# --- the schedule -----------------------------------------------------------------------------------------------


def schedule(rules: Rules) -> Schedule:
    return draw_schedule(generators(), SIZES, TRAVERSES, EPOCHS, rules)


def images_shown(rules: Rules, module: int, epoch: int) -> list[int]:
    own = 2 * SIZES[module]
    shown: list[int] = schedule(rules).image[epoch * own : (epoch + 1) * own, module].tolist()
    return shown


@pytest.mark.parametrize(
    ("n_places", "max_module", "sizes"),
    [(3300, 1100, [1100, 1100, 1100]), (2761, 921, [921, 921, 919]), (450, 450, [450]), (5, 2, [2, 2, 1])],
)
def test_places_are_split_so_that_only_the_last_module_is_smaller(
    n_places: int, max_module: int, sizes: list[int]
) -> None:
    assert module_sizes(n_places, max_module) == sizes


@ALL_RULES
@pytest.mark.parametrize("epoch", range(EPOCHS))
@pytest.mark.parametrize(("module", "places"), [(0, range(12)), (1, range(12, 24)), (2, range(24, 29))])
def test_every_epoch_shows_a_module_each_image_of_its_places_once(
    rules: Rules, epoch: int, module: int, places: range
) -> None:
    both_traverses = [*places, *(29 + place for place in places)]
    assert sorted(images_shown(rules, module, epoch)) == both_traverses


def test_without_shuffling_images_come_traverse_after_traverse() -> None:
    assert images_shown(V1, 2, 1) == [24, 25, 26, 27, 28, 53, 54, 55, 56, 57]


def test_shuffling_mixes_the_traverses_anew_for_every_epoch_and_module() -> None:
    first_half = np.array(images_shown(PAPER, 0, 0)[:12])
    assert 0 < (first_half < 29).sum() < 12
    assert len({tuple(images_shown(PAPER, 0, epoch)) for epoch in range(EPOCHS)}) == EPOCHS
    assert images_shown(PAPER, 1, 0) != [12 + image for image in images_shown(PAPER, 0, 0)]


@ALL_RULES
def test_the_neuron_is_the_place_within_the_module(rules: Rules) -> None:
    drawn = schedule(rules)
    for module, first in enumerate([0, 12, 24]):
        steps = 2 * SIZES[module] * EPOCHS
        shown = TRAVERSES[drawn.image[:steps, module].numpy()]
        assert drawn.neuron[:steps, module].tolist() == (shown - first).tolist()


def test_places_need_not_come_in_order() -> None:
    drawn = draw_schedule(generators([0]), [3], np.array([2, 0, 1, 0]), 1, V1)
    assert drawn.neuron[:, 0].tolist() == [2, 0, 1, 0]


def test_a_smaller_module_anneals_over_its_own_steps_and_ends_with_a_factor_of_0() -> None:
    expected = oracle.learning_rates_v1(EPOCHS, 10, 1.0)  # 5 places, 2 traverses
    assert schedule(V1).factor[: 10 * EPOCHS, 2].numpy() == pytest.approx(expected)
    assert not schedule(PAPER).factor[10 * EPOCHS :, 2].any()
    assert schedule(PAPER).factor.shape == (24 * EPOCHS, 3)
    assert (schedule(PAPER).factor[:, 0] > 0).all()


def test_the_order_of_a_module_does_not_depend_on_the_others() -> None:
    alone = draw_schedule(generators([0]), [12], np.tile(np.arange(12), 2), EPOCHS, PAPER)
    # Image 12 + i of two traverses of 12 places is image 29 + i of two traverses of 29.
    as_of_all = [image if image < 12 else image + 17 for image in alone.image[:, 0].tolist()]
    assert schedule(PAPER).image[:, 0].tolist() == as_of_all


# --- modules learn apart ----------------------------------------------------------------------------------------


def random_spikes(seed: int) -> torch.Tensor:
    """Return 58 images of 40 pixels on the grid k / 255, some exactly 0."""
    z = np.clip(np.random.default_rng(seed).normal(0, 0.7, (58, 40)), -1, 1)
    return torch.from_numpy((np.floor(255 * (1 + z) / 2) / 255).astype(np.float32))


@dataclass
class Layers:
    """Both layers of some modules."""

    features: Layer
    outputs: Layer

    @classmethod
    def draw(cls, seeds: Sequence[int], sizes: Sequence[int], rules: Rules) -> Layers:
        """Draw both layers, first the features of all modules, then the outputs."""
        drawing = generators(seeds)
        return cls(
            draw_layer(drawing, [80] * len(sizes), 40, (0.1, 0.5), 0.5, rules.constant_input, rules),
            draw_layer(drawing, sizes, 80, (1.0, 1.0), 0.0, 0.0, rules),
        )

    def train(self, shown: Schedule, rules: Rules, report: Callable[[float], None] = lambda _: None) -> Layers:
        """Train both layers on the same schedule."""
        lesson = Training(random_spikes(0), feature_rates(80, 0.2, 0.9), rules, 0.005, 0.15, 0.005)
        train_features(self.features, shown, lesson, report)
        train_places(self.outputs, self.features, shown, lesson, report)
        return self


def difference(one: Layer, other: Layer, size: int) -> float:
    """Return the largest difference between the only module of `one` and of `other`, over `size` neurons."""
    parts = ("excitation", "inhibition", "thresholds")
    return max(float((getattr(one, p)[0, :size] - getattr(other, p)[0, :size]).abs().max()) for p in parts)


@ALL_RULES
@pytest.mark.parametrize("module", [0, 1, 2])
@pytest.mark.parametrize("layer", ["features", "outputs"])
def test_modules_trained_together_learn_what_each_learns_alone(rules: Rules, module: int, layer: str) -> None:
    # A module alone has no padding: neither neurons, nor steps after its end.
    together = Layers.draw((0, 1, 2), SIZES, rules).train(schedule(rules), rules)
    own = slice(module, module + 1)
    steps = 2 * SIZES[module] * EPOCHS
    shown = schedule(rules)[own]
    shown = Schedule(shown.image[:steps], shown.neuron[:steps], shown.factor[:steps])
    alone = Layers.draw((module,), SIZES[own], rules).train(shown, rules)
    size = 80 if layer == "features" else SIZES[module]
    # Not to the bit: another shape of the same product rounds otherwise, and a step that learns nothing still
    # lifts a weight that homeostasis brought below 1e-6.
    assert difference(getattr(alone, layer), getattr(together, layer)[own], size) < 2e-6


def steps_of(n: int, factor: float) -> Schedule:
    """Show the first n images to the first n neurons, at one learning rate."""
    image = torch.arange(n)[:, None]
    return Schedule(image, image, torch.full((n, 1), factor))


@ALL_RULES
@pytest.mark.parametrize("layer", ["features", "outputs"])
def test_a_step_with_factor_0_changes_nothing(rules: Rules, layer: str) -> None:
    layers = Layers.draw((0,), [12], rules).train(steps_of(12, 1.0), rules)
    before = deepcopy(getattr(layers, layer))
    after = getattr(layers.train(steps_of(5, 0.0), rules), layer)
    # at most, a weight that homeostasis brought below 1e-6 is lifted to it
    assert difference(before, after, 80) <= 1e-6


def test_training_reports_a_share_that_rises_to_at_most_1() -> None:
    reported: list[float] = []
    image = torch.arange(250)[:, None] % 12
    Layers.draw((0,), [12], PAPER).train(Schedule(image, image, torch.ones(250, 1)), PAPER, reported.append)
    # every 100 steps: features before them, places after them
    assert reported == pytest.approx([0, 0.4, 0.8, 0.4, 0.8, 1.0])


# --- divergence -------------------------------------------------------------------------------------------------


def weights_with(value: float, count: int, sign: str) -> Layer:
    """A layer of 1000 excitatory and 1000 inhibitory weights of 0.1, `count` of one sign replaced."""
    weights, nothing = torch.full((1, 10, 100), 0.1), torch.zeros(1, 10)
    layer = Layer(weights, weights.clone(), None, None, nothing, nothing)
    getattr(layer, sign).view(-1)[500 : 500 + count] = value
    return layer


SIGNS = pytest.mark.parametrize("sign", ["excitation", "inhibition"])


@SIGNS
@pytest.mark.parametrize(
    ("value", "count", "wanted"),
    [(float("nan"), 1, "output layer .*not finite"), (float("inf"), 1, "not finite"), (10, 40, r"\b2 % .*limit of 10")],
)
def test_weights_that_are_no_numbers_or_too_often_at_their_limit_are_divergence(
    value: float, count: int, wanted: str, sign: str
) -> None:
    with pytest.raises(TrainingDivergedError, match=wanted):
        check_weights(weights_with(value, count, sign), "output")


@SIGNS
def test_less_than_one_percent_of_the_weights_at_the_limit_is_none(sign: str) -> None:
    check_weights(weights_with(10, 10, sign), "output")


def test_only_weights_that_exist_count_for_the_share_at_the_limit() -> None:
    layer = weights_with(10, 10, "excitation")
    layer.inhibition.zero_()
    layer.excitation[0, :5] = 0  # 500 weights are left, 10 of them at the limit
    with pytest.raises(TrainingDivergedError, match="2 %"):
        check_weights(layer, "output")


PLACES = 40
TWO_MODULES = (20, 20)


def answers(winners: Sequence[int]) -> npt.NDArray[np.float32]:
    """Scores in which the n-th probe is answered by the n-th winner."""
    scores = np.random.default_rng(0).uniform(0, 0.4, (len(winners), PLACES)).astype(np.float32)
    scores[np.arange(len(winners)), winners] = 0.5
    return scores


SOME_ALIKE = answers(range(PLACES))
SOME_ALIKE[::4] = 0


@pytest.mark.parametrize(
    ("scores", "modules"),
    [
        (answers(range(PLACES)), (40,)),
        (answers(range(PLACES)), TWO_MODULES),
        (answers(np.random.default_rng(1).integers(PLACES, size=PLACES).tolist()), TWO_MODULES),
        (answers([3] * 20 + list(range(10, 30))), (40,)),
        (answers([i % 35 for i in range(PLACES)]), (35, 5)),
        (SOME_ALIKE, (40,)),
        (answers([3] * 9), (40,)),
    ],
    ids=["right", "right, two modules", "random", "half by one", "most by the larger", "some alike", "nine probes"],
)
def test_a_network_that_answers_different_probes_differently_is_healthy(
    scores: npt.NDArray[np.float32], modules: tuple[int, ...]
) -> None:
    check_winners(scores, np.repeat(np.arange(len(modules)), modules))


@pytest.mark.parametrize(
    ("scores", "modules", "wanted"),
    [
        (answers([3] * 30 + list(range(10, 20))), (40,), "one output neuron .* 75 % of 40"),
        (answers([3] * 10), (40,), "one output neuron .* 100 % of 10"),
        (answers([0, *(20 + i % 20 for i in range(39))]), TWO_MODULES, "module 1 .* 98 %.* 50 %"),
        (np.full((PLACES, PLACES), 0.0, np.float32), (40,), "neurons alike"),
        (np.full((PLACES, PLACES), 0.9, np.float32), (40,), "neurons alike"),
    ],
    ids=["one neuron", "ten probes", "one module", "silent", "saturated"],
)
def test_one_neuron_or_module_that_wins_nearly_all_probes_is_divergence(
    scores: npt.NDArray[np.float32], modules: tuple[int, ...], wanted: str
) -> None:
    with pytest.raises(TrainingDivergedError, match=wanted):
        check_winners(scores, np.repeat(np.arange(len(modules)), modules))

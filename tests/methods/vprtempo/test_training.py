"""What each module of VPRTempo is shown, and that a diverged network is refused."""

import numpy as np
import pytest
import torch
import vprtempo_oracle as oracle

from vprbench.errors import TrainingDivergedError
from vprbench.methods.vprtempo.rules import PAPER, REFERENCE, V1
from vprbench.methods.vprtempo.training import check_winners, draw_schedule, split_places

SIZES = [12, 12, 5]  # places of each module
TRAVERSES = np.tile(np.arange(29), 2)  # the place of each of 58 reference images
EPOCHS = 4


def schedule(rules):
    generators = [torch.Generator().manual_seed(seed) for seed in (0, 1, 2)]
    return draw_schedule(generators, SIZES, TRAVERSES, EPOCHS, rules)


def test_places_are_split_so_that_only_the_last_module_is_smaller():
    assert split_places(2761, 1100) == [921, 920, 920]
    assert split_places(3300, 1100) == [1100] * 3
    assert split_places(450, 1100) == [450]


@pytest.mark.parametrize("rules", [REFERENCE, PAPER, V1], ids=["reference", "paper", "v1"])
def test_every_epoch_shows_a_module_each_image_of_its_places_once_to_the_neuron_of_the_place(rules):
    drawn = schedule(rules)
    for module, (first, size) in enumerate(zip([0, 12, 24], SIZES, strict=True)):
        both_traverses = [start + place for start in (0, 29) for place in range(first, first + size)]
        images = drawn.image[: 2 * size * EPOCHS, module].tolist()
        shown = [images[2 * size * epoch :][: 2 * size] for epoch in range(EPOCHS)]
        assert [sorted(epoch) for epoch in shown] == [both_traverses] * EPOCHS
        assert len({tuple(epoch) for epoch in shown}) == (EPOCHS if rules.shuffle else 1)
        assert drawn.neuron[: 2 * size * EPOCHS, module].tolist() == (TRAVERSES[np.concatenate(shown)] - first).tolist()


def test_a_smaller_module_anneals_over_its_own_steps_and_ends_with_a_factor_of_0():
    expected = oracle.learning_rates_v1(EPOCHS, 10, 1.0)  # 5 places, 2 traverses
    assert schedule(V1).factor[: 10 * EPOCHS, 2].numpy() == pytest.approx(expected)
    factor = schedule(PAPER).factor
    assert factor.shape == (24 * EPOCHS, 3)
    assert not factor[10 * EPOCHS :, 2].any()
    assert (factor[:, 0] > 0).all()


PLACES = 40


def answers(winners):
    """Scores in which the n-th probe is answered by the n-th winner."""
    scores = np.random.default_rng(0).uniform(0, 0.4, (len(winners), PLACES)).astype(np.float32)
    scores[np.arange(len(winners)), winners] = 0.5
    return scores


SOME_ALIKE = answers(range(PLACES))
SOME_ALIKE[::4] = 0


@pytest.mark.parametrize(
    ("scores", "modules", "diverged"),
    [
        pytest.param(answers(range(PLACES)), (20, 20), None, id="right"),
        pytest.param(SOME_ALIKE, (40,), None, id="some alike"),
        pytest.param(answers([3] * 9), (40,), None, id="nine probes"),
        pytest.param(answers([3] * 30 + [*range(10, 20)]), (40,), "one output neuron .* 75 % of 40", id="one neuron"),
        pytest.param(answers([3] * 10), (40,), "one output neuron .* 100 % of 10", id="ten probes"),
        pytest.param(
            answers([0, *(20 + i % 20 for i in range(39))]), (20, 20), "module 1 .* 98 %.* 50 %", id="one module"
        ),
        pytest.param(np.zeros((PLACES, PLACES), np.float32), (40,), "neurons alike", id="silent"),
    ],
)
def test_one_neuron_or_module_that_wins_nearly_all_probes_is_divergence(scores, modules, diverged):
    module = np.repeat(np.arange(len(modules)), modules)
    if diverged is None:
        check_winners(scores, module)
        return
    with pytest.raises(TrainingDivergedError, match=diverged):
        check_winners(scores, module)

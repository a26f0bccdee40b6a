"""The input of VPRSNN: Poisson spikes whose rates are the grey levels over `levels_per_hz`."""

import numpy as np
import pytest

from vprbench.methods.vprsnn.input import draw_spike_train, make_generator, make_image_generator

SHOWN = 3500  # steps


def five_sigma(n_draws, probability):
    return 5 * float(np.sqrt(n_draws * probability * (1 - probability)))


def test_each_input_has_the_rate_of_its_own_level():
    levels = np.arange(256)
    shown = np.tile(levels, 40).astype(np.uint8)
    train = draw_spike_train(shown, np.random.default_rng(1), 4.0, SHOWN, 0.1)
    counts = np.bincount(train.source, minlength=40 * 256).reshape(40, 256).sum(axis=0)
    probability = levels / 4 * 1e-4
    spread = 6 * np.sqrt(40 * SHOWN * probability)
    assert (np.abs(counts - 40 * SHOWN * probability) <= spread + 1e-9).all()


def test_every_step_is_as_probable_whatever_the_step_before_and_the_neighbour_do():
    probability, n = 0.3, 20_000
    train = draw_spike_train(np.full(n, 240, np.uint8), np.random.default_rng(6), 240 * 5e-4 / probability, 8, 0.5)
    grid = np.zeros((8, n), int)
    np.add.at(grid, (train.step, train.source), 1)
    assert grid.max() == 1  # nobody spikes twice in a step
    assert grid.sum(axis=1) == pytest.approx(np.full(8, n * probability), abs=five_sigma(n, probability))
    for one, other in ((grid[:, 1:], grid[:, :-1]), (grid[1:], grid[:-1])):
        wanted, spread = one.size * probability**2, five_sigma(one.size, probability**2)
        assert int((one & other).sum()) == pytest.approx(wanted, abs=1.5 * spread)


def test_seeds_images_and_purposes_give_spikes_of_their_own_and_the_same_ones_again():
    image, other = np.random.default_rng(11).integers(0, 256, (2, 784), np.uint8)

    def firsts():
        of_images = [make_image_generator(*key) for key in ((0, image), (1, image), (0, other))]
        generators = of_images + [make_generator(*key) for key in ((0, 1), (0, 2), (1, 1), (0, 1, 0), (0,))]
        return [tuple(generator.random(4)) for generator in generators]

    assert len(set(firsts())) == 8
    assert firsts() == firsts()

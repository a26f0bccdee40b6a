"""Learning on the go: output neurons for new places beside a trained network, which learns nothing more."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from vprbench.api import Places

from .arguments import Arguments
from .layer import Layer
from .network import Network
from .query import calibrated
from .training import check_weights, draw_outputs, draw_schedule, draws, training_of


def learnt_beside(
    arguments: Arguments, network: Network, seed: list[int], spikes: Tensor, places: Places, train: Callable[..., None]
) -> Network:
    """Return a module of new places, each an output neuron on the features of a network's last module.

    `spikes` (n_images, n_pixels) are the inputs of images and `places` (n_images,) the new places that they show,
    from 0 on; the highest number stands for all other places. A calibrated network is so by these images.
    """
    rules, n_new = arguments.chosen_rules(), int(places.max())
    signed = network.features[-1:]
    thresholds, constant = network.feature_thresholds[-1:], network.constant[-1:]
    features = Layer(signed.clamp(min=0), (-signed).clamp_(min=0), None, None, thresholds, constant)
    generators = draws(seed, 1)
    outputs = draw_outputs(arguments, generators, [n_new + 1], signed.shape[1]).to(arguments.device)
    order = draw_schedule(generators, [n_new + 1], places, arguments.epochs, rules).to(arguments.device)
    train(outputs, features, order, training_of(arguments, spikes, signed.shape[1]), lambda share: None)
    check_weights(outputs, "output")
    learnt = Network.of(features, outputs, [n_new])
    return calibrated(learnt, spikes, rules) if rules.calibrated_scores else learnt

"""The training of VPRTempo neuron by neuron: the same rules as `layer`, compiled, each weight row in the cache.

What a neuron learns depends on no other neuron of its layer. So a neuron goes through its whole training while its
weights stay in the processor's cache, and threads share the neurons of all modules. One pass over the row does a
step's update, limits and homeostasis together with the next step's net input; where a neuron is silent nothing but
its inhibition changes, and the pass is shorter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch

from .fused_kernels import AMPLITUDE, DECAY, SPIKE, learn_features, learn_places
from .layer import Layer
from .rules import Rules
from .training import Schedule, Training

# Neurons that go through the training together share the reading of the images; their weights fit into an L2 cache.
_SIDE_BY_SIDE = 32
_THRESHOLD_RULES = {"spike": SPIKE, "amplitude": AMPLITUDE, "decay": DECAY}


def train_features(layer: Layer, schedule: Schedule, training: Training, report: Callable[[float], None]) -> None:
    """Train a feature layer in place, as `training.train_features` does."""
    rules = training.rules
    for module in range(len(layer.thresholds)):
        factor = np.ascontiguousarray(schedule.factor[:, module])
        with _lend_rows(layer, module, rules) as rows:
            arguments = (
                *rows,
                training.spikes.numpy(),
                np.ascontiguousarray(schedule.image[:, module]),
                np.float32(training.stdp) * factor,
                np.float32(training.itp) * factor,
                training.rates.numpy(),
                np.float32(rules.homeostasis_gain),
                np.float32(rules.clip),
                _THRESHOLD_RULES[rules.threshold_rule],
                rules.stdp_divided_by_rate,
            )
            _learn_in_threads(learn_features, arguments, layer.thresholds.shape[1], report)


def train_places(
    layer: Layer, features: Layer, schedule: Schedule, training: Training, report: Callable[[float], None]
) -> None:
    """Train an output layer in place, as `training.train_places` does."""
    rules = training.rules
    for module in range(len(layer.thresholds)):
        image, seen = np.unique(schedule.image[:, module].numpy(), return_inverse=True)
        net = torch.addmm(features.constant[module], training.spikes[image], features.weights[module].T)
        shown = net.sub_(features.thresholds[module]).clamp_(0, rules.clip)
        with _lend_rows(layer, module, rules) as rows:
            arguments = (
                *rows,
                shown.numpy(),
                (1 / training.rates).numpy(),
                seen,
                np.ascontiguousarray(schedule.neuron[:, module]),
                np.float32(training.output_stdp) * np.ascontiguousarray(schedule.factor[:, module]),
                np.float32(rules.homeostasis_gain),
                np.float32(rules.clip),
                np.float32(1.0 if rules.error_to_each_sign else 0.5),
                rules.output_thresholds_learn,
            )
            _learn_in_threads(learn_places, arguments, layer.thresholds.shape[1], report)


@contextmanager
def _lend_rows(layer: Layer, module: int, rules: Rules) -> Iterator[tuple[Any, ...]]:
    """Lend a module's weights to a kernel: excitation, inhibition, thresholds, C and whether both are one array.

    Where a synapse has one sign only, its signed weight is all there is to pass over.
    """
    excitation, inhibition = layer.excitation[module], layer.inhibition[module]
    rest = (layer.thresholds[module].numpy(), layer.constant[module].numpy())
    if rules.one_sign_per_synapse:
        signed = excitation - inhibition
        yield signed.numpy(), signed.numpy(), *rest, True
        torch.clamp(signed, min=0, out=excitation)
        torch.clamp(signed.neg_(), min=0, out=inhibition)
    else:
        yield excitation.numpy(), inhibition.numpy(), *rest, False


def _learn_in_threads(
    learn: Callable[..., None], arguments: tuple[Any, ...], n_neurons: int, report: Callable[[float], None]
) -> None:
    """Call `learn(*arguments, first, last)` for blocks of neurons, in as many threads as PyTorch may use."""
    n_threads = torch.get_num_threads()
    size = max(1, min(_SIDE_BY_SIDE, n_neurons // (4 * n_threads)))  # with many threads none is to be idle at the end
    with ThreadPoolExecutor(n_threads) as threads:
        starts = range(0, n_neurons, size)
        tasks = [threads.submit(learn, *arguments, start, min(start + size, n_neurons)) for start in starts]
        try:
            for done, task in enumerate(tasks):
                task.result()
                report((done + 1) / len(tasks))
        finally:
            threads.shutdown(cancel_futures=True)

"""The training of VPRTempo: the images of each module in their order, and whether the result can be trusted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from vprbench.api import BadInput, Scores, TrainingDivergedError

from .layer import LARGEST, NEARLY_NOTHING, SMALLEST, Layer, learn_features, learn_places
from .rules import Rules, list_annealing

_REPORT_EVERY = 100  # steps
_SPREAD = 0.03  # that an output neuron's net input has over the references after the covariance rule
_TOGETHER = 100  # images from whose errors the covariance rule learns in one step
_FEWEST_PROBES = 10  # reference images; fewer tell nothing


@dataclass(frozen=True)
class Schedule:
    """The training in full: per step and module an image, its output neuron and the factor on the learning rates.

    A module that has fewer steps than others ends with a factor of 0, under which nothing is learnt (a weight that
    homeostasis left below the smallest is lifted to it).
    """

    image: Tensor  # (n_steps, modules), index of a reference image
    neuron: Tensor  # (n_steps, modules), output neuron within the module
    factor: Tensor  # (n_steps, modules)

    def __getitem__(self, modules: slice) -> Schedule:
        """Return the schedule of some modules."""
        return Schedule(self.image[:, modules], self.neuron[:, modules], self.factor[:, modules])

    def to(self, device: str) -> Schedule:
        """Return the schedule on another device."""
        return Schedule(self.image.to(device), self.neuron.to(device), self.factor.to(device))


@dataclass(frozen=True)
class Training:
    """The input, the rules and the first learning rates of a training."""

    spikes: Tensor  # (n_references, n_pixels)
    rates: Tensor  # (n_features,), target firing rates of the feature neurons
    rules: Rules
    stdp: float  # learning rates of the feature layer's weights,
    itp: float  # of its thresholds,
    output_stdp: float  # and of the output layer


def split_places(n_places: int, max_module: int) -> list[int]:
    """Split consecutive places into as few modules as `max_module` places allow; sizes differ by at most one."""
    n_modules = -(-n_places // max_module)
    least, larger = divmod(n_places, n_modules)
    return [least + 1] * larger + [least] * (n_modules - larger)


def draw_schedule(
    generators: Sequence[torch.Generator],
    sizes: Sequence[int],
    places: npt.NDArray[np.int64],
    epochs: int,
    rules: Rules,
) -> Schedule:
    """Draw the order in which each module sees the reference images of its places, `places` (n_references,).

    A generator draws for one module; `sizes` are the places of the modules of one network, and several networks of
    the same sizes follow one another. Images are shuffled anew in every epoch, all traverses mixed, or come in the
    order given.
    """
    first = np.cumsum([0, *sizes])
    images, neurons, factors = [], [], []
    for number, generator in enumerate(generators):
        start, end = first[number % len(sizes) :][:2]
        own = torch.from_numpy(np.flatnonzero((places >= start) & (places < end)))
        orders = [torch.randperm(len(own), generator=generator) for _ in range(epochs if rules.shuffle else 0)]
        image = torch.cat([own[order] for order in orders]) if rules.shuffle else own.repeat(epochs)
        images.append(image)
        neurons.append(torch.tensor(places)[image] - int(start))
        factors.append(torch.from_numpy(list_annealing(epochs, len(own), rules)).float())
    return Schedule(pad_sequence(images), pad_sequence(neurons), pad_sequence(factors))


def train_features(layer: Layer, schedule: Schedule, training: Training, report: Callable[[float], None]) -> None:
    """Train a feature layer in place; `report` receives the share done."""
    total = len(schedule.image)
    for step in range(total):
        factor = schedule.factor[step, :, None]
        x = training.spikes[schedule.image[step]]
        learn_features(layer, x, training.rates, training.stdp * factor, training.itp * factor, training.rules)
        if step % _REPORT_EVERY == 0:
            report(step / total)


def train_places(
    layer: Layer, features: Layer, schedule: Schedule, training: Training, report: Callable[[float], None]
) -> None:
    """Train an output layer in place on the spikes of a trained feature layer; `report` receives the share done."""
    weights, rules = features.weights, training.rules
    total = len(schedule.image)
    for start in range(0, total, _REPORT_EVERY):
        steps = slice(start, min(start + _REPORT_EVERY, total))
        shown = training.spikes[schedule.image[steps].T]  # (modules, n_steps, n_pixels)
        net = torch.baddbmm(features.constant[:, None], shown, weights.transpose(1, 2))
        x = (net - features.thresholds[:, None]).clamp_(0, rules.clip).transpose(0, 1).contiguous()
        for step in range(steps.start, steps.stop):
            stdp = training.output_stdp * schedule.factor[step, :, None]
            learn_places(layer, x[step - start], schedule.neuron[step], training.rates, stdp, rules)
        report(steps.stop / total)


def set_thresholds(layer: Layer, schedule: Schedule, training: Training) -> None:
    """Set the thresholds (modules, n_features) of a layer in place, 0 or more: each neuron fires at its target rate.

    The references of a module count once each, however often `schedule` shows them.
    """
    for drawn in (layer.excitation, layer.inhibition):  # which stay as they are
        torch.threshold_(drawn, NEARLY_NOTHING, 0)
    for module, weights in enumerate(layer.weights):
        own = torch.unique(schedule.image[schedule.factor[:, module] > 0, module])
        net = torch.addmm(layer.constant[module, :, None], weights, training.spikes[own].T).sort(1).values
        silent = ((1 - training.rates).clamp(0, 1) * (len(own) - 1)).round().long()
        layer.thresholds[module] = net.gather(1, silent[:, None])[:, 0].clamp_(min=0)


def associate_places(
    layer: Layer, features: Layer, schedule: Schedule, training: Training, report: Callable[[float], None]
) -> None:
    """Train an output layer in place by the covariance rule (Sejnowski 1977), on any device; `report` as above.

    From weights of 0 (modules, n_places, n_features), 100 images at a time: a weight grows by the error of its output
    neuron, 0.5 for its own place less what it fires, times how far its feature is from the feature's mean over the
    references. The learning rate is in parts of the inverse mean energy of these distances. At the end all outputs have
    one spread over the references, and thresholds (modules, n_places), of either sign, that take the mean away.
    """
    clip = training.rules.clip
    for module, weights in enumerate(features.weights):
        learns = schedule.factor[:, module] > 0
        own, shown = torch.unique(schedule.image[learns, module], return_inverse=True)
        net = torch.addmm(features.constant[module], training.spikes[own], weights.T)
        spikes = net.sub_(features.thresholds[module]).clamp_(0, clip)
        mean = spikes.mean(0)
        spikes -= mean
        energy = spikes.square().sum(1).mean().clamp(min=SMALLEST)
        rate = training.output_stdp / energy * schedule.factor[learns, module]
        outputs = torch.zeros_like(layer.excitation[module])
        for start in range(0, len(shown), _TOGETHER):
            now = slice(start, start + _TOGETHER)
            x, target = spikes[shown[now]], schedule.neuron[learns, module][now]
            error = -(x @ outputs.T).clamp_(0, clip)
            error[torch.arange(len(x), device=x.device), target] += 0.5
            outputs.addmm_((rate[now, None] * error).T, x)
            report((module + start / len(shown)) / len(features.thresholds))
        spread = (spikes @ outputs.T).square().mean(0).sqrt()
        outputs *= (_SPREAD / spread.clamp(min=SMALLEST))[:, None]
        layer.excitation[module], layer.inhibition[module] = outputs.clamp(min=0), (-outputs).clamp_(min=0)
        layer.thresholds[module] = outputs @ mean


def check_weights(layer: Layer, name: str) -> None:
    """Raise TrainingDivergedError if weights are no numbers, or if more than 1 % of them stand at the limit."""
    weights = torch.stack([layer.excitation.abs().amax((1, 2)), layer.inhibition.abs().amax((1, 2))])
    if not bool(torch.isfinite(weights).all()):
        raise TrainingDivergedError(
            f"training diverged: the {name} layer holds weights that are not finite; "
            "lower method.stdp_rate or method.homeostasis_gain"
        )
    # Weights at the lower limit are left out: among them are those that only pad a smaller module.
    existing = (layer.excitation > 2 * SMALLEST).sum() + (layer.inhibition > 2 * SMALLEST).sum()
    limit = (layer.excitation >= LARGEST).sum() + (layer.inhibition >= LARGEST).sum()
    if limit > 0.01 * existing:
        raise TrainingDivergedError(
            f"training diverged: {100 * float(limit / existing):.0f} % of the {name} layer's weights stand at "
            f"their limit of {LARGEST:g}; lower method.stdp_rate or method.homeostasis_gain"
        )


def check_inputs(spikes: npt.NDArray[np.float32]) -> None:
    """Raise BadInput if more than half of some references are one and the same input.

    `spikes` (n_probes, n_pixels) are the inputs of reference images of as many different places.
    """
    if len(spikes) < _FEWEST_PROBES:
        return
    _, count = np.unique(spikes, axis=0, return_counts=True)
    if count.max() > len(spikes) / 2:
        raise BadInput(
            f"the references look alike: {count.max()} of {len(spikes)} images of different places are the same input "
            "after preprocessing, as black, uniform or one-pixel frames are; look at them with the command doctor"
        )


def check_winners(scores: Scores, module: npt.NDArray[np.int64]) -> None:
    """Raise TrainingDivergedError if a network answers alike to different references.

    `scores` (n_probes, n_places) are its answers to reference images of as many different places, spread evenly
    over the route; `module` (n_places,) is the module of each place. A healthy network answers most of them with
    their own place; here it is enough that no neuron and no module takes nearly all.
    """
    if len(scores) < _FEWEST_PROBES:
        return
    if float((scores == scores[:, :1]).all(1).mean()) > 0.5:
        raise TrainingDivergedError(
            "training diverged: more than half of the reference images leave all output neurons alike; "
            "other rules, a lower method.stdp_rate or a smaller method.max_module may help"
        )
    winner = scores.argmax(1)
    _, count = np.unique(winner, return_counts=True)
    share = count.max() / len(winner)
    if share > 0.5:
        raise TrainingDivergedError(
            f"training diverged: one output neuron wins for {100 * share:.0f} % of {len(winner)} different "
            "reference images; a lower method.stdp_rate or a smaller method.max_module may help"
        )
    own = np.bincount(module, minlength=int(module.max()) + 1) / len(module)
    won = np.bincount(module[winner], minlength=len(own)) / len(winner)
    greedy = int((won - own).argmax())
    if len(own) > 1 and won[greedy] > 0.95 and own[greedy] < 0.75:
        raise TrainingDivergedError(
            f"training diverged: module {greedy} wins for {100 * won[greedy]:.0f} % of the reference images but "
            f"holds {100 * own[greedy]:.0f} % of the places; a lower method.stdp_rate or other modules may help"
        )

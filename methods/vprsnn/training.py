"""The training of VPRSNN's modules, which learn apart from one another."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from vprbench.api import BadInput, checkpoints, progress

from . import batched
from .module import Room, Synapses, side_by_side
from .network import Network
from .published import PublishedModule
from .recipe import Recipe
from .simulation import normalise, present
from .threads import Tell, for_each_module
from .training_sets import Lesson, Responses

Module = Mapping[str, npt.NDArray[Any]]


def train_all(
    recipe: Recipe,
    lessons: Sequence[Lesson],
    kept: checkpoints.Partial,
    stage: str,
    device: torch.device | None,
    given: Sequence[PublishedModule] | None = None,
    within: tuple[float, float] = (0.0, 1.0),
) -> Network:
    """Return a network of trained modules; those that `kept` holds are not trained again.

    On a `device` PyTorch trains as many modules at once as fit, else compiled loops train one a thread. Modules that
    are `given` learn nothing but which place each neuron speaks for; for that the compiled loops suffice. Raises
    BadInput where there are not as many as lessons.
    """
    if given is not None and len(given) != len(lessons):
        raise BadInput(
            f"method.published_weights holds {len(given)} modules, but the places make {len(lessons)}: give as many "
            "places, and method.places_per_module, as they were trained with"
        )
    modules: dict[int, Module | None] = {
        number: kept.get(_name(recipe, lesson)) for number, lesson in enumerate(lessons)
    }
    missing = [number for number, module in modules.items() if module is None]

    if len(missing) < len(modules):
        stage = f"{stage}, {len(modules) - len(missing)} of {len(modules)} modules are there"

    def one(index: int, tell: Tell) -> Module:
        number = missing[index]
        shown = lessons[number]
        if given is None:
            module = train(recipe, shown, tell)
        else:
            module = assign(recipe, given[number].weights, given[number].theta_mv, shown, tell)
        kept.put(_name(recipe, shown), module)
        return module

    if device is None or given is not None:
        trained = for_each_module(one, len(missing), stage, within)
    else:
        trained = _train_at_once(recipe, [lessons[number] for number in missing], kept, stage, device, within)
    modules |= zip(missing, trained, strict=True)
    return Network.of([module for module in modules.values() if module is not None])


def train(recipe: Recipe, shown: Lesson, tell: Tell) -> dict[str, npt.NDArray[Any]]:
    """Return the weights (side by side), theta and responses of a module that learns its images, epoch after epoch.

    Source: VPRSNN (Hussaini, Milford and Fischer, RA-L 2022; QVPR/VPRSNN), after Diehl and Cook (2015).
    """
    physics, traces = recipe.physics, recipe.traces
    synapses = Synapses.of(recipe.weights(shown.number), recipe.delays(shown.number))
    state, now = recipe.untrained()
    room = Room.of(physics, recipe.n_neurons, recipe.n_inputs, round(recipe.longest_delay), True)
    kept = Responses(recipe, shown)
    images = shown.images(0, kept.presentations)
    for presentation, spikes in enumerate(recipe.spikes(shown.number, images)):
        normalise(synapses.weights, recipe.weight_sum)
        present(synapses, state, spikes, room, physics, traces, now, True, True)
        now += physics.shown + physics.rest
        kept.add(presentation, state.counts[: recipe.n_neurons])
        tell((presentation + 1) / kept.presentations)
    return {"weights": synapses.weights, "theta": state.theta[: recipe.n_neurons].copy(), **kept.arrays()}


def assign(
    recipe: Recipe, weights: npt.NDArray[np.float64], theta: npt.NDArray[np.float64], shown: Lesson, tell: Tell
) -> dict[str, npt.NDArray[Any]]:
    """Return what `train` returns for a module whose weights (n_inputs, n_neurons) and theta (mV) are given.

    It learns nothing: it is shown what it would have seen in its last presentations.
    """
    physics, traces = recipe.physics, recipe.traces
    synapses = Synapses.of(weights, recipe.delays(shown.number))
    state, now = recipe.started(theta)
    room = Room.of(physics, recipe.n_neurons, recipe.n_inputs, round(recipe.longest_delay), False)
    kept = Responses(recipe, shown)
    images = shown.images(kept.first, kept.presentations)
    for presentation, spikes in enumerate(recipe.spikes(shown.number, images), kept.first):
        present(synapses, state, spikes, room, physics, traces, now, False, True)
        now += physics.shown + physics.rest
        kept.add(presentation, state.counts[: recipe.n_neurons])
        tell((presentation + 1 - kept.first) / (kept.presentations - kept.first))
    return {"weights": synapses.weights, "theta": theta.copy(), **kept.arrays()}


def _train_at_once(
    recipe: Recipe,
    lessons: Sequence[Lesson],
    kept: checkpoints.Partial,
    stage: str,
    device: torch.device,
    within: tuple[float, float],
) -> list[Module]:
    """Train modules in PyTorch, as many at once as fit; together are those that are shown as many images."""
    alike = defaultdict(list)
    for number, lesson in enumerate(lessons):
        alike[len(lesson.levels)].append(number)
    most = batched.modules_at_once(recipe.physics, recipe.n_inputs, recipe.n_neurons, round(recipe.longest_delay))
    groups = [group[first : first + most] for group in alike.values() for first in range(0, len(group), most)]
    modules: dict[int, Module] = {}
    done, images = 0, sum(len(lesson.levels) for lesson in lessons)
    for group in groups:
        own = sum(len(lessons[number].levels) for number in group)

        def report(share: float, before: int = done, own: int = own) -> None:
            progress.report(stage, within[0] + (within[1] - within[0]) * (before + share * own) / images)

        trained = _trained_together(recipe, [lessons[number] for number in group], device, report)
        for number, module in zip(group, trained, strict=True):
            kept.put(_name(recipe, lessons[number]), module)
            modules[number] = module
        done += own
    return [modules[number] for number in range(len(lessons))]


def _trained_together(recipe: Recipe, group: Sequence[Lesson], device: torch.device, report: Tell) -> list[Module]:
    responses = [Responses(recipe, lesson) for lesson in group]
    presentations, first = responses[0].presentations, responses[0].first
    spikes = [recipe.spikes(lesson.number, lesson.images(0, presentations)) for lesson in group]
    trained = batched.train(
        np.stack([recipe.weights(lesson.number) for lesson in group]),
        np.stack([recipe.delays(lesson.number) for lesson in group]),
        *recipe.untrained(),
        recipe.physics,
        recipe.traces,
        recipe.weight_sum,
        lambda presentation: [next(own) for own in spikes],
        presentations,
        presentations - first,
        device,
        report,
    )
    for presentation, counts in enumerate(trained.counts, first):
        for own, spiked in zip(responses, counts, strict=True):
            own.add(presentation, spiked)
    return [
        {"weights": side_by_side(weights), "theta": theta, **own.arrays()}
        for weights, theta, own in zip(trained.weights, trained.theta, responses, strict=True)
    ]


def _name(recipe: Recipe, lesson: Lesson) -> str:
    return f"module-{recipe.seed}-{lesson.number}"

"""The training of VPRSNN's modules, which learn apart from one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import cycle, islice

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, Places

from .arrays import Synapses
from .checkpoints import Arrays, Checkpoints
from .model import Model, Module
from .network import Network, ReadyNetwork
from .parallel import Stage, Tell, for_each_module
from .published import PublishedModule
from .query import Levels, count_reactions
from .simulation import normalise_weights


@dataclass(frozen=True)
class Lesson:
    """The images of one module in the order of each epoch, and the places that it learns."""

    number: int  # of the module, which chooses its random numbers
    levels: npt.NDArray[np.uint8]  # (n_images, n_inputs)
    labels: npt.NDArray[np.int64]  # (n_images,) which of the places each shows
    places: npt.NDArray[np.int64]  # (n_labels,)


def split_places(n_places: int, model: Model) -> list[npt.NDArray[np.int64]]:
    """Return the places of each module, (places_per_module,) or fewer in the last.

    A contiguous order takes them as they come along the route. A shuffled one draws as QVPR/VPRSNN draws once it has
    set `calibration_places` others aside: it shuffles those, then permutes all of them for nothing, then shuffles the
    `n_places` that are left.
    """
    places = np.arange(n_places)
    if model.module_order == "shuffled":
        generator = np.random.RandomState(model.seed)
        generator.shuffle(np.arange(model.calibration_places))
        generator.permutation(n_places + model.calibration_places)
        generator.shuffle(places)
    return [places[first : first + model.places_per_module] for first in range(0, n_places, model.places_per_module)]


def make_lessons(model: Model, levels: Levels, places: Places, first: int = 0) -> list[Lesson]:
    """Return the lesson of each module: the first images of its places in order, then their second ones.

    `levels` (n_references, n_inputs) and `places` (n_references,) are of all references; the modules have the numbers
    from `first` on. Raises BadInput if a module has more images than presentations that are recorded.
    """
    lessons = []
    for number, members in enumerate(split_places(int(places.max()) + 1, model), first):
        shown = sorted(
            (time, label, image)
            for label, place in enumerate(members.tolist())
            for time, image in enumerate(np.flatnonzero(places == place).tolist())
        )
        _, labels, images = np.array(shown).T
        lessons.append(Lesson(number, levels[images], labels, members))
    most = max(len(each.levels) for each in lessons)
    if most > model.recorded_presentations:
        raise BadInput(
            f"method.recorded_presentations={model.recorded_presentations}: a module is shown {most} images, and no "
            "neuron could speak for those that are not recorded: give at least as many, or fewer places a module"
        )
    return lessons


@dataclass(frozen=True)
class Training:
    """The training of one network, `begin` to `end` of the progress; parts in `checkpoints` are not trained again."""

    model: Model
    checkpoints: Checkpoints
    prefix: str = ""  # of its parts' names
    begin: float = 0.0
    end: float = 1.0

    def learn(self, lessons: Sequence[Lesson], stage: str, given: Sequence[PublishedModule] | None = None) -> Network:
        """Return a network of trained modules.

        Modules that are `given` learn nothing but which place each neuron speaks for. Raises BadInput if there are not
        as many as lessons.
        """
        if given is not None and len(given) != len(lessons):
            raise BadInput(
                f"method.published_weights holds {len(given)} modules, but the places make {len(lessons)}: give as "
                "many places, and method.places_per_module, as they were trained with"
            )
        names = [f"{self.prefix}module-{self.model.seed}-{lesson.number}" for lesson in lessons]
        modules: list[Arrays | None] = [self.checkpoints.load(name) for name in names]
        missing = [number for number, module in enumerate(modules) if module is None]
        if len(missing) < len(modules):
            stage = f"{stage}, {len(modules) - len(missing)} of {len(modules)} modules are there"

        def train_missing(index: int, tell: Tell) -> None:
            number = missing[index]
            modules[number] = module = train(self.model, lessons[number], tell, given[number] if given else None)
            self.checkpoints.save(names[number], module)

        for_each_module(train_missing, len(missing), self.stage(stage))
        return Network.of([module for module in modules if module is not None])

    def with_reactions(self, network: Network, shown: Levels, stage: str, first: int = 0) -> Network:
        """Return the network with the number of images in `shown` for which each neuron fired.

        Its modules have the numbers from `first` on.
        """
        name = f"{self.prefix}reactions-{self.model.seed}-{first}"
        found: Arrays | None = self.checkpoints.load(name)
        if found is None:
            ready = ReadyNetwork.of(self.model, network, first)
            found = {"reactions": count_reactions(ready, shown, self.stage(stage))}
            self.checkpoints.save(name, found)
        return replace(network, reactions=found["reactions"])

    def stage(self, name: str) -> Stage:
        """Return this training's stretch of the progress of that name."""
        return Stage(name, self.begin, self.end)


def train(model: Model, lesson: Lesson, tell: Tell, given: PublishedModule | None = None) -> Arrays:
    """Return the weights (side by side), theta and responses of a module that learns its images, epoch after epoch.

    The responses are the spikes by place in the last `recorded_presentations`. A module that is `given` learns nothing:
    it is shown these presentations alone.
    Source: VPRSNN (Hussaini, Milford and Fischer, RA-L 2022; QVPR/VPRSNN), after Diehl and Cook (2015).
    """
    n_images, n_labels, learning = len(lesson.levels), len(lesson.places), given is None
    total = model.epochs * n_images
    recorded = max(0, total - model.recorded_presentations)
    first = 0 if learning else recorded
    sums, shown = np.zeros((model.n_excitatory, n_labels), np.float32), np.zeros(n_labels, np.int64)
    weights = model.draw_weights(lesson.number) if given is None else given.weights
    synapses = Synapses.of(weights, model.draw_delays(lesson.number))
    theta = None if given is None else given.theta_mv
    module = Module(model, synapses, theta, model.make_scratch(learning), learning)
    images = islice(cycle(lesson.levels), first, total)
    for presentation, spikes in enumerate(model.draw_trains(lesson.number, images), first):
        if learning:
            normalise_weights(synapses.weights, model.weight_sum)
        module.show(spikes)
        if presentation >= recorded:
            label = lesson.labels[presentation % n_images]
            sums[:, label] += module.state.counts[: model.n_excitatory]
            shown[label] += 1
        tell((presentation + 1 - first) / (total - first))
    theta = module.state.theta[: model.n_excitatory].copy()
    return {"weights": synapses.weights, "theta": theta, "sums": sums, "shown": shown, "places": lesson.places}

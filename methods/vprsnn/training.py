"""The training of VPRSNN's modules, which learn apart from one another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from vprbench.api import BadInput

from .arrays import Synapses
from .checkpoints import Arrays, Checkpoints
from .model import Model
from .module import show
from .network import Network, ReadyNetwork
from .parallel import Stage, Tell, for_each_module
from .published import PublishedModule
from .query import Levels, reactions
from .synapses import normalise
from .training_sets import Lesson, Recorder


@dataclass(frozen=True)
class Training:
    """The training of one network, `begin` to `end` of the progress; parts in `checkpoints` are not trained again."""

    model: Model
    checkpoints: Checkpoints
    begin: float = 0.0
    end: float = 1.0

    def network(self, lessons: Sequence[Lesson], stage: str, given: Sequence[PublishedModule] | None = None) -> Network:
        """Return a network of trained modules.

        Modules that are `given` learn nothing but which place each neuron speaks for. Raises BadInput if there are not
        as many as lessons.
        """
        if given is not None and len(given) != len(lessons):
            raise BadInput(
                f"method.published_weights holds {len(given)} modules, but the places make {len(lessons)}: give as "
                "many places, and method.places_per_module, as they were trained with"
            )
        modules = {number: self.checkpoints.load(self._name(lesson)) for number, lesson in enumerate(lessons)}
        missing = [number for number, module in modules.items() if module is None]
        if len(missing) < len(modules):
            stage = f"{stage}, {len(modules) - len(missing)} of {len(modules)} modules are there"

        def one(index: int, tell: Tell) -> None:
            number = missing[index]
            module = train(self.model, lessons[number], tell, None if given is None else given[number])
            modules[number] = dict(module)
            self.checkpoints.save(self._name(lessons[number]), module)

        for_each_module(one, len(missing), self.stage(stage))
        return Network.of([module for module in modules.values() if module is not None])

    def counted(self, network: Network, shown: Levels, stage: str, first: int = 0) -> Network:
        """Return the network with the number of images in `shown` for which each neuron fired.

        Its modules have the numbers from `first` on.
        """
        name = f"reactions-{self.model.seed}-{first}"
        found = self.checkpoints.load(name)
        if found is None:
            found = {"reactions": reactions(ReadyNetwork.of(self.model, network, first), shown, self.stage(stage))}
            self.checkpoints.save(name, found)
        return replace(network, reactions=found["reactions"])

    def stage(self, name: str) -> Stage:
        """Return this training's stretch of the progress of that name."""
        return Stage(name, self.begin, self.end)

    def _name(self, lesson: Lesson) -> str:
        return f"module-{self.model.seed}-{lesson.number}"


def train(model: Model, shown: Lesson, tell: Tell, given: PublishedModule | None = None) -> Arrays:
    """Return the weights (side by side), theta and responses of a module that learns its images, epoch after epoch.

    A module that is `given` learns nothing: it is shown what it would have seen in its last presentations.
    Source: VPRSNN (Hussaini, Milford and Fischer, RA-L 2022; QVPR/VPRSNN), after Diehl and Cook (2015).
    """
    learning, recorder = given is None, Recorder(model, shown)
    weights = model.weights(shown.number) if given is None else given.weights
    start = model.untrained() if given is None else model.started(given.theta_mv)
    synapses = Synapses.of(weights, model.delays(shown.number))
    module = model.module(synapses, start, model.scratch(learning), learning)
    first = 0 if learning else recorder.first
    images = shown.images(first, recorder.presentations)
    for presentation, spikes in enumerate(model.spikes(shown.number, images), first):
        if learning:
            normalise(synapses.weights, model.weight_sum)
        show(module, spikes)
        recorder.add(presentation, module.state.counts[: model.n_excitatory])
        tell((presentation + 1 - first) / (recorder.presentations - first))
    return {"weights": synapses.weights, "theta": module.state.theta[: model.n_excitatory].copy(), **recorder.arrays()}

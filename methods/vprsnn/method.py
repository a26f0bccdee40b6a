"""VPRSNN, a rate-coded spiking network of small modules, as a method."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from vprbench.api import BadInput, HeldOut, Images, LayerSpikes, Method, NotFittedError, Places, Scores

from ..parts.filters.patches import PatchNormalisation
from . import published, scoring
from .arguments import Arguments
from .checkpoints import Checkpoints
from .model import Model
from .network import Network, ReadyNetwork, by_member
from .parallel import Stage
from .query import Answers, Levels, ask
from .training import Training
from .training_sets import Lesson, lesson, modules

_ASIDE = 1_000_000  # numbers of modules that learn held-out places begin here
_QUERY_TIME = frozenset(
    {"assignment", "carried_potentials", "delays_at_query", "hyperactive_threshold", "probabilities"}
    | {"engine"}  # an argument that networks of version 0.6 were stored with
)


@dataclass
class VPRSNN(Arguments, Method):
    """The modular spiking network of VPRSNN (QVPR/VPRSNN), after Diehl and Cook (2015), with its published values.

    Modules of `places_per_module` places learn by spike-timing-dependent plasticity, each from its own images alone. At
    a query all of them see the image, and each neuron speaks for the place to which it responded most in training.
    `fast` leaves out the delays from the input: an approximation, not VPRSNN. `hyperactive_threshold` silences neurons
    that fire for so many references or more (0: none; None: chosen by held-out places, none where there are not any).
    `carried_potentials` lets a query find the neurons as the one before left them, as the authors have it.
    """

    conformance_arguments: ClassVar[Mapping[str, Any]] = {
        "places_per_module": 5,
        "n_excitatory": 30,
        "epochs": 3,
        "time_step_ms": 0.25,
        "height": 12,
        "width": 12,
    }
    stored_as: ClassVar[str] = "vprsnn"
    query_arguments: ClassVar[frozenset[str]] = _QUERY_TIME

    _ready: list[ReadyNetwork] = field(default_factory=list, init=False, repr=False, compare=False)
    #: The first image of each place, and what decided the training; None where nothing was fitted.
    _fitted: tuple[Levels, dict[str, Any]] | None = field(default=None, init=False, repr=False, compare=False)
    #: Of the trainings that have ended; they are removed once the network is asked.
    _checkpoints: list[Checkpoints] = field(default_factory=list, init=False, repr=False, compare=False)
    _resumed_parts: int = field(default=0, init=False, repr=False, compare=False)

    @property
    def conformance_exceptions(self) -> Mapping[str, str]:  # type: ignore[override]  # it depends on another argument
        """The rule that carried potentials break."""
        if not self.carried_potentials:
            return {}
        reason = "a query finds the neurons as the query before left them"
        return {"a batch gives what its single images give": reason}

    @property
    def calibrates(self) -> bool:
        """Whether a threshold is left to be chosen; published weights come without modules to choose it by."""
        return self.published_weights is None and None in self._thresholds()

    def fit(self, references: Images, places: Places) -> Self:
        """Train every module from its own images, and learn which place each neuron speaks for.

        A training that was interrupted goes on with the modules that are missing.
        """
        self.check()
        self._remove_checkpoints()
        self._ready, self._resumed_parts = [], 0
        levels = self.encode(references)
        first_traverse = levels[np.unique(places, return_index=True)[1]]
        identity = self._identity(levels, places)
        networks = []
        checkpoints = Checkpoints(identity)
        for training, threshold in self._trainings(checkpoints):
            lessons = self._lessons(training.model, levels, places, 0)
            network = training.network(lessons, "training", self._published())
            if threshold:
                network = training.counted(network, first_traverse, "counting reactions")
            networks.append(replace(network, threshold=threshold or 0))
        self._end_training(checkpoints)
        self._fitted = (first_traverse, identity)
        return self._take(networks)

    def calibrate(self, held_out: HeldOut) -> Self:
        """Choose the threshold of hyperactive neurons by held-out places, which have modules of their own.

        As published: each candidate is judged by R@1 over the held-out places' modules and queries alone; here a tie
        counts as wrong.
        """
        if self._fitted is None:
            raise NotFittedError("VPRSNN can choose a threshold only after fit(references, places)")
        shown, identity = self._fitted
        levels, queries = self.encode(held_out.references), self.encode(held_out.queries)
        if not held_out.in_map:
            shown = np.concatenate([shown, levels[np.unique(held_out.places, return_index=True)[1]]])
        aside_from = {"map": identity, "shown": _digest(shown)}
        networks = [member.network for member in self._ready]
        checkpoints = Checkpoints({**self._identity(levels, held_out.places), **aside_from})
        for number, (training, threshold) in enumerate(self._trainings(checkpoints)):
            if threshold is not None:
                continue
            lessons = self._lessons(training.model, levels, held_out.places, _ASIDE)
            aside = training.network(lessons, "calibration, training")
            aside = training.counted(aside, shown, "calibration, counting reactions", _ASIDE)
            ready = ReadyNetwork.of(training.model, aside, _ASIDE)
            answers = ask(ready, queries, training.stage("calibration, asking"))
            best = self._best_threshold(ready, answers, held_out.right)
            network = replace(networks[number], reactions=None)
            if best:
                network = training.counted(network, shown, "counting reactions")
            networks[number] = replace(network, threshold=best)
        self._end_training(checkpoints)
        return self._take(networks)

    def encode(self, images: Images) -> Levels:
        """Return the grey levels that set the rates of the input, (n_images, height * width), 0 to 255."""
        return PatchNormalisation(self.preprocessing, self.height, self.width, self.patch)(images)

    def match(self, codes: Levels) -> Scores:
        """Return the mean spikes of each place's neurons, (n_queries, n_places); -inf where none responds to a query.

        Of several networks the sum. Raises NotFittedError before `fit`.
        """
        self._require_a_network()
        scores = np.sum(
            [self._scores(member, ask(member, codes, Stage()).excitatory) for member in self._ready], axis=0
        )
        return scoring.no_match(scoring.normalised(scores) if self.probabilities else scores, scores)

    def notes(self) -> list[str]:
        """Return how many neurons are silenced, and which parts of the training are not of this run."""
        notes = []
        if self._resumed_parts:
            notes.append(
                f"fit was resumed: its time leaves out {self._resumed_parts} modules and counts of reactions that an "
                "interrupted run had finished"
            )
        if self.published_weights is not None:
            notes.append("the weights were not trained here: fit learnt only which place each neuron speaks for")
        for member, ready in zip(self._thresholds(), self._ready, strict=True):
            threshold, silenced = ready.network.threshold, ready.network.silenced
            if threshold:
                chosen = "chosen by held-out places" if member is None else "given"
                notes.append(
                    f"neurons that fired for {threshold} references or more ({chosen}) are silenced: "
                    f"{np.count_nonzero(silenced):,} of {silenced.size:,}"
                )
            elif member is None:
                notes.append("no neuron is silenced: no threshold did better on held-out places, or there are none")
        return notes

    def spikes(self, codes: Levels) -> list[LayerSpikes]:
        """Return the spikes of the input and of the excitatory and inhibitory neurons, of several networks the first's.

        Raises NotFittedError before `fit`.
        """
        self._require_a_network()
        answer, trains = ask(self._ready[0], codes, Stage()), self._ready[0].model.query_spikes(codes)
        excitatory, inhibitory = (counts.reshape(len(codes), -1) for counts in answer)
        members, others = len(self._ready), self._ready[0].model.n_excitatory - 1
        modules = [module.weights for member in self._ready for module in member.synapses]
        inputs = np.sum([np.count_nonzero(weights, axis=(0, 2)) for weights in modules], axis=0)
        return [
            LayerSpikes("input", np.array([np.diff(train.first) for train in trains]), fan_out=inputs),
            LayerSpikes("excitatory", excitatory, fan_out=np.full(excitatory.shape[1], members)),
            LayerSpikes("inhibitory", inhibitory, fan_out=np.full(excitatory.shape[1], members * others)),
        ]

    def state(self) -> Mapping[str, npt.NDArray[Any]]:
        """Return the arrays of the trained network, those of several numbered."""
        self._require_a_network()
        if len(self._ready) == 1:
            return self._ready[0].network.state()
        states = [member.network.state() for member in self._ready]
        return {f"member_{n}.{name}": array for n, state in enumerate(states) for name, array in state.items()}

    def restore(self, state: Mapping[str, npt.NDArray[Any]]) -> Self:
        """Take over a stored network; where `hyperactive_threshold` is None, with the threshold that it has."""
        self.check()
        self._ready, self._fitted, self._resumed_parts = [], None, 0
        networks = []
        thresholds = self._thresholds()
        for arrays, threshold in zip(by_member(state, len(thresholds)), thresholds, strict=True):
            network = Network.from_state(arrays, self.height * self.width, self.n_excitatory)
            if threshold and network.reactions is None:
                raise BadInput(
                    f"method.hyperactive_threshold={threshold}: the stored network has not counted the reactions of "
                    "its neurons; train with a threshold, or set method.hyperactive_threshold=0"
                )
            networks.append(network if threshold is None else replace(network, threshold=threshold))
        return self._take(networks)

    def files(self) -> Sequence[Path]:
        """Return the published weights, where they are used; raises BadInput where they are missing."""
        if self.published_weights is None:
            return []
        with _named("published_weights"):
            return published.files_of(Path(self.published_weights))

    def _trainings(self, checkpoints: Checkpoints) -> list[tuple[Training, int | None]]:
        """Return the training of each network, and its threshold."""
        models = self._models()
        parts = np.linspace(0, 1, len(models) + 1).tolist()
        return [
            (Training(model, checkpoints, begin, end), threshold)
            for model, begin, end, threshold in zip(models, parts, parts[1:], self._thresholds(), strict=False)
        ]

    def _thresholds(self) -> Sequence[int | None]:
        return [self.hyperactive_threshold]

    def _models(self) -> list[Model]:
        return [Model.of(self)]

    def _lessons(self, model: Model, levels: Levels, places: Places, first: int) -> list[Lesson]:
        """Return what each module is shown; their numbers begin with `first`."""
        n_places = int(places.max()) + 1
        groups = modules(n_places, self.places_per_module, self.module_order, model.seed, self.calibration_places)
        lessons = [lesson(first + number, group, levels, places) for number, group in enumerate(groups)]
        most = max(len(each.levels) for each in lessons)
        if most > self.recorded_presentations:
            raise BadInput(
                f"method.recorded_presentations={self.recorded_presentations}: a module is shown {most} images, and no "
                "neuron could speak for those that are not recorded: give at least as many, or fewer places a module"
            )
        return lessons

    def _published(self) -> list[published.PublishedModule] | None:
        if self.published_weights is None:
            return None
        with _named("published_weights"):
            return published.read_modules(Path(self.published_weights), self.height * self.width, self.n_excitatory)

    def _best_threshold(self, aside: ReadyNetwork, answers: Answers, right: Places) -> int:
        def scores(threshold: int) -> Scores:
            judged = replace(aside, network=replace(aside.network, threshold=threshold))
            found = self._scores(judged, answers.excitatory)
            return scoring.no_match(found, found)

        return scoring.best_threshold(scores, right, self.hyperactive_candidates)

    def _scores(self, member: ReadyNetwork, responses: npt.NDArray[np.int32]) -> Scores:
        network = member.network
        if self.assignment == "weighted":
            return scoring.weighted(responses, network, network.silenced, network.n_places)
        return scoring.standard(responses, member.labels, network.silenced, network.n_places)

    def _take(self, networks: Sequence[Network]) -> Self:
        """Make networks ready to be asked."""
        self._ready = [ReadyNetwork.of(*member) for member in zip(self._models(), networks, strict=True)]
        return self

    def _require_a_network(self) -> None:
        """Raise NotFittedError without a network; one that is asked needs no checkpoints any more."""
        if not self._ready:
            raise NotFittedError("VPRSNN has no network yet: call fit(references, places) first")
        self._remove_checkpoints()

    def _end_training(self, checkpoints: Checkpoints) -> None:
        self._checkpoints.append(checkpoints)
        self._resumed_parts += checkpoints.n_loaded

    def _remove_checkpoints(self) -> None:
        while self._checkpoints:
            self._checkpoints.pop().remove()

    def _identity(self, levels: Levels, places: Places) -> dict[str, Any]:
        """Return what decides the outcome of a training, and who spends time on it, as plain values."""
        free = {"assignment", "hyperactive_candidates", "hyperactive_threshold", "probabilities"}
        digest = hashlib.sha256()
        for file in [*sorted(Path(__file__).parent.rglob("*.py")), *self.files()]:
            digest.update(file.read_bytes())
        return {
            "method": type(self).__name__,
            "files": digest.hexdigest(),
            "arguments": {name: value for name, value in self.given().items() if name not in free},
            "levels": _digest(levels),
            "places": _digest(places),
        }


@contextmanager
def _named(argument: str) -> Iterator[None]:
    """Begin the message of what is wrong with the argument that it was given by."""
    try:
        yield
    except BadInput as error:
        raise type(error)(f"method.{argument}: {error}") from error


def _digest(array: npt.NDArray[Any]) -> str:
    return hashlib.sha256(array.tobytes()).hexdigest()

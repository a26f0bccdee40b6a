"""VPRSNN, a rate-coded spiking network of small modules, as a method."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
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
from .network import Network, ReadyNetwork, split_members
from .parallel import Stage
from .query import Answers, Levels, ask
from .training import Training, make_lessons

_ASIDE = 1_000_000  # numbers of modules that learn held-out places begin here


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
    query_arguments: ClassVar[frozenset[str]] = frozenset(
        {"assignment", "carried_potentials", "delays_at_query", "hyperactive_threshold", "probabilities"}
    )

    _ready: list[ReadyNetwork] = field(default_factory=list, init=False, repr=False, compare=False)
    #: The first image of each place, and the parts of the training, which are removed once the network is asked.
    _fitted: tuple[Levels, Checkpoints] | None = field(default=None, init=False, repr=False, compare=False)

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
        return self.published_weights is None and any(threshold is None for _, threshold in self._members())

    def fit(self, references: Images, places: Places) -> Self:
        """Train every module from its own images, and learn which place each neuron speaks for.

        A training that was interrupted goes on with the modules that are missing.
        """
        self.check()
        self._forget()
        levels = self.encode(references)
        first_traverse = levels[np.unique(places, return_index=True)[1]]
        networks, given = [], self._read_published()
        checkpoints = Checkpoints(self._identify_training(levels, places))
        for training, threshold in self._list_trainings(checkpoints):
            network = training.learn(make_lessons(training.model, levels, places), "training", given)
            if threshold:
                network = training.with_reactions(network, first_traverse, "counting reactions")
            networks.append(replace(network, threshold=threshold or 0))
        self._fitted = (first_traverse, checkpoints)
        return self._make_ready(networks)

    def calibrate(self, held_out: HeldOut) -> Self:
        """Choose the threshold of hyperactive neurons by held-out places, which have modules of their own.

        As published: each candidate is judged by R@1 over the held-out places' modules and queries alone; here a tie
        counts as wrong.
        """
        if self._fitted is None:
            raise NotFittedError("VPRSNN can choose a threshold only after fit(references, places)")
        shown, checkpoints = self._fitted
        levels, queries = self.encode(held_out.references), self.encode(held_out.queries)
        if not held_out.in_map:
            shown = np.concatenate([shown, levels[np.unique(held_out.places, return_index=True)[1]]])
        networks, prefix = [], _hash_arrays(shown, levels, held_out.places)
        for (training, threshold), member in zip(self._list_trainings(checkpoints, prefix), self._ready, strict=True):
            network = member.network
            if threshold is None:
                lessons = make_lessons(training.model, levels, held_out.places, _ASIDE)
                aside = training.learn(lessons, "calibration, training")
                aside = training.with_reactions(aside, shown, "calibration, counting reactions", _ASIDE)
                ready = ReadyNetwork.of(training.model, aside, _ASIDE)
                answers = ask(ready, queries, training.stage("calibration, asking"))
                best = self._choose_threshold(ready, answers, held_out.right)
                network = replace(network, reactions=None, threshold=best)
                if best:
                    network = training.with_reactions(network, shown, "counting reactions")
            networks.append(network)
        return self._make_ready(networks)

    def encode(self, images: Images) -> Levels:
        """Return the grey levels that set the rates of the input, (n_images, height * width), 0 to 255."""
        return PatchNormalisation(self.preprocessing, self.height, self.width, self.patch)(images)

    def match(self, codes: Levels) -> Scores:
        """Return the mean spikes of each place's neurons, (n_queries, n_places); -inf where none responds to a query.

        Of several networks the sum. Raises NotFittedError before `fit`.
        """
        self._require_network()
        parts = [self._score(member, ask(member, codes, Stage()).excitatory) for member in self._ready]
        scores = np.sum(parts, axis=0)
        return scoring.mark_silent_queries(scoring.normalise_scores(scores) if self.probabilities else scores, scores)

    def notes(self) -> list[str]:
        """Return how many neurons are silenced, and which parts of the training are not of this run."""
        notes = []
        if self._fitted and (n_loaded := self._fitted[1].n_loaded):
            notes.append(
                f"fit was resumed: its time leaves out {n_loaded} modules and counts of reactions that an "
                "interrupted run had finished"
            )
        if self.published_weights is not None:
            notes.append("the weights were not trained here: fit learnt only which place each neuron speaks for")
        for (_, given), ready in zip(self._members(), self._ready, strict=True):
            threshold, silenced = ready.network.threshold, ready.network.silenced
            if threshold:
                chosen = "chosen by held-out places" if given is None else "given"
                notes.append(
                    f"neurons that fired for {threshold} references or more ({chosen}) are silenced: "
                    f"{np.count_nonzero(silenced):,} of {silenced.size:,}"
                )
            elif given is None:
                notes.append("no neuron is silenced: no threshold did better on held-out places, or there are none")
        return notes

    def spikes(self, codes: Levels) -> list[LayerSpikes]:
        """Return the spikes of the input and of the excitatory and inhibitory neurons, of several networks the first's.

        Raises NotFittedError before `fit`.
        """
        self._require_network()
        answer, trains = ask(self._ready[0], codes, Stage()), self._ready[0].model.draw_query_trains(codes)
        excitatory, inhibitory = (counts.reshape(len(codes), -1) for counts in answer)
        members, others = len(self._ready), self._ready[0].model.n_excitatory - 1
        modules = [module.weights for member in self._ready for module in member.synapses]
        inputs = np.sum([np.count_nonzero(weights, axis=(0, 2)) for weights in modules], axis=0)
        return [
            LayerSpikes(
                "input",
                np.array([np.bincount(train.source, minlength=inputs.size) for train in trains]),
                fan_out=inputs,
            ),
            LayerSpikes("excitatory", excitatory, fan_out=np.full(excitatory.shape[1], members)),
            LayerSpikes("inhibitory", inhibitory, fan_out=np.full(excitatory.shape[1], members * others)),
        ]

    def state(self) -> Mapping[str, npt.NDArray[Any]]:
        """Return the arrays of the trained network, those of several numbered."""
        self._require_network()
        if len(self._ready) == 1:
            return self._ready[0].network.state()
        states = [member.network.state() for member in self._ready]
        return {f"member_{n}.{name}": array for n, state in enumerate(states) for name, array in state.items()}

    def restore(self, state: Mapping[str, npt.NDArray[Any]]) -> Self:
        """Take over a stored network; where `hyperactive_threshold` is None, with the threshold that it has."""
        self.check()
        self._forget()
        networks, members = [], self._members()
        for arrays, (_, threshold) in zip(split_members(state, len(members)), members, strict=True):
            network = Network.from_state(arrays, self.height * self.width, self.n_excitatory)
            if threshold and network.reactions is None:
                raise BadInput(
                    f"method.hyperactive_threshold={threshold}: the stored network has not counted the reactions of "
                    "its neurons; train with a threshold, or set method.hyperactive_threshold=0"
                )
            networks.append(network if threshold is None else replace(network, threshold=threshold))
        return self._make_ready(networks)

    def files(self) -> Sequence[Path]:
        """Return the published weights, where they are used; raises BadInput where they are missing."""
        if self.published_weights is None:
            return []
        return published.find_files(Path(self.published_weights))

    def _members(self) -> list[tuple[Model, int | None]]:
        """Return the model of each network, and its threshold; None: chosen by held-out places."""
        return [(Model.of(self), self.hyperactive_threshold)]

    def _list_trainings(self, checkpoints: Checkpoints, prefix: str = "") -> list[tuple[Training, int | None]]:
        """Return the training of each network, whose parts begin with `prefix`, and its threshold."""
        members = self._members()
        return [
            (Training(model, checkpoints, prefix, number / len(members), (number + 1) / len(members)), threshold)
            for number, (model, threshold) in enumerate(members)
        ]

    def _read_published(self) -> list[published.PublishedModule] | None:
        if self.published_weights is None:
            return None
        return published.read_modules(Path(self.published_weights), self.height * self.width, self.n_excitatory)

    def _choose_threshold(self, aside: ReadyNetwork, answers: Answers, right: Places) -> int:
        def score(threshold: int) -> Scores:
            network = replace(aside.network, threshold=threshold)
            found = self._score(replace(aside, network=network), answers.excitatory)
            return scoring.mark_silent_queries(found, found)

        return scoring.choose_threshold(score, right, self.hyperactive_candidates)

    def _score(self, member: ReadyNetwork, responses: npt.NDArray[np.int32]) -> Scores:
        network = member.network
        if self.assignment == "weighted":
            return scoring.score_weighted(responses, network, network.silenced, network.n_places)
        return scoring.score_standard(responses, member.labels, network.silenced, network.n_places)

    def _make_ready(self, networks: Sequence[Network]) -> Self:
        """Draw the delays of networks, so that they can be asked."""
        self._ready = [
            ReadyNetwork.of(model, network) for (model, _), network in zip(self._members(), networks, strict=True)
        ]
        return self

    def _require_network(self) -> None:
        """Raise NotFittedError without a network; one that is asked needs no checkpoints any more."""
        if not self._ready:
            raise NotFittedError("VPRSNN has no network yet: call fit(references, places) first")
        if self._fitted:
            self._fitted[1].remove()

    def _forget(self) -> None:
        """Forget the network, and remove the parts of its training."""
        if self._fitted:
            self._fitted[1].remove()
        self._ready, self._fitted = [], None

    def _identify_training(self, levels: Levels, places: Places) -> dict[str, Any]:
        """Return the plain values that decide the outcome of a training."""
        free = {"assignment", "hyperactive_candidates", "hyperactive_threshold", "probabilities"}
        digest = hashlib.sha256()
        for file in [*sorted(Path(__file__).parent.glob("*.py")), *self.files()]:
            digest.update(file.read_bytes())
        return {
            "method": type(self).__name__,
            "files": digest.hexdigest(),
            "arguments": {name: value for name, value in self.list_arguments().items() if name not in free},
            "references": _hash_arrays(levels, places),
        }


def _hash_arrays(*arrays: npt.NDArray[Any]) -> str:
    return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()

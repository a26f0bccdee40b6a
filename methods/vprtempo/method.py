"""VPRTempo, a temporally encoded spiking network, as a method."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from types import ModuleType
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from vprbench.api import (
    BadInput,
    Images,
    LayerSpikes,
    Method,
    NotFittedError,
    Places,
    Scores,
    insist_on_new_places,
    progress,
)

from . import fused, training
from .arguments import Arguments
from .growing import learnt_beside
from .layer import Layer, draw_layer
from .network import Network, members_from_state, members_state
from .query import JoinedQuery, LinearQuery, Query, SpikingQuery, asking, calibrated, feature_layers
from .rules import Rules
from .training import (
    Schedule,
    associate_places,
    check_inputs,
    check_weights,
    check_winners,
    draw_outputs,
    draw_schedule,
    draws,
    module_sizes,
    set_thresholds,
    training_of,
)

logger = logging.getLogger(__name__)

_LATEST = 500  # reference images that a new place is told from
_PROBES = 200  # reference images shown to a trained network to see whether it diverged


@dataclass
class VPRTempo(Arguments, Method):
    """The spiking network of the VPRTempo paper, its public code (64154e5) or the submission's (v1.0.0).

    `rules` chooses one of the three; an argument of None is what the rules say, any other value replaces that
    one choice (`Rules` describes them). Rates, probabilities and thresholds come from the paper's Table I.
    `encoding` chooses the input: patches (published, by the variant `preprocessing`), oriented (edges, in `rows` x
    `columns` cells of `orientations`) or gabor (filters over patches); `height` and `width` are what each of them sees.
    `engine` chooses what trains and preprocesses: fused (compiled, the default) or readable (PyTorch; the same
    results, slower).
    A network whose training diverged raises TrainingDivergedError, references of which most look alike BadInput.
    """

    conformance_arguments: ClassVar[Mapping[str, Any]] = {"max_module": 8, "height": 12, "width": 12}
    stored_as: ClassVar[str] = "vprtempo"
    _linear_query: ClassVar[Any] = LinearQuery
    _spiking_query: ClassVar[Any] = SpikingQuery

    _members: list[Network] = field(default_factory=list, init=False, repr=False, compare=False)
    _grown: list[list[Network]] = field(default_factory=list, init=False, repr=False, compare=False)
    _latest: npt.NDArray[np.float32] | None = field(default=None, init=False, repr=False, compare=False)
    _query: Query | None = field(default=None, init=False, repr=False, compare=False)

    @property
    def query_arguments(self) -> frozenset[str]:  # type: ignore[override]  # it depends on another argument
        """The arguments that may differ in a stored network: a calibration holds for one way of asking alone."""
        at_query = () if self.chosen_rules().calibrated_scores else ("query_rule", "silent_winner")
        return frozenset({"engine", *at_query})

    def adapted(self, n_places: int) -> Mapping[str, Any]:
        """Return one module of all places where a module would be larger than the map."""
        return {"max_module": n_places} if n_places < self.max_module else {}

    def fit(self, references: Images, places: Places) -> Self:
        """Train the feature layer, then the output layer; every module learns from random draws of its own."""
        n_places = int(places.max()) + 1
        self.check(n_places)
        self._query = None
        rules = self.chosen_rules()
        codes = self.encode(references)
        _, first_image = np.unique(places, return_index=True)
        probes = first_image[np.linspace(0, n_places - 1, min(_PROBES, n_places)).astype(int)]
        check_inputs(codes[probes])
        spikes = torch.from_numpy(codes).to(self.device)
        sizes = module_sizes(n_places, self.max_module)
        self._members = self._train(sizes, spikes, places, rules)
        if rules.calibrated_scores:
            self._members = [calibrated(member, spikes, rules) for member in self._members]
        query = self._asking(self._members)
        check_winners(query.scores(codes[probes]), np.repeat(np.arange(len(sizes)), sizes))
        self._query, self._grown, self._latest = query, [], codes[-_LATEST:].copy()
        return self

    @property
    def extends(self) -> bool:
        """Whether new places are learnt; not if one place has to answer where all others are silent."""
        return not self.chosen_rules().silent_winner

    def extend(self, references: Images, places: Places) -> Self:
        """Give each new place an output neuron on the features of the last module that `fit` trained.

        It learns its references among the latest others, as in a module of its own; known neurons do not learn. Every
        `max_module` new places another module begins, of the same features. Raises BadInput for a stored network.
        """
        query, rules = self._trained(), self.chosen_rules()
        n_known = sum(part[0].n_places for part in (self._members, *self._grown))
        if not self.extends:
            return super().extend(references, places)
        if self._latest is None:
            raise BadInput("a stored network has no references that a new place could be told from: call fit first")
        insist_on_new_places(places, len(references), n_known)
        n_new, codes = int(places.max()) + 1 - n_known, self.encode(references)
        shown = np.concatenate([codes, self._latest])
        numbers = np.append(places - n_known, np.full(len(self._latest), n_new))
        spikes = torch.from_numpy(shown).to(self.device)
        grown = [
            learnt_beside(self, member, [seed, n_known], spikes, numbers, self._output_training(rules))
            for seed, member in zip(self._seeds(), self._members, strict=True)
        ]
        queries = [*query.queries] if isinstance(query, JoinedQuery) else [query]
        if self._grown and self._grown[-1][0].n_places + n_new <= self.max_module:
            queries.pop()
            last = self._grown.pop()
            grown = [known.followed_by(new, in_one_module=True) for known, new in zip(last, grown, strict=True)]
        self._grown.append(grown)
        self._query, self._latest = JoinedQuery([*queries, self._asking(grown)]), shown[:_LATEST]
        return self

    def _networks(self) -> list[Network]:
        """Return the networks of all places, those that were learnt after `fit` too."""
        return [reduce(Network.followed_by, parts) for parts in zip(self._members, *self._grown, strict=True)]

    def _seeds(self) -> list[int]:
        """Return the seed of each network that is trained."""
        return [self.seed]

    def _asking(self, members: Sequence[Network]) -> Query:
        """Return the query of trained networks."""
        return asking(members, self.chosen_rules(), self._linear_query, self._spiking_query)

    def _train(self, sizes: list[int], spikes: Tensor, places: Places, rules: Rules) -> list[Network]:
        """Train one network a seed: the modules of all of them lie side by side."""
        engine = self._engine()
        features, outputs, order, output_order = self._draw(sizes, spikes.shape[1], places, rules)
        n_modules, n_features = features.thresholds.shape
        training = training_of(self, spikes, n_features)
        # The weights of one module fit into a processor's cache; a GPU wants all modules at once.
        together = 1 if spikes.device.type == "cpu" else n_modules
        groups = [slice(start, start + together) for start in range(0, n_modules, together)]
        for number, group in enumerate(groups):
            report = _reporting("training features", number, len(groups))
            if rules.feature_rule == "rates":
                set_thresholds(features[group], order[group], training)
            else:
                engine.train_features(features[group], order[group], training, report)
        check_weights(features, "feature")
        for number, group in enumerate(groups):
            report = _reporting("training places", number, len(groups))
            self._output_training(rules)(outputs[group], features[group], output_order[group], training, report)
        check_weights(outputs, "output")
        members = [slice(first, first + len(sizes)) for first in range(0, n_modules, len(sizes))]
        return [Network.of(features[own], outputs[own], sizes) for own in members]

    def _output_training(self, rules: Rules) -> Callable[..., None]:
        """Return what trains an output layer by these rules."""
        return associate_places if rules.output_rule == "covariance" else self._engine().train_places

    def _draw(
        self, sizes: list[int], n_pixels: int, places: Places, rules: Rules
    ) -> tuple[Layer, Layer, Schedule, Schedule]:
        """Draw both layers of all networks and what each of the layers will see."""
        generators = [each for seed in self._seeds() for each in draws(seed, len(sizes))]
        all_sizes = sizes * len(self._seeds())
        n_features = round(self.features_per_pixel * n_pixels)
        probabilities = (self.p_excitatory, self.p_inhibitory)
        n_post = [n_features] * len(all_sizes)
        features = draw_layer(
            generators, n_post, n_pixels, probabilities, self.threshold_max, rules.constant_input, rules
        )
        outputs = draw_outputs(self, generators, all_sizes, n_features)
        order, output_order = (
            draw_schedule(generators, sizes, places, self.epochs, rules).to(self.device) for _ in range(2)
        )
        return features.to(self.device), outputs.to(self.device), order, output_order

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        """Return the input spikes, (n_images, n_inputs of the encoder), amplitudes 0 to 1."""
        return self.encoder()(images)

    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        """Return the output neurons' states, (n_queries, n_places)."""
        return self._trained().scores(codes)

    def spikes(self, codes: npt.NDArray[np.float32]) -> list[LayerSpikes]:
        """Return the spikes of the input, feature and output layers of the network, or of the first of several.

        A linear query passes no layer that spikes but the input. Raises NotFittedError before `fit`.
        """
        self._trained()
        layers = {"input": codes}
        if self.chosen_rules().query_rule == "spiking":
            query = self._spiking_query(self._networks()[0], self.chosen_rules())
            layers["feature"], layers["output"] = query.layers(codes)
        return [LayerSpikes(name, amplitudes, "amplitude") for name, amplitudes in layers.items()]

    def layers(self, codes: npt.NDArray[np.float32]) -> dict[str, npt.NDArray[np.float32]]:
        """Return the feature neurons of all networks: their spikes, or the sums of a linear query."""
        self._trained()
        return {"feature": feature_layers(self._networks(), self.chosen_rules(), codes, self._spiking_query)}

    def state(self) -> Mapping[str, npt.NDArray[np.float32]]:
        """Return the arrays of the trained network; the arrays of several networks are numbered."""
        self._trained()
        return members_state(self._networks())

    def _trained(self) -> Query:
        if self._query is None:
            raise NotFittedError("VPRTempo has no network yet: call fit(references, places) first")
        return self._query

    def restore(self, state: Mapping[str, npt.NDArray[Any]]) -> Self:
        """Take over a stored network, or the arrays of a published checkpoint (QVPR/VPRTempo 64154e5)."""
        self._query = None
        self._members = members_from_state(state, len(self._seeds()), self.device)
        n_inputs = self.encoder().n_inputs
        for member in self._members:
            if member.features.shape[2] != n_inputs:
                raise BadInput(
                    f"the stored network reads {member.features.shape[2]} inputs, not the {n_inputs} of "
                    f"method.encoding={self.encoding}, method.height={self.height} x method.width={self.width}: "
                    "give what it was trained on"
                )
            is_calibrated = member.calibration is not None
            if self.chosen_rules().calibrated_scores != is_calibrated:
                raise BadInput(
                    f"the stored network is {'' if is_calibrated else 'not '}calibrated: "
                    f"set method.calibrated_scores={str(is_calibrated).lower()}"
                )
        self._query, self._grown, self._latest = self._asking(self._members), [], None
        return self

    def _engine(self) -> ModuleType:
        """Return the module that trains, compiled or readable, for the device."""
        if self.engine == "readable":
            return training
        if torch.device(self.device).type == "cpu":
            return fused
        try:
            from . import fused_cuda
        except ImportError as error:
            if self.engine == "fused":
                raise BadInput(f"method.engine=fused needs triton on {self.device} ({error}): install it") from error
            logger.warning("no triton for %s (%s): the readable version trains, which is slower", self.device, error)
            return training
        return fused_cuda


def _reporting(stage: str, group: int, groups: int) -> Callable[[float], None]:
    """Report that a group of modules begins; return a function that reports the group's share done as the stage's."""
    progress.report(stage, group / groups)
    return lambda done: progress.report(stage, (group + done) / groups)

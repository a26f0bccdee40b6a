"""VPRTempo, a temporally encoded spiking network, as a method."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
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
    progress,
)

from . import fused, training
from .arguments import Arguments
from .layer import Layer, draw_layer, feature_rates
from .network import Network, members_from_state, members_state
from .query import LinearQuery, Query, SpikingQuery, asking, calibrated, feature_layers, linear_layer
from .rules import Rules
from .training import (
    Schedule,
    Training,
    associate_places,
    check_inputs,
    check_weights,
    check_winners,
    draw_schedule,
    module_sizes,
    set_thresholds,
)

logger = logging.getLogger(__name__)

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
        query = self._asking()
        check_winners(query.scores(codes[probes]), np.repeat(np.arange(len(sizes)), sizes))
        self._query = query
        return self

    def _seeds(self) -> list[int]:
        """Return the seed of each network that is trained."""
        return [self.seed]

    def _asking(self) -> Query:
        """Return the query of the trained networks."""
        return asking(self._members, self.chosen_rules(), self._linear_query, self._spiking_query)

    def _train(self, sizes: list[int], spikes: Tensor, places: Places, rules: Rules) -> list[Network]:
        """Train one network a seed: the modules of all of them lie side by side."""
        engine = self._engine()
        features, outputs, order, output_order = self._draw(sizes, spikes.shape[1], places, rules)
        n_modules, n_features = features.thresholds.shape
        rates = feature_rates(n_features, self.rate_min, self.rate_max).to(self.device)
        output_stdp = self.stdp_rate if self.output_stdp_rate is None else self.output_stdp_rate
        training = Training(spikes, rates, rules, self.stdp_rate, self.itp_rate, output_stdp)
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
            train = associate_places if rules.output_rule == "covariance" else engine.train_places
            train(outputs[group], features[group], output_order[group], training, report)
        check_weights(outputs, "output")
        members = [slice(first, first + len(sizes)) for first in range(0, n_modules, len(sizes))]
        return [Network.of(features[own], outputs[own], sizes) for own in members]

    def _draw(
        self, sizes: list[int], n_pixels: int, places: Places, rules: Rules
    ) -> tuple[Layer, Layer, Schedule, Schedule]:
        """Draw both layers of all networks and what each of the layers will see."""
        generators = [
            torch.Generator().manual_seed(int(state))
            for seed in self._seeds()
            for state in np.random.SeedSequence(seed).generate_state(len(sizes), np.uint64) >> np.uint64(1)
        ]
        all_sizes = sizes * len(self._seeds())
        n_features = round(self.features_per_pixel * n_pixels)
        probabilities = (self.p_excitatory, self.p_inhibitory)
        n_post = [n_features] * len(all_sizes)
        features = draw_layer(
            generators, n_post, n_pixels, probabilities, self.threshold_max, rules.constant_input, rules
        )
        outputs = draw_layer(generators, all_sizes, n_features, (1.0, 1.0), 0.0, 0.0, rules)
        for weights in (outputs.excitation, outputs.inhibition):
            if self.equal_output_weights:
                for module, size in enumerate(all_sizes):
                    weights[module, :size] = 1 / n_features
            if self.output_norm != 1:
                weights *= self.output_norm
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
            query = self._spiking_query(self._members[0], self.chosen_rules())
            layers["feature"], layers["output"] = query.layers(codes)
        leads = [*self._fan_outs(), None]
        return [LayerSpikes(name, layers[name], "amplitude", lead) for name, lead in zip(layers, leads, strict=False)]

    def _fan_outs(self) -> list[npt.NDArray[Any]]:
        """Return the synapses that exist from each input and, of a spiking query, from each feature neuron.

        A linear query has one layer; each of several networks is asked, with as many spikes as the first.
        """
        members = self._members
        if self.chosen_rules().query_rule == "linear":
            return [torch.count_nonzero(linear_layer(members)[0], dim=0).cpu().numpy()]
        inputs = torch.stack([torch.count_nonzero(member.features, dim=(0, 1)) for member in members]).sum(0)
        outputs = torch.cat([torch.count_nonzero(weights, dim=1) for weights in members[0].outputs])
        return [inputs.cpu().numpy(), len(members) * outputs.cpu().numpy()]

    def layers(self, codes: npt.NDArray[np.float32]) -> dict[str, npt.NDArray[np.float32]]:
        """Return the feature neurons of all networks: their spikes, or the sums of a linear query."""
        self._trained()
        return {"feature": feature_layers(self._members, self.chosen_rules(), codes, self._spiking_query)}

    def state(self) -> Mapping[str, npt.NDArray[np.float32]]:
        """Return the arrays of the trained network; the arrays of several networks are numbered."""
        self._trained()
        return members_state(self._members)

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
        self._query = self._asking()
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

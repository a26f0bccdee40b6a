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
    Circuit,
    HasCircuit,
    Images,
    LayerSpikes,
    Method,
    NotFittedError,
    Places,
    Scores,
    progress,
    require_new_places,
)

from . import fused, training
from .arguments import Arguments
from .circuit import check_circuit, circuit_of
from .encoding import scale_values
from .layer import Layer, draw_layer, feature_rates
from .network import Network, last_features, members_from_state, members_state
from .query import LinearQuery, Query, SpikingQuery, asking, linear_layer, with_score_statistics
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

_MEAN = "reference_mean"  # under which a stored network holds it
_PROBES = 200  # reference images shown to a trained network to see whether it diverged


@dataclass
class VPRTempo(Arguments, Method, HasCircuit):
    """The spiking network of the VPRTempo paper, its public code (64154e5) or the submission's (v1.0.0).

    `rules` chooses one of the three; an argument of None is what the rules say, any other value replaces that
    one choice (`Rules` describes them). Rates, probabilities and thresholds come from the paper's Table I.
    `encoding` chooses the input: patches (published, by the variant `preprocessing`), oriented (edges, in `rows` x
    `columns` cells of `orientations`) or gabor (filters over patches); `height` and `width` are what each of them sees.
    `engine` chooses what trains and preprocesses: fused (compiled, the default) or readable (PyTorch; the same
    results, slower).
    A network whose training diverged raises TrainingDivergedError, references of which most look alike BadInput.
    """

    conformance_arguments: ClassVar[Mapping[str, Any]] = {
        **{"max_module": 10, "height": 12, "width": 12},
        **{"rows": 4, "columns": 5},  # of oriented edges
    }
    stored_as: ClassVar[str] = "vprtempo"
    adapts: ClassVar[bool] = True
    _linear_query: ClassVar[Any] = LinearQuery
    _spiking_query: ClassVar[Any] = SpikingQuery

    reference_mean: npt.NDArray[np.float32] | None = field(default=None, init=False, repr=False, compare=False)
    _members: list[Network] = field(default_factory=list, init=False, repr=False, compare=False)
    _grown: list[tuple[list[Network], Query]] = field(default_factory=list, init=False, repr=False, compare=False)
    _latest: npt.NDArray[np.float32] | None = field(default=None, init=False, repr=False, compare=False)
    _query: Query | None = field(default=None, init=False, repr=False, compare=False)

    @property
    def query_arguments(self) -> frozenset[str]:  # type: ignore[override]  # it depends on another argument
        """The arguments that may differ in a stored network: a calibration holds for one way of asking alone."""
        at_query = () if self.chosen_rules().calibrated_scores else ("query_rule", "silent_winner")
        return frozenset({"engine", *at_query})

    def fit(self, references: Images, places: Places) -> Self:
        """Train the feature layer, then the output layer; every module learns from random draws of its own."""
        n_places = int(places.max()) + 1
        self.check()
        self._query = None
        rules = self.chosen_rules()
        codes = self.encode(references)
        self.reference_mean = None
        if self.adapt != "none":
            self.reference_mean = codes.mean(0, dtype=np.float64).astype(np.float32)
            codes = self.centre(codes, self.reference_mean)
        _, first_image = np.unique(places, return_index=True)
        probes = first_image[np.linspace(0, n_places - 1, min(_PROBES, n_places)).astype(int)]
        check_inputs(codes[probes])
        spikes = torch.from_numpy(codes).to(self.device)
        sizes = module_sizes(n_places, self.max_module)
        self._members = self._train(sizes, spikes, places, rules)
        query = self._asking(self._members)
        check_winners(query.scores(codes[probes]), np.repeat(np.arange(len(sizes)), sizes))
        self._query, self._grown = query, []
        self._latest = codes[-(self.max_module * len(codes) // n_places) :].copy()
        return self

    @property
    def extends(self) -> bool:
        """Whether new places are learnt; not if one place has to answer where all others are silent."""
        return not self.chosen_rules().silent_winner

    def extend(self, references: Images, places: Places) -> Self:
        """Give each new place an output neuron on the features of the last module that `fit` trained.

        It learns its references among the latest others, as many as a module has; known neurons do not learn. Every
        `max_module` new places another module begins, of the same features. Raises BadInput for a stored network.
        """
        self._trained()
        n_known = sum(networks[0].n_places for networks in (self._members, *(known for known, _ in self._grown)))
        if self._latest is None or not self.extends:
            return super().extend(references, places)
        require_new_places(places, len(references), n_known)
        codes = self.encode(references)
        new = codes if self.reference_mean is None else self.centre(codes, self.reference_mean)
        n_new, shown = int(places.max()) + 1 - n_known, np.concatenate([new, self._latest])
        numbers = np.append(places - n_known, np.full(len(self._latest), n_new))
        spikes = torch.from_numpy(shown).to(self.device)
        grown = self._train([n_new], spikes, numbers, self.chosen_rules(), n_known)
        if self._grown and self._grown[-1][0][0].n_places + n_new <= self.max_module:
            last, _ = self._grown.pop()
            grown = [known.followed_by(new, in_one_module=True) for known, new in zip(last, grown, strict=True)]
        self._grown.append((grown, self._asking(grown)))
        self._latest = shown[: len(self._latest)]
        return self

    def _networks(self) -> list[Network]:
        """Return the networks with all places, those that were learnt after `fit` too."""
        every = zip(self._members, *(known for known, _ in self._grown), strict=True)
        return [reduce(Network.followed_by, networks) for networks in every]

    def _seeds(self) -> list[int]:
        """Return the seed of each network that is trained."""
        return [self.seed]

    def _asking(self, members: Sequence[Network]) -> Query:
        """Return the query of trained networks."""
        return asking(members, self.chosen_rules(), self._linear_query, self._spiking_query)

    def _train(self, sizes: list[int], spikes: Tensor, places: Places, rules: Rules, n_known: int = 0) -> list[Network]:
        """Train one network a seed: the modules of all of them lie side by side.

        After `n_known` places their last features stay, and one more output neuron, then left out, stands for others.
        """
        engine = self._engine()
        drawn = [size + bool(n_known) for size in sizes]
        features, outputs, order, output_order = self._draw(drawn, spikes.shape[1], places, rules, n_known)
        n_modules, n_features = features.thresholds.shape
        rates = feature_rates(n_features, self.rate_min, self.rate_max).to(self.device)
        output_stdp = self.stdp_rate if self.output_stdp_rate is None else self.output_stdp_rate
        training = Training(spikes, rates, rules, self.stdp_rate, self.itp_rate, output_stdp)
        # The weights of one module fit into a processor's cache; a GPU wants all modules at once.
        together = 1 if spikes.device.type == "cpu" else n_modules
        groups = [slice(start, start + together) for start in range(0, n_modules, together)]
        for number, group in enumerate([] if n_known else groups):
            report = _reporting("training features", number, len(groups))
            if rules.feature_rule == "rates":
                set_thresholds(features[group], order[group], training)
            else:
                engine.train_features(features[group], order[group], training, report)
        if rules.feature_rule != "rates":  # under which features keep the weights that were drawn
            check_weights(features, "feature")
        for number, group in enumerate(groups):
            report = _reporting("training places", number, len(groups))
            train = associate_places if rules.output_rule == "covariance" else engine.train_places
            train(outputs[group], features[group], output_order[group], training, report)
        check_weights(outputs, "output")
        members = [slice(first, first + len(sizes)) for first in range(0, n_modules, len(sizes))]
        networks = [Network.of(features[own], outputs[own], sizes) for own in members]
        if rules.calibrated_scores:
            return [with_score_statistics(network, spikes, rules) for network in networks]
        return networks

    def _draw(
        self, sizes: list[int], n_pixels: int, places: Places, rules: Rules, n_known: int
    ) -> tuple[Layer, Layer, Schedule, Schedule]:
        """Draw both layers of all networks and what each of the layers will see."""
        generators = [
            torch.Generator().manual_seed(int(state))
            for seed in self._seeds()
            for entropy in [[seed, n_known] if n_known else seed]
            for state in np.random.SeedSequence(entropy).generate_state(len(sizes), np.uint64) >> np.uint64(1)
        ]
        all_sizes = sizes * len(self._seeds())
        n_features = round(self.features_per_pixel * n_pixels)
        probabilities = (self.p_excitatory, self.p_inhibitory)
        n_post = [n_features] * len(all_sizes)
        drawn = generators, n_post, n_pixels, probabilities, self.threshold_max, rules.constant_input, rules
        features = last_features(self._members) if n_known else draw_layer(*drawn)
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

    def centre(self, codes: npt.NDArray[np.float32], mean: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return spikes (..., n_inputs) without a mean as amplitudes 0 to 1 again, scaled by `scale_values`."""
        deviations = (codes - mean).reshape(-1, codes.shape[-1])
        return scale_values(deviations).reshape(codes.shape)

    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        """Return the output neurons' states, (n_queries, n_places)."""
        scores = [query.scores(codes) for query in (self._trained(), *(query for _, query in self._grown))]
        return scores[0] if len(scores) == 1 else np.concatenate(scores, axis=1)

    def spikes(self, codes: npt.NDArray[np.float32]) -> list[LayerSpikes]:
        """Return the spikes of the input, feature and output layers of the network, or of the first of several.

        A linear query passes no layer that spikes but the input. Raises NotFittedError before `fit`.
        """
        self._trained()
        layers = {"input": codes}
        if self.chosen_rules().query_rule == "spiking":
            query = self._spiking_query(self._networks()[0], self.chosen_rules())
            layers["feature"], layers["output"] = query.layers(codes)
        leads = [*self._fan_outs(), None]
        return [LayerSpikes(name, layers[name], "amplitude", lead) for name, lead in zip(layers, leads, strict=False)]

    def _fan_outs(self) -> list[npt.NDArray[Any]]:
        """Return the synapses that exist from each input and, of a spiking query, from each feature neuron.

        A linear query has one layer; each of several networks is asked, with as many spikes as the first.
        """
        members = self._networks()
        if self.chosen_rules().query_rule == "linear":
            return [torch.count_nonzero(linear_layer(members)[0], dim=0).cpu().numpy()]
        inputs = torch.stack([torch.count_nonzero(member.features, dim=(0, 1)) for member in members]).sum(0)
        outputs = torch.cat([torch.count_nonzero(weights, dim=1) for weights in members[0].outputs])
        return [inputs.cpu().numpy(), len(members) * outputs.cpu().numpy()]

    def state(self) -> Mapping[str, npt.NDArray[np.float32]]:
        """Return the arrays of the trained network; the arrays of several networks are numbered."""
        self._trained()
        mean = {} if self.reference_mean is None else {_MEAN: self.reference_mean}
        return members_state(self._networks()) | mean

    def check_circuit(self) -> None:
        """Raise BadInput for a spiking query that does more than its two layers."""
        if self.adapt != "none":
            raise BadInput(f"method.adapt={self.adapt} is no layer of neurons: set method.adapt=none")
        check_circuit(len(self._seeds()), self.chosen_rules())

    def circuit(self) -> Circuit:
        """Return the layers of the trained networks as the query rule asks them, in full precision."""
        self.check_circuit()
        self._trained()
        return circuit_of(self._networks(), self.chosen_rules())

    def _trained(self) -> Query:
        if self._query is None:
            raise NotFittedError("VPRTempo has no network yet: call fit(references, places) first")
        return self._query

    def restore(self, state: Mapping[str, npt.NDArray[Any]]) -> Self:
        """Take over a stored network, or the arrays of a published checkpoint (QVPR/VPRTempo 64154e5)."""
        self._query = None
        mean, state = state.get(_MEAN), {name: array for name, array in state.items() if name != _MEAN}
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
        if (mean is None) != (self.adapt == "none") or (mean is not None and mean.shape != (n_inputs,)):
            kept = "no mean" if mean is None else f"a mean of shape {mean.shape}"
            raise BadInput(f"the stored network has {kept} of its references: set method.adapt as it was trained")
        if mean is not None and not np.isfinite(mean).all():
            raise BadInput(f"the stored network's {_MEAN} holds values that are not finite: get the file anew")
        self.reference_mean = None if mean is None else np.asarray(mean, np.float32)
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

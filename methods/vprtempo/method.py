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
from .encoding import scale_values
from .layer import Layer, draw_layer, ramp_rates
from .network import Network, join_states, read_members, take_last_features
from .query import LinearQuery, Query, SpikingQuery, calibrate_network, make_circuit, make_query, multiply_layers
from .rules import Rules
from .training import (
    Schedule,
    Training,
    associate_places,
    check_inputs,
    check_weights,
    check_winners,
    draw_schedule,
    set_thresholds,
    split_places,
)

logger = logging.getLogger(__name__)

_MEAN = "reference_mean"  # under which a stored network holds it
_PROBES = 200  # reference images shown to a trained network to see whether it diverged


@dataclass
class VPRTempo(Arguments, Method, HasCircuit):
    """The spiking network of the VPRTempo paper, its public code (64154e5) or the submission's (v1.0.0).

    `rules` chooses one of the three; an argument of None follows the rules, any other value replaces that one
    choice (`Rules` describes them). Rates, probabilities and thresholds come from the paper's Table I.
    `encoding` chooses the input: patches (published, by the variant `preprocessing`), oriented (edges, in `rows` x
    `columns` cells of `orientations`) or gabor (filters over patches); each of them sees `height` x `width` pixels.
    `engine` trains: fused (compiled, the default) or readable (PyTorch; the same results, slower).
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
    #: The networks of one seed each and their query: first those that `fit` trained, then of places learnt after it.
    _parts: list[tuple[list[Network], Query]] = field(default_factory=list, init=False, repr=False, compare=False)
    _latest: npt.NDArray[np.float32] | None = field(default=None, init=False, repr=False, compare=False)

    @property
    def query_arguments(self) -> frozenset[str]:  # type: ignore[override]  # it depends on another argument
        """The arguments that may differ in a stored network: a calibration holds for one way of asking alone."""
        at_query = () if self.choose_rules().calibrated_scores else ("query_rule", "silent_winner")
        return frozenset({"engine", *at_query})

    def fit(self, references: Images, places: Places) -> Self:
        """Train the feature layer, then the output layer; every module learns from random draws of its own."""
        n_places = int(places.max()) + 1
        self.check()
        self._parts = []
        rules = self.choose_rules()
        codes = self.encode(references)
        self.reference_mean = None
        if self.adapt != "none":
            self.reference_mean = codes.mean(0, dtype=np.float64).astype(np.float32)
            codes = self.centre(codes, self.reference_mean)
        _, first_image = np.unique(places, return_index=True)
        probes = first_image[np.linspace(0, n_places - 1, min(_PROBES, n_places)).astype(int)]
        check_inputs(codes[probes])
        spikes = torch.from_numpy(codes).to(self.device)
        sizes = split_places(n_places, self.max_module)
        members = self._train(sizes, spikes, places, rules)
        query = self._make_query(members)
        check_winners(query.scores(codes[probes]), np.repeat(np.arange(len(sizes)), sizes))
        self._parts = [(members, query)]
        self._latest = codes[-(self.max_module * len(codes) // n_places) :].copy()
        return self

    @property
    def extends(self) -> bool:
        """Whether new places are learnt; not if one place has to answer where all others are silent."""
        return not self.choose_rules().silent_winner

    def extend(self, references: Images, places: Places) -> Self:
        """Give each new place an output neuron on the features of the last module that `fit` trained.

        It learns its references among the latest others, as many as a module has; known neurons do not learn. Every
        `max_module` new places another module begins, of the same features. Raises BadInput for a stored network.
        """
        n_known = sum(members[0].n_places for members, _ in self._require_parts())
        if self._latest is None or not self.extends:
            return super().extend(references, places)
        require_new_places(places, len(references), n_known)
        codes = self.encode(references)
        new = codes if self.reference_mean is None else self.centre(codes, self.reference_mean)
        n_new, shown = int(places.max()) + 1 - n_known, np.concatenate([new, self._latest])
        numbers = np.append(places - n_known, np.full(len(self._latest), n_new))
        spikes = torch.from_numpy(shown).to(self.device)
        grown = self._train([n_new], spikes, numbers, self.choose_rules(), n_known)
        if len(self._parts) > 1 and self._parts[-1][0][0].n_places + n_new <= self.max_module:
            last, _ = self._parts.pop()
            grown = [known.followed_by(new, in_one_module=True) for known, new in zip(last, grown, strict=True)]
        self._parts.append((grown, self._make_query(grown)))
        self._latest = shown[: len(self._latest)]
        return self

    def _join_networks(self) -> list[Network]:
        """Return the networks with all places, also with places that were learnt after `fit`."""
        by_seed = zip(*(members for members, _ in self._require_parts()), strict=True)
        return [reduce(Network.followed_by, networks) for networks in by_seed]

    def _seeds(self) -> list[int]:
        """Return the seed of each network that is trained."""
        return [self.seed]

    def _make_query(self, members: Sequence[Network]) -> Query:
        """Return the query of trained networks."""
        return make_query(members, self.choose_rules(), self._linear_query, self._spiking_query)

    def _train(self, sizes: list[int], spikes: Tensor, places: Places, rules: Rules, n_known: int = 0) -> list[Network]:
        """Train one network a seed: the modules of all of them lie side by side.

        After `n_known` places their last features stay, and one more output neuron, then left out, stands for others.
        """
        engine = self._choose_engine()
        drawn = [size + bool(n_known) for size in sizes]
        features, outputs, order, output_order = self._draw(drawn, spikes.shape[1], places, rules, n_known)
        n_modules, n_features = features.thresholds.shape
        rates = ramp_rates(n_features, self.rate_min, self.rate_max).to(self.device)
        output_stdp = self.stdp_rate if self.output_stdp_rate is None else self.output_stdp_rate
        training = Training(spikes, rates, rules, self.stdp_rate, self.itp_rate, output_stdp)
        # The weights of one module fit into a processor's cache; a GPU wants all modules at once.
        together = 1 if spikes.device.type == "cpu" else n_modules
        groups = [slice(start, start + together) for start in range(0, n_modules, together)]
        for number, group in enumerate([] if n_known else groups):
            report = _report_group("training features", number, len(groups))
            if rules.feature_rule == "rates":
                set_thresholds(features[group], order[group], training)
            else:
                engine.train_features(features[group], order[group], training, report)
        if rules.feature_rule != "rates":  # under which features keep the weights that were drawn
            check_weights(features, "feature")
        for number, group in enumerate(groups):
            report = _report_group("training places", number, len(groups))
            train = associate_places if rules.output_rule == "covariance" else engine.train_places
            train(outputs[group], features[group], output_order[group], training, report)
        check_weights(outputs, "output")
        members = [slice(first, first + len(sizes)) for first in range(0, n_modules, len(sizes))]
        networks = [Network.of(features[own], outputs[own], sizes) for own in members]
        if rules.calibrated_scores:
            return [calibrate_network(network, spikes, rules) for network in networks]
        return networks

    def _draw(
        self, sizes: list[int], n_pixels: int, places: Places, rules: Rules, n_known: int
    ) -> tuple[Layer, Layer, Schedule, Schedule]:
        """Draw both layers of all networks and the schedule of each layer."""
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
        features = take_last_features(self._parts[0][0]) if n_known else draw_layer(*drawn)
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
        scores = [query.scores(codes) for _, query in self._require_parts()]
        return scores[0] if len(scores) == 1 else np.concatenate(scores, axis=1)

    def spikes(self, codes: npt.NDArray[np.float32]) -> list[LayerSpikes]:
        """Return the spikes of the input, feature and output layers of the network, or of the first of several.

        A linear query passes no layer that spikes but the input. Raises NotFittedError before `fit`.
        """
        layers = {"input": codes}
        if self.choose_rules().query_rule == "spiking":
            query = self._spiking_query(self._join_networks()[0], self.choose_rules())
            layers["feature"], layers["output"] = query.layers(codes)
        leads = [*self._count_fan_outs(), None]
        return [LayerSpikes(name, layers[name], "amplitude", lead) for name, lead in zip(layers, leads, strict=False)]

    def _count_fan_outs(self) -> list[npt.NDArray[Any]]:
        """Return the synapses that exist from each input and, of a spiking query, from each feature neuron.

        A linear query has one layer; each of several networks is asked, with as many spikes as the first.
        """
        members = self._join_networks()
        if self.choose_rules().query_rule == "linear":
            return [torch.count_nonzero(multiply_layers(members)[0], dim=0).cpu().numpy()]
        inputs = torch.stack([torch.count_nonzero(member.features, dim=(0, 1)) for member in members]).sum(0)
        outputs = torch.cat([torch.count_nonzero(weights, dim=1) for weights in members[0].outputs])
        return [inputs.cpu().numpy(), len(members) * outputs.cpu().numpy()]

    def state(self) -> Mapping[str, npt.NDArray[np.float32]]:
        """Return the arrays of the trained network; the arrays of several networks are numbered."""
        mean = {} if self.reference_mean is None else {_MEAN: self.reference_mean}
        return join_states(self._join_networks()) | mean

    def check_circuit(self) -> None:
        """Raise BadInput for a spiking query that does more than its two layers."""
        rules = self.choose_rules()
        spiking = rules.query_rule == "spiking"
        beyond = {
            f"method.adapt={self.adapt}": self.adapt != "none",
            "method.members": spiking and len(self._seeds()) > 1,
            "method.calibrated_scores=true": spiking and rules.calibrated_scores,
            "method.silent_winner=true": spiking and rules.silent_winner,
        }
        for name, acts in beyond.items():
            if acts:
                raise BadInput(
                    f"{name} is more than two layers of neurons: leave it out, or set method.query_rule=linear"
                )

    def circuit(self) -> Circuit:
        """Return the layers of the trained networks as the query rule asks them, in full precision."""
        self.check_circuit()
        return make_circuit(self._join_networks(), self.choose_rules())

    def _require_parts(self) -> list[tuple[list[Network], Query]]:
        if not self._parts:
            raise NotFittedError("VPRTempo has no network yet: call fit(references, places) first")
        return self._parts

    def restore(self, state: Mapping[str, npt.NDArray[Any]]) -> Self:
        """Take over a stored network, or the arrays of a published checkpoint (QVPR/VPRTempo 64154e5)."""
        self._parts = []
        mean, state = state.get(_MEAN), {name: array for name, array in state.items() if name != _MEAN}
        members = read_members(state, len(self._seeds()), self.device)
        n_inputs, is_calibrated = self.encoder().n_inputs, members[0].calibration is not None
        n_read = members[0].features.shape[2]
        if n_read != n_inputs:
            raise BadInput(
                f"the stored network reads {n_read} inputs, not the {n_inputs} of method.encoding={self.encoding}, "
                f"method.height={self.height} x method.width={self.width}: set them as it was trained"
            )
        if self.choose_rules().calibrated_scores != is_calibrated:
            raise BadInput(
                f"the stored network is {'' if is_calibrated else 'not '}calibrated: "
                f"set method.calibrated_scores={str(is_calibrated).lower()}"
            )
        if (self.adapt == "none") != (mean is None) or (mean is not None and mean.shape != (n_inputs,)):
            raise BadInput(
                f"the stored network's {_MEAN} has the shape {None if mean is None else mean.shape}: "
                "set method.adapt as it was trained"
            )
        self.reference_mean = None if mean is None else np.asarray(mean, np.float32)
        self._parts, self._latest = [(members, self._make_query(members))], None
        return self

    def _choose_engine(self) -> ModuleType:
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


def _report_group(stage: str, group: int, groups: int) -> Callable[[float], None]:
    """Report that a group of modules begins; return a function that reports the group's share done as the stage's."""
    progress.report(stage, group / groups)
    return lambda done: progress.report(stage, (group + done) / groups)

"""VPRTempo, a temporally encoded spiking network: the readable version that faster ones are judged by."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from types import ModuleType
from typing import Any, ClassVar, Literal, Self

import numpy as np
import numpy.typing as npt
import torch

from vprbench import progress
from vprbench.images import Images
from vprbench.interface import BadInput, Method, NotFittedError, Places, Scores
from vprbench.preprocess import PatchNormalisation, Variant

from . import fused, training
from .layer import Layer, draw_layer, feature_rates
from .network import Network
from .rules import RULES, QueryRule, Rules, RuleSet, ThresholdRule
from .training import check_weights, check_winners, draw_schedule, module_sizes

Engine = Literal["fused", "readable"]

_PROBES = 200  # reference images shown to a trained network to see whether it diverged


@dataclass
class VPRTempo(Method):
    """The spiking network of the VPRTempo paper, its public code (64154e5) or the submission's (v1.0.0).

    `rules` chooses one of the three; an argument of None is what the rules say, any other value replaces that
    one choice (`Rules` describes them). Rates, probabilities and thresholds are those of the paper's Table I.
    `engine` is fused (compiled, the default on a CPU) or readable (PyTorch; the same results, slower).
    A network whose training diverged raises TrainingDivergedError.
    """

    rules: RuleSet = "paper"
    preprocessing: Variant = "C"
    height: int = 28  # pixels
    width: int = 28
    patch: int = 7
    max_module: int = 1100  # places
    features_per_pixel: float = 2.0
    epochs: int = 4
    stdp_rate: float = 0.005
    itp_rate: float = 0.15
    threshold_max: float = 0.5
    rate_min: float = 0.2
    rate_max: float = 0.9
    p_excitatory: float = 0.1
    p_inhibitory: float = 0.5
    silent_winner: bool | None = None
    query_rule: QueryRule | None = None
    one_sign_per_synapse: bool | None = None
    normalise_by_last_neuron: bool | None = None
    constant_input: float | None = None
    clip: float | None = None
    threshold_rule: ThresholdRule | None = None
    stdp_divided_by_rate: bool | None = None
    homeostasis_gain: float | None = None
    output_thresholds_learn: bool | None = None
    error_to_each_sign: bool | None = None
    shuffle: bool | None = None
    annealing_restarts: bool | None = None
    annealing_interval: int | None = None
    engine: Engine | None = None
    seed: int = 0
    device: str = "cpu"

    conformance_arguments: ClassVar[Mapping[str, Any]] = {"max_module": 8, "height": 12, "width": 12}

    _network: Network | None = field(default=None, init=False, repr=False, compare=False)

    def fit(self, references: Images, places: Places) -> Self:
        """Train the feature layer, then the output layer; every module learns from random draws of its own."""
        self._check_arguments(int(places.max()) + 1)
        self._network = None
        rules = self.chosen_rules()
        sizes = module_sizes(int(places.max()) + 1, self.max_module)
        seeds = np.random.SeedSequence(self.seed).generate_state(len(sizes), np.uint64) >> np.uint64(1)
        generators = [torch.Generator().manual_seed(int(seed)) for seed in seeds]
        spikes = torch.from_numpy(self.encode(references)).to(self.device)
        features, outputs = self._draw_layers(generators, sizes, spikes.shape[1], rules)
        rates = feature_rates(features.thresholds.shape[1], self.rate_min, self.rate_max).to(self.device)
        schedules = [
            draw_schedule(generators, sizes, places, self.epochs, rules).to(self.device) for _ in ("features", "places")
        ]
        engine = self._engine()
        # The weights of one module fit into a processor's cache; a GPU wants all modules at once.
        together = 1 if torch.device(self.device).type == "cpu" else len(sizes)
        groups = [slice(start, start + together) for start in range(0, len(sizes), together)]
        for number, group in enumerate(groups):
            engine.train_features(
                features[group],
                spikes,
                schedules[0][group],
                rates,
                self.stdp_rate,
                self.itp_rate,
                rules,
                _reporting("training features", number, len(groups)),
            )
        check_weights(features, "feature")
        for number, group in enumerate(groups):
            engine.train_places(
                outputs[group],
                features[group],
                spikes,
                schedules[1][group],
                rates,
                self.stdp_rate,
                rules,
                _reporting("training places", number, len(groups)),
            )
        check_weights(outputs, "output")
        network = Network.of(features, outputs, sizes, rules)
        _, first_image = np.unique(places, return_index=True)
        probes = first_image[np.linspace(0, len(first_image) - 1, min(_PROBES, len(first_image))).astype(int)]
        check_winners(network.scores(spikes[probes]).cpu().numpy(), np.repeat(np.arange(len(sizes)), sizes))
        self._network = network
        return self

    def encode(self, images: Images) -> npt.NDArray[np.float32]:
        """Return the input spikes, (n_images, height * width), amplitudes 0 to 1."""
        levels = PatchNormalisation(self.preprocessing, self.height, self.width, self.patch)(images)
        spikes = levels.astype(np.float32) / 255
        if self.preprocessing == "C":  # the public code's 8-bit step: a grid of 256 levels up to the image's maximum
            scale = np.maximum(spikes.max(1, keepdims=True), np.float32(1 / 255)) / 255
            spikes = np.round(spikes / scale) * scale
        return np.asarray(spikes, dtype=np.float32)

    def match(self, codes: npt.NDArray[np.float32]) -> Scores:
        """Return the output neurons' states, (n_queries, n_places)."""
        if self._network is None:
            raise NotFittedError("VPRTempo has no network yet: call fit(references, places) first")
        return self._network.scores(torch.tensor(codes, device=self.device)).cpu().numpy()

    def chosen_rules(self) -> Rules:
        """Return the rules after the arguments that replace single choices."""
        names = {choice.name for choice in fields(Rules)}
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        return replace(RULES[self.rules], **given)

    def _check_arguments(self, n_places: int) -> None:
        """Raise BadInput for arguments under which there is no network."""
        rules = self.chosen_rules()
        wanted = {
            "epochs": (self.epochs >= 1, "at least 1"),
            "max_module": (self.max_module >= 1, "at least 1 place"),
            "features_per_pixel": (0 < self.features_per_pixel < math.inf, "more than 0"),
            "stdp_rate": (0 <= self.stdp_rate < math.inf, "0 or more"),
            "itp_rate": (0 <= self.itp_rate < math.inf, "0 or more"),
            "threshold_max": (0 <= self.threshold_max < math.inf, "0 or more"),
            "rate_min": (0 < self.rate_min <= self.rate_max, "more than 0 and at most method.rate_max"),
            "rate_max": (self.rate_max < math.inf, "a finite rate"),
            "p_excitatory": (0 <= self.p_excitatory <= 1, "a probability"),
            "p_inhibitory": (0 <= self.p_inhibitory <= 1, "a probability"),
            "constant_input": (0 <= rules.constant_input < math.inf, "0 or more"),
            "clip": (0 < rules.clip < math.inf, "more than 0"),
            "homeostasis_gain": (0 <= rules.homeostasis_gain < math.inf, "0 or more"),
            "annealing_interval": (rules.annealing_interval >= 1, "at least 1 step"),
        }
        for name, (fits, what) in wanted.items():
            if not fits:
                raise BadInput(f"method.{name}={getattr(self, name)}: give {what}")
        if n_places < self.max_module:
            raise BadInput(
                f"{n_places} places are fewer than one module of method.max_module={self.max_module}: "
                f"pass method.max_module={n_places} for one module, or less for several"
            )

    def _engine(self) -> ModuleType:
        """Return the module that trains: compiled on a CPU, readable elsewhere, or what was asked for."""
        on_cpu = torch.device(self.device).type == "cpu"
        engine = self.engine or ("fused" if on_cpu else "readable")
        if engine == "fused" and not on_cpu:
            raise BadInput(f"method.engine=fused runs on device=cpu, not on {self.device}: leave method.engine out")
        if engine == "readable":
            return training
        return fused

    def _draw_layers(
        self, generators: list[torch.Generator], sizes: list[int], n_pixels: int, rules: Rules
    ) -> tuple[Layer, Layer]:
        n_features = round(self.features_per_pixel * n_pixels)
        features = draw_layer(
            generators,
            [n_features] * len(sizes),
            n_pixels,
            (self.p_excitatory, self.p_inhibitory),
            self.threshold_max,
            rules.constant_input,
            rules,
        )
        outputs = draw_layer(generators, sizes, n_features, (1.0, 1.0), 0.0, 0.0, rules)
        return features.to(self.device), outputs.to(self.device)


def _reporting(stage: str, group: int, groups: int) -> Callable[[float], None]:
    """Return a function that reports the share done of one group of modules as a share of the stage."""
    return lambda done: progress.report(stage, (group + done) / groups)

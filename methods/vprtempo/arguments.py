"""The arguments of VPRTempo, with the paper's values as defaults, and the rules and the encoder that they choose."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Literal

from vprbench.api import Adapt, BadInput

from ..parts.filters.gabor import GaborBank
from ..parts.filters.oriented import OrientedEdges
from ..parts.filters.patches import PatchNormalisation, Variant
from .encoding import Encoder, Patches
from .rules import RULES, FeatureRule, OutputRule, QueryRule, Rules, RuleSet, ThresholdRule

Encoding = Literal["patches", "oriented", "gabor"]
Engine = Literal["fused", "readable"]


@dataclass
class Arguments:
    """The arguments of VPRTempo: the values of the paper's Table I; None: as `rules` say."""

    rules: RuleSet = "paper"
    encoding: Encoding = "patches"
    preprocessing: Variant = "C"
    height: int = 28  # pixels, that every encoding brings frames to
    width: int = 28
    patch: int = 7
    rows: int = 8  # cells of oriented edges
    columns: int = 16
    orientations: int = 8
    contrast_power: float = 1.0  # that oriented edges are raised to
    adapt: Adapt = "none"  # which mean is taken off the input spikes
    max_module: int = 1100  # places, at most
    features_per_pixel: float = 2.0  # of an input
    epochs: int = 4
    stdp_rate: float = 0.005
    output_stdp_rate: float | None = None  # None: stdp_rate
    itp_rate: float = 0.15
    threshold_max: float = 0.5
    rate_min: float = 0.2
    rate_max: float = 0.9
    p_excitatory: float = 0.1
    p_inhibitory: float = 0.5
    output_norm: float = 1.0  # of an output neuron's initial weights of each sign (L1)
    equal_output_weights: bool = False  # initially, instead of random ones
    silent_winner: bool | None = None
    query_rule: QueryRule | None = None
    calibrated_scores: bool | None = None
    one_sign_per_synapse: bool | None = None
    normalise_by_last_neuron: bool | None = None
    constant_input: float | None = None
    clip: float | None = None
    even_connections: bool | None = None
    feature_rule: FeatureRule | None = None
    output_rule: OutputRule | None = None
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

    def encoder(self) -> Encoder:
        """Return the encoder; raises BadInput for sizes under which there are none."""
        if self.encoding == "oriented":
            cells = (self.rows, self.columns, self.orientations)
            return OrientedEdges(self.height, self.width, *cells, power=self.contrast_power)
        if self.encoding == "gabor":
            return GaborBank(self.height, self.width, self.patch)
        return Patches(PatchNormalisation(self.preprocessing, self.height, self.width, self.patch))

    def choose_rules(self) -> Rules:
        """Return the rules, single choices replaced by arguments; raises BadInput if two exclude each other."""
        names = {choice.name for choice in fields(Rules)}
        given = {name: getattr(self, name) for name in names if getattr(self, name) is not None}
        rules = replace(RULES[self.rules], **given)
        if (rules.output_rule, rules.query_rule, rules.calibrated_scores) == ("covariance", "linear", False):
            raise BadInput(
                "method.query_rule=linear leaves out the thresholds, which hold the mean of the features under "
                "method.output_rule=covariance: set method.calibrated_scores=true"
            )
        return rules

    def check(self) -> None:
        """Raise BadInput for arguments under which there is no network."""
        rules = self.choose_rules()
        wanted = {
            "epochs": (self.epochs >= 1, "at least 1"),
            "max_module": (self.max_module >= 1, "at least 1 place"),
            "features_per_pixel": (0 < self.features_per_pixel < math.inf, "more than 0"),
            "stdp_rate": (0 <= self.stdp_rate < math.inf, "0 or more"),
            "output_stdp_rate": (0 <= (self.output_stdp_rate or 0) < math.inf, "0 or more"),
            "itp_rate": (0 <= self.itp_rate < math.inf, "0 or more"),
            "threshold_max": (0 <= self.threshold_max < math.inf, "0 or more"),
            "rate_min": (0 < self.rate_min <= self.rate_max, "more than 0 and at most method.rate_max"),
            "rate_max": (self.rate_max < math.inf, "a finite rate"),
            "p_excitatory": (0 <= self.p_excitatory <= 1, "a probability"),
            "p_inhibitory": (0 <= self.p_inhibitory <= 1, "a probability"),
            "output_norm": (0 < self.output_norm < math.inf, "more than 0"),
            "constant_input": (0 <= rules.constant_input < math.inf, "0 or more"),
            "clip": (0 < rules.clip < math.inf, "more than 0"),
            "homeostasis_gain": (0 <= rules.homeostasis_gain < math.inf, "0 or more"),
            "annealing_interval": (rules.annealing_interval >= 1, "at least 1 step"),
        }
        for name, (fits, demand) in wanted.items():
            if not fits:
                raise BadInput(f"method.{name}={getattr(self, name)}: give {demand}")
        if self.equal_output_weights and rules.one_sign_per_synapse:
            raise BadInput(
                "method.equal_output_weights=true leaves nothing where excitation and inhibition are one weight: "
                "set method.one_sign_per_synapse=false"
            )

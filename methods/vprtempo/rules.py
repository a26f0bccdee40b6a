"""The differences between the three published versions of VPRTempo, as one set of choices each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

RuleSet = Literal["paper", "reference", "v1"]
ThresholdRule = Literal["spike", "amplitude", "decay"]
FeatureRule = Literal["stdp", "rates"]
OutputRule = Literal["forcing", "covariance"]
QueryRule = Literal["spiking", "linear"]


@dataclass(frozen=True)
class Rules:
    """The choices in which the paper, its public code and the code of the submission differ; the defaults are PAPER."""

    one_sign_per_synapse: bool = False
    """The sum of both draws is one signed weight (public code), or W+ and W- live side by side (paper)."""
    normalise_by_last_neuron: bool = False
    """Initial weights are divided by the last neuron's L1 norm (public code), or each neuron's by its own."""
    constant_input: float = 0.1
    """Upper end of the uniform constant input C of a feature neuron (paper, Table I)."""
    clip: float = 0.9
    """Upper limit of an activation: 0.9 in all public versions, 1 as printed in the paper."""
    even_connections: bool = False
    """Connections are drawn so that neurons have about equally many, at least one, and inputs too, instead of each by
    chance (no public version)."""
    feature_rule: FeatureRule = "stdp"
    """Features learn by Eqs. 2, 4 and 5; or their weights stay as drawn, and their thresholds are where Eq. 5 comes to
    rest, with every neuron at its target rate (no public version)."""
    output_rule: OutputRule = "forcing"
    """Outputs learn by Eqs. 4 and 6; or from 0 by the error of Eq. 6 times how far a feature is from its mean over the
    references (covariance rule, Sejnowski 1977), a feature's mean counting as silence (no public version)."""
    threshold_rule: ThresholdRule = "spike"
    """Eq. 5 with Theta(x_j); with the amplitude x_j (v1.0.0); or with a spike that is never set (public code)."""
    stdp_divided_by_rate: bool = False
    """Eq. 2 with its factor 1/f_j, which no public version has."""
    homeostasis_gain: float = 50.0
    """W- is scaled by 1 + gain * learning rate * net input."""
    output_thresholds_learn: bool = False
    """Output thresholds follow the sign of the error (v1.0.0)."""
    error_to_each_sign: bool = False
    """Eq. 6 moves W+ and W- by the full amount each (v1.0.0), or the signed weight W+ - W- by it, half in each."""
    shuffle: bool = True
    """Images come in a new random order each epoch, or traverse after traverse."""
    annealing_restarts: bool = False
    """Eq. 3 runs over one epoch and starts again, or once over the training."""
    annealing_interval: int = 100
    """Steps between two changes of the learning rates."""
    silent_winner: bool = False
    """Where a query leaves all outputs silent, the first module's least inhibited neuron answers (v1.0.0)."""
    calibrated_scores: bool = False
    """A place's score is standardised by the scores that the reference images give it, so that no place is louder than
    others (no public version)."""
    query_rule: QueryRule = "spiking"
    """A query passes thresholds, clip and C as in Eq. 1, or the two weight matrices alone (public code)."""


# VPRTempo paper, Eqs. 1 to 6; v1.0.0 where it is silent; but shuffled and annealed once, for v1.0.0's fixed order
# with restarts collapses on a single traverse. Eq. 2 is without 1/f_j, as in every public version; Eq. 6 is about
# the signed weight, which v1.0.0 moves twice as far by adding the step to W+ and to W-.
PAPER = Rules()
# QVPR/VPRTempo 64154e5
REFERENCE = replace(
    PAPER,
    one_sign_per_synapse=True,
    normalise_by_last_neuron=True,
    constant_input=0.0,
    threshold_rule="decay",
    error_to_each_sign=True,
    query_rule="linear",
)
# QVPR/VPRTempo a3b07b2, without its two slips in the output layer (spikes thresholded twice, the second
# traverse never shown); and a connection whose weight was drawn as 0 (one in 740) exists here, there it does not
V1 = replace(
    PAPER,
    threshold_rule="amplitude",
    output_thresholds_learn=True,
    error_to_each_sign=True,
    shuffle=False,
    annealing_restarts=True,
    annealing_interval=10,
    silent_winner=True,
)
RULES: dict[RuleSet, Rules] = {"paper": PAPER, "reference": REFERENCE, "v1": V1}


def list_annealing(epochs: int, steps_per_epoch: int, rules: Rules) -> npt.NDArray[np.float64]:
    """Return the factor on the learning rates for each step, (epochs * steps_per_epoch,), Eq. 3.

    A step uses the factor that was set after the last earlier step whose number is a multiple of the interval.
    """
    total = epochs * steps_per_epoch
    span = steps_per_epoch if rules.annealing_restarts else total
    before = np.arange(total) - 1
    last_change = before % span // rules.annealing_interval * rules.annealing_interval
    factor = np.square(1 - last_change / span)
    factor[:1] = 1.0
    return factor

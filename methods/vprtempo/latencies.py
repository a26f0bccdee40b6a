"""VPRTempo in time: an amplitude is how early in a cycle a neuron spikes, and a query may stop early."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from vprbench.api import BadInput, LayerSpikes, Scores

from .method import VPRTempo
from .network import Network
from .query import Amplitudes, SpikingQuery, add_active
from .rules import Rules


class LatencyQuery(SpikingQuery):
    """The paper's query, each layer in a cycle of `steps` time steps: spikes of larger amplitude come earlier.

    A spike adds its synapse's weight times the amplitude that its step stands for. The thresholds of output neurons
    grow evenly to their full value at the end of the features' cycle.
    """

    def __init__(self, network: Network, rules: Rules, steps: int, lead: float | None) -> None:
        """Lay out the weights; a query ends when the best place is ahead by a share `lead` of its state, or last."""
        super().__init__(network, rules)
        self._steps, self._lead, self._clip = steps, lead or 1.0, np.float32(rules.clip)

    def scores(self, spikes: npt.NDArray[np.float32]) -> Scores:
        """Return the state of every place's output neuron where the query ends."""
        return self._run(spikes)[1]

    def layers(self, spikes: npt.NDArray[np.float32]) -> tuple[Amplitudes, Amplitudes]:
        """Return the feature spikes that came before the end, as amplitudes, and the output neurons at the end."""
        steps, scores = self._run(spikes)
        levels = self._levels(spikes)
        return levels * (self._clip / self._steps) * (levels > (self._steps - steps)[:, None]), scores

    def _run(self, spikes: npt.NDArray[np.float32]) -> tuple[npt.NDArray[np.int64], Scores]:
        """Return the step of the features' cycle at which each query ends, (n_queries,), and its scores there."""
        features = self._levels(spikes).reshape(len(spikes), len(self._columns), -1)
        added, scores = (
            np.empty(len(self._thresholds), np.float32),
            np.zeros((len(spikes), len(self._thresholds)), np.float32),
        )
        net, steps, going = scores.copy(), np.zeros(len(spikes), np.int64), np.ones(len(spikes), bool)
        for step in range(1, self._steps + 1):
            level = self._steps + 1 - step
            came = (features == level) * (self._clip * level / self._steps)
            for query, module in product(np.flatnonzero(going), range(len(self._columns))):
                own = slice(*self._ends[module : module + 2])
                add_active(self._columns[module], came[query, module], added[own])
                net[query, own] += added[own]
            above = net[going] - self._thresholds * np.float32(step / self._steps)
            scores[going], steps[going] = self._activate(torch.from_numpy(above)).numpy(), step
            second, first = np.partition(np.pad(scores, ((0, 0), (1, 0))), -2, axis=1)[:, -2:].T
            going &= first - second <= self._lead * first
            if not going.any():
                break
        return steps, scores

    def _levels(self, spikes: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        """Return how many steps before the end of their cycle the features spike, (n_queries, n_neurons); 0: never."""
        shown = torch.tensor(np.rint(spikes * np.float32(self._steps)) / np.float32(self._steps), device=self._device)
        return np.rint(self._fire_features(shown).cpu().numpy() * (self._steps / self._clip))


@dataclass
class VPRTempoLatencies(VPRTempo):
    """VPRTempo asked by spike times: input and features spike in a cycle of `steps` time steps each; trained as ever.

    `lead` ends a query once its best place is ahead of the next one by such a share of its state; None waits for the
    end of the features' cycle.
    """

    steps: int = 16
    lead: float | None = None

    @property
    def query_arguments(self) -> frozenset[str]:  # type: ignore[override]  # it depends on another argument
        """The arguments that may differ in a stored network."""
        return super().query_arguments | {"steps", "lead"}

    def choose_rules(self) -> Rules:
        """Return the rules; raises BadInput where spikes have no times."""
        rules = super().choose_rules()
        if not 4 <= self.steps <= 1000 or not (self.lead is None or 0 < self.lead < 1):
            raise BadInput(f"method.steps={self.steps}, method.lead={self.lead}: give 4 to 1000, and between 0 and 1")
        if rules.query_rule == "linear" or rules.calibrated_scores:
            raise BadInput("spike times need method.query_rule=spiking and method.calibrated_scores=false: set them")
        return rules

    @property
    def _spiking_query(self) -> Any:
        return partial(LatencyQuery, steps=self.steps, lead=self.lead)

    def spikes(self, codes: npt.NDArray[np.float32]) -> list[LayerSpikes]:
        """Return the spikes of each layer until the query ends; outputs spike in a cycle of their own, best first."""
        found, clip = super().spikes(codes), self.choose_rules().clip
        best = found[-1].values.max(1, keepdims=True, initial=1e-9)
        for cycle, most in enumerate((1, clip, best)):
            levels = np.rint(found[cycle].values * (self.steps / most)).astype(int)
            times = np.where(levels > 0, (cycle + 1) * self.steps + 1 - levels, 0)
            found[cycle] = replace(found[cycle], times=times)
        return found

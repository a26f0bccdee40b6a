"""Methods whose answer to a query grows with time steps, as spikes arrive."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy.typing as npt

from vprbench.api.arrays import Scores
from vprbench.api.method import LayerSpikes, Method


@dataclass(frozen=True)
class TimedSpikes(LayerSpikes):
    """Spikes of neurons that spike at most once; `times` (n_queries, n_neurons) in steps from 1, 0 for a silent one."""

    times: npt.NDArray[Any] = field(kw_only=True)


class StepwiseMethod(Method):
    """A method that can tell what it would answer at each time step."""

    @abstractmethod
    def answers(self, codes: npt.NDArray[Any]) -> Iterator[tuple[str, npt.NDArray[Any], Scores]]:
        """Yield answers, "step N" for each step N and others that stop early: name, steps (n_queries,) and scores."""

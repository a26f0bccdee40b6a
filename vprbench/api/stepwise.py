"""Methods whose answer to a query grows with time steps, as spikes arrive."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench.api.arrays import Scores
from vprbench.api.method import LayerSpikes, Method


@dataclass(frozen=True)
class TimedSpikes(LayerSpikes):
    """Spikes of neurons that spike once for a query, with the time step of each, 0 for a silent neuron."""

    times: npt.NDArray[np.int64] = field(kw_only=True)  # (n_queries, n_neurons)


class StepwiseMethod(Method):
    """A method that can be asked what it would answer at each time step."""

    @abstractmethod
    def answers(self, codes: npt.NDArray[Any]) -> Iterator[tuple[str, npt.NDArray[np.int64], Scores]]:
        """Yield answers, at each step and by rules that stop early: name, steps taken (n_queries,) and scores.

        A name is the same for all blocks of queries. Raises NotFittedError before `fit`.
        """

"""A trained network as plain layers, which any simulator can build."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy.typing as npt


@dataclass(frozen=True)
class Circuit:
    """Fully connected layers, the first of which reads a code; the last answers with the score of every place.

    The neurons of every layer hold `weights @ x + bias`, from 0 to `clip`; unlimited on both sides if it is None.
    """

    layers: tuple[tuple[npt.NDArray[Any], npt.NDArray[Any]], ...]  # float32 weights (n_out, n_in), bias (n_out,)
    clip: float | None = None


class HasCircuit(ABC):
    """A method whose trained network is a `Circuit`."""

    @abstractmethod
    def check_circuit(self) -> None:
        """Raise BadInput, before any training, if a network of these arguments is no circuit."""

    @abstractmethod
    def circuit(self) -> Circuit:
        """Return the trained network; raises NotFittedError before `fit`."""

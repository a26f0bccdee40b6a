"""What one measurement gives: a cell with its raw laps, or why it could not be measured."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

from vprbench.api.preprocess import Engine
from vprbench.errors import BadInput
from vprbench.speed.measure import Fit, Rates
from vprbench.speed.settings import SECTIONS, Settings

Counted = Literal["network", "matrix", "references"]
Measured = TypeVar("Measured")


@dataclass(frozen=True)
class Failed:
    """A cell that could not be measured, with the reason."""

    what: dict[str, str]
    reason: str


def attempt(what: dict[str, str], measured: Callable[[], Measured]) -> Measured | Failed:
    """Return what is measured, or why it could not be: one cell never ends the others."""
    try:
        return measured()
    except Exception as error:
        reason = str(error) if isinstance(error, BadInput) else f"{type(error).__name__}: {error}"
        logging.warning("%s failed: %s", " ".join(what.values()), reason)
        return Failed(what, reason.splitlines()[0])


@dataclass(frozen=True)
class TrainingCell:
    """One module trained by both engines, a round of each after the other."""

    rules: str
    places: int
    steps: int
    fits: dict[Engine, list[Fit]]
    floor_bytes: int  # excitation and inhibition of both layers
    floor_seconds: list[float]  # of plain in-place passes over as many


@dataclass(frozen=True)
class FitCell:
    """The fit that users ask for."""

    rules: str
    places: int
    epochs: int
    fit: Fit


@dataclass(frozen=True)
class ReadingCell:
    """PNG files read by bare loops and by this project, a turn of each after the other; all rates in frames a second.

    A bare loop decodes one file after the other; there is one, and then one in a thread of its own for each core.
    """

    height: int
    width: int
    frames: int
    files: int  # different ones
    cores: int
    one_loop: list[float]
    loops_at_once: list[float]
    ahead: list[float]  # of this project: read ahead, in order
    memory_before_bytes: int  # resident in the process
    peak_memory_bytes: int  # what was resident before included


@dataclass(frozen=True)
class PreprocessingCell:
    """Both engines on the same images, one call of each after the other."""

    height: int
    width: int
    images_per_call: int
    seconds: dict[Engine, list[float]]  # per call


@dataclass(frozen=True)
class QueryCell:
    """The rates of one method, and plain reads of as many bytes as its weights have."""

    method: str
    places: int
    rates: Rates
    counted: Counted
    floor_bytes: int
    floor_seconds: list[float]


@dataclass(frozen=True)
class SearchCell:
    """Matching by this project and by a library, a call of each after the other."""

    method: str
    library: str
    references: int
    dimensions: int
    images_per_call: int  # of ours in blocks where there are many
    seconds: list[float]  # per call
    library_seconds: list[float]
    memory_bytes: int  # that this project's calls took beyond what was resident, at most
    peak_memory_bytes: int  # of the process meanwhile


@dataclass(frozen=True)
class ScalingCell:
    """Fit and rates at one number of places."""

    rules: str
    places: int
    epochs: int
    fits: list[Fit]
    rates: Rates


@dataclass(frozen=True)
class ModuleCell:
    """One module of VPRSNN, trained on one core several times, and once more to see where the time goes."""

    method: str
    presentations: int
    neurons: int  # excitatory ones
    fits: list[Fit]
    input_spikes: int  # of one training
    excitatory_spikes: int
    parts: dict[str, list[float]]  # seconds, one element for each presentation that was looked at


@dataclass(frozen=True)
class AskingCell:
    """One image after the other by copies of a trained module, with and without delays in turn."""

    modules: int
    wanted: int  # more than `modules` where memory is short
    places: int
    threads: int
    seconds: dict[str, list[float]]  # per query, by method


@dataclass(frozen=True)
class Report:
    """Everything that one run of the benchmark measured."""

    settings: Settings
    environment: dict[str, Any]
    canary_seconds: dict[str, float]  # of a fixed computation, at the start and after each section
    load_average_after: list[float]
    cpu_pressure_avg10_after: float | None
    seconds: float
    training: list[TrainingCell | Failed]
    fits: list[FitCell | Failed]
    reading: list[ReadingCell | Failed]
    preprocessing: list[PreprocessingCell | Failed]
    queries: list[QueryCell | Failed]
    search: list[SearchCell | Failed]
    scaling: list[ScalingCell | Failed]
    vprsnn_training: list[ModuleCell | Failed]
    vprsnn_queries: list[AskingCell | Failed]

    @property
    def failures(self) -> list[Failed]:
        """The cells that could not be measured."""
        return [cell for name in SECTIONS for cell in getattr(self, name) if isinstance(cell, Failed)]

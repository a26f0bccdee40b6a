"""What the benchmark of speed is asked for, and what it gives: its settings, and a cell for each measurement."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from vprbench.api.preprocess import Engine
from vprbench.errors import BadInput
from vprbench.run.stopwatch import Protocol
from vprbench.speed.measure import Fit, Rates

Counted = Literal["network", "matrix", "references"]
Part = Literal["input", "normalising", "arrivals", "without learning", "with learning"]

SECTIONS = (
    "training",
    "fits",
    "reading",
    "preprocessing",
    "queries",
    "search",
    "scaling",
    "vprsnn_training",
    "vprsnn_queries",
)
RULES = ("paper", "reference")
VPRSNN = ("vprsnn", "vprsnn_fast")  # the methods, with and without delays
ENGINES: tuple[Engine, ...] = ("readable", "fused")
FRAME = (32, 64)  # height and width of the frames that methods are shown
TRAVERSES = 2
LOOKED = 7  # every so many presentations to VPRSNN; coprime to the images of an epoch, so that each has its turn

PATCH = 7  # pixels


@dataclass(frozen=True)
class Settings:
    """What to measure, and how long; raises BadInput where nothing would be."""

    sizes: list[int] = field(default_factory=lambda: [100, 300, 1000, 3300, 10_000, 27_000])  # places, for the growth
    places: int = 3300  # of the fit and the queries that users ask for
    max_module: int = 1100  # places
    epochs: int = 4
    scaling_epochs: int = 4
    members: int = 5  # of the ensemble
    pixels: int = 28  # height and width of what a network reads
    frame: list[int] = field(default_factory=lambda: [360, 640])  # height and width of a frame to read or preprocess
    reading_frames: int = 27_592  # files that are read: all of Nordland
    reading_files: int = 300  # different ones among them
    batch: int = 128  # images preprocessed together
    batch_sizes: list[int] = field(default_factory=lambda: [1, 8, 32, 128])  # of offline queries
    sample: int = 128  # different queries
    search_references: int = 3300  # descriptors that are searched; 27592 are all of Nordland, for which 2 GB are needed
    search_queries: int = 3300  # of a whole traverse
    search_dimensions: int = 4096
    vprsnn_places: int = 25  # of a module of VPRSNN
    vprsnn_epochs: int = 30
    vprsnn_neurons: int = 400  # excitatory ones of a module
    vprsnn_rounds: int = 2  # whole trainings of a module, each of many seconds
    vprsnn_modules: list[int] = field(default_factory=lambda: [18, 111])  # that are asked together
    sections: list[str] = field(default_factory=lambda: list(SECTIONS))
    rounds: int = 3
    minimum_seconds: float = 1.0  # of each rate
    minimum_queries: int = 64
    quick: bool = False  # tiny sizes: everything runs, no number means anything
    seed: int = 0
    device: str = "cpu"
    threads: int | None = None  # None: all cores this process may use
    results: str = "results"

    def __post_init__(self) -> None:
        """Check that something will be measured."""
        counts = ("places", "max_module", "epochs", "scaling_epochs", "members", "pixels", "batch", "rounds")
        searched = ("search_references", "search_queries", "search_dimensions")
        spiking = ("vprsnn_places", "vprsnn_epochs", "vprsnn_neurons", "vprsnn_rounds")
        for name in (*counts, *searched, *spiking, "reading_frames", "reading_files"):
            if getattr(self, name) < 1:
                raise BadInput(f"{name}={getattr(self, name)}: give at least 1")
        if not self.sections or not set(self.sections) <= set(SECTIONS):
            raise BadInput(f"sections={self.sections}: give some of {', '.join(SECTIONS)}")
        if not self.sizes or min(self.sizes) < 1:
            raise BadInput(f"sizes={self.sizes}: give numbers of places, as in sizes=[100,300,1000]")
        if not self.vprsnn_modules or min(self.vprsnn_modules) < 1:
            raise BadInput(
                f"vprsnn_modules={self.vprsnn_modules}: give numbers of modules, as in vprsnn_modules=[18,111]"
            )
        if len(self.frame) != 2 or min(self.frame) < 1:
            raise BadInput(f"frame={self.frame}: give height and width in pixels, as in frame=[360,640]")
        if not self.minimum_seconds < math.inf:
            raise BadInput(f"minimum_seconds={self.minimum_seconds}: give seconds")
        self.protocol()

    def protocol(self) -> Protocol:
        """Return how queries are timed."""
        return Protocol(
            minimum_seconds=self.minimum_seconds,
            maximum_seconds=max(120.0, self.minimum_seconds),
            minimum_queries=self.minimum_queries,
            sample=self.sample,
            batch_sizes=self.batch_sizes,
        )

    def vprtempo(self, rules: str, n_places: int) -> dict[str, Any]:
        """Return the arguments of a VPRTempo network of so many places."""
        seen = {"height": self.pixels, "width": self.pixels, "patch": PATCH}
        return {"rules": rules, "max_module": min(n_places, self.max_module), **seen}

    def vprsnn(self) -> dict[str, Any]:
        """Return the arguments of VPRSNN, which computes on the CPU by its compiled loops."""
        seen = {"height": self.pixels, "width": self.pixels, "patch": PATCH, "engine": "compiled"}
        learnt = {"places_per_module": self.vprsnn_places, "epochs": self.vprsnn_epochs}
        return {**learnt, "n_excitatory": self.vprsnn_neurons, **seen}


QUICK: Mapping[str, Any] = {
    "sizes": [10, 20, 40],
    "places": 20,
    "max_module": 10,
    "epochs": 2,
    "scaling_epochs": 1,
    "members": 2,
    "pixels": 12,
    "frame": [24, 40],
    "reading_frames": 260,
    "reading_files": 5,
    "batch": 4,
    "batch_sizes": [1, 4],
    "sample": 4,
    "search_references": 300,
    "search_queries": 300,
    "search_dimensions": 16,
    "vprsnn_places": 2,
    "vprsnn_epochs": 2,
    "vprsnn_neurons": 16,
    "vprsnn_modules": [1, 3],
    "rounds": 2,
    "minimum_seconds": 0.0,
    "minimum_queries": 4,
}


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
    parts: dict[Part, list[float]]  # seconds, one element for each presentation that was looked at


@dataclass(frozen=True)
class AskingCell:
    """One image after the other by copies of a trained module, with and without delays in turn."""

    modules: int
    wanted: int  # more than `modules` where memory is short
    places: int
    threads: int
    seconds: dict[str, list[float]]  # per query, by method


@dataclass(frozen=True)
class Failed:
    """A cell that could not be measured, with the reason."""

    what: dict[str, str]
    reason: str


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

"""What the benchmark of speed is asked for: its settings, and what each of its measurements has at hand."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from vprbench.api.method import Method
from vprbench.api.preprocess import Engine
from vprbench.errors import BadInput
from vprbench.run.stopwatch import Protocol
from vprbench.speed.measure import Make
from vprbench.speed.route import Route

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
class Bench:
    """What all measurements of one run share."""

    settings: Settings
    make: Make
    route: Route
    networks: dict[str, Method] = field(default_factory=dict)  # trained VPRTempo networks by their rules
    modules: dict[str, Method] = field(default_factory=dict)  # trained modules of VPRSNN by their methods

    def vprtempo(self, rules: str, n_places: int, **arguments: Any) -> Method:
        """Return a VPRTempo network of so many places, not yet fitted."""
        return self.make("vprtempo", self.settings.device, **{**self.settings.vprtempo(rules, n_places), **arguments})

    def vprsnn(self, method: str, **arguments: Any) -> Method:
        """Return a module of VPRSNN, not yet fitted; it computes on the CPU by its compiled loops."""
        return self.make(method, "cpu", **{**self.settings.vprsnn(), **arguments})

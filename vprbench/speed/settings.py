"""What the commands of speed are asked for: options with their usual values, those of quick=true and their limits."""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import dataclass, field, fields
from typing import Any

from vprbench.api.method import Method
from vprbench.api.preprocess import Engine
from vprbench.errors import BadInput
from vprbench.runs.stopwatch import Protocol
from vprbench.speed.measure import Make
from vprbench.speed.route import Route

SECTIONS = (
    "training",
    "fits",
    "reading",
    "files",
    "events",
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


def option(usual: Any, quick: Any = None, *, least: int | None = 1, among: tuple[str, ...] | None = None) -> Any:
    """Return an option: its value, that of quick=true, the least number in it or the words that it may hold."""
    return field(default_factory=lambda: deepcopy(usual), metadata={"quick": quick, "least": least, "among": among})


def quick(kind: type[Options]) -> dict[str, Any]:
    """Return the values of quick=true by the names of the options that it changes."""
    found = {each.name: each.metadata.get("quick") for each in fields(kind)}
    return {name: value for name, value in found.items() if value is not None}


@dataclass(frozen=True, kw_only=True)
class Options:
    """What all commands of speed are asked for; raises BadInput for an option under which nothing is measured."""

    minimum_seconds: float = option(1.0, 0.0, least=None)  # of each rate
    quick: bool = False  # tiny sizes: everything runs, no number means anything
    seed: int = 0
    threads: int | None = None  # None: all cores this process may use
    results: str = "results"

    def __post_init__(self) -> None:
        """Check each option by its limits, or as height and width if it is a frame."""
        if not 0 <= self.minimum_seconds < math.inf:
            raise BadInput(f"minimum_seconds={self.minimum_seconds}: give seconds")
        for each in fields(self):
            given, least, among = (getattr(self, each.name), each.metadata.get("least"), each.metadata.get("among"))
            if among is not None and not (given and set(given) <= set(among)):
                raise BadInput(f"{each.name}={given}: give some of {', '.join(among)}")
            if least is None or among is not None:
                continue
            if not isinstance(given, list):
                if given < least:
                    raise BadInput(f"{each.name}={given}: give at least {least}")
            elif each.name.startswith("frame"):
                frames = given if each.name == "frames" else [given]
                if not frames or any(len(frame) != 2 or min(frame) < least for frame in frames):
                    raise BadInput(f"{each.name}={given}: give height and width in pixels, as in {_usual(each)}")
            elif not given or min(given) < least:
                raise BadInput(f"{each.name}={given}: give numbers of at least {least}, as in {_usual(each)}")


def _usual(option: Any) -> str:
    return f"{option.name}={option.default_factory()}".replace(" ", "")


@dataclass(frozen=True, kw_only=True)
class NetworkOptions(Options):
    """What is asked of VPRTempo's networks too."""

    places: int = option(3300, 20)  # of the fit and the queries that users ask for
    max_module: int = option(1100, 10)  # places
    epochs: int = option(4, 2)
    pixels: int = option(28, 12)  # height and width of what a network reads
    batch_sizes: list[int] = option([1, 8, 32, 128], [1, 4])  # of offline queries
    device: str = "cpu"

    def seen(self) -> dict[str, int]:
        """Return the arguments of a method that say what it reads of a frame."""
        return {"height": self.pixels, "width": self.pixels, "patch": PATCH}

    def vprtempo(self, rules: str, n_places: int) -> dict[str, Any]:
        """Return the arguments of a VPRTempo network of so many places."""
        return {"rules": rules, "max_module": min(n_places, self.max_module), "epochs": self.epochs, **self.seen()}


@dataclass(frozen=True, kw_only=True)
class Settings(NetworkOptions):
    """What to measure, and how long; raises BadInput if nothing would be."""

    sizes: list[int] = option([100, 300, 1000, 3300, 10_000, 27_000], [10, 20, 40])  # places, for the growth
    scaling_epochs: int = option(4, 1)
    members: int = option(5, 2)  # of the ensemble
    frame: list[int] = option([360, 640], [24, 40])  # height and width of a frame to read or preprocess
    reading_frames: int = option(27_592, 260)  # files that are read: all of Nordland
    reading_files: int = option(300, 5)  # different ones among them
    files: list[int] = option([10_000, 100_000], [40])  # of datasets whose names, positions and hashes are read
    events: list[int] = option([100_000_000], [20_000])  # of an hour of a DAVIS346; 1000000000 need 13 GB of disk
    batch: int = option(128, 4)  # images preprocessed together
    sample: int = option(128, 4)  # different queries
    search_references: int = option(3300, 300)  # descriptors that are searched; for 27592, all of Nordland, 2 GB
    search_queries: int = option(3300, 300)  # of a whole traverse
    search_dimensions: int = option(4096, 16)
    vprsnn_places: int = option(25, 2)  # of a module of VPRSNN
    vprsnn_epochs: int = option(30, 2)
    vprsnn_neurons: int = option(400, 16)  # excitatory ones of a module
    vprsnn_rounds: int = option(2)  # whole trainings of a module, each of many seconds
    vprsnn_modules: list[int] = option([18, 111], [1, 3])  # that are asked together
    sections: list[str] = option(list(SECTIONS), among=SECTIONS)
    rounds: int = option(3, 2)
    minimum_queries: int = option(64, 4)

    def __post_init__(self) -> None:
        """Check that something will be measured."""
        super().__post_init__()
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


QUICK = quick(Settings)


@dataclass(frozen=True)
class Bench:
    """What all measurements of one run share."""

    settings: Settings
    make: Make
    route: Route
    networks: dict[str, Method] = field(default_factory=dict)  # trained VPRTempo networks by their rules
    modules: dict[str, Method] = field(default_factory=dict)  # trained modules of VPRSNN by their methods

    def vprtempo(self, rules: str, n_places: int, name: str = "vprtempo", **arguments: Any) -> Method:
        """Return a VPRTempo network of so many places, not yet fitted."""
        return self.make(name, self.settings.device, **{**self.settings.vprtempo(rules, n_places), **arguments})

    def vprsnn(self, method: str, **arguments: Any) -> Method:
        """Return a module of VPRSNN, not yet fitted; it computes on the CPU."""
        asked = self.settings
        learnt = {"places_per_module": asked.vprsnn_places, "epochs": asked.vprsnn_epochs}
        own = {**learnt, "n_excitatory": asked.vprsnn_neurons, **asked.seen()}
        return self.make(method, "cpu", **{**own, **arguments})

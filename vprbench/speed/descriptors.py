"""The benchmark of descriptors: how fast each method describes frames of three sizes, and how fast it searches."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.runs import machine
from vprbench.speed.measure import Make, laps_of, median
from vprbench.speed.report import Report, hertz, measured, publish, size
from vprbench.speed.route import Route, unit_vectors
from vprbench.speed.settings import Options, option, quick

PRECISIONS = ("float32", "float16", "bfloat16")

_FEWEST = 3  # calls that a median is taken of


def own_methods() -> list[str]:
    """Return the names of this project's methods but spiking ones, whose training and queries `bench` measures."""
    own = [name for name, entry in registry.entries("method").items() if entry.provider == "vprbench"]
    return [name for name in own if not name.startswith(("vprtempo", "vprsnn"))]


def devices_here() -> list[str]:
    """Return the CPU, and the GPU if PyTorch sees one."""
    import torch

    return ["cpu", "cuda"] if torch.cuda.is_available() else ["cpu"]


@dataclass(frozen=True, kw_only=True)
class Settings(Options):
    """What to describe, and how long; raises BadInput if nothing would be."""

    methods: list[str] = field(default_factory=own_methods, metadata={"quick": ["hog", "pca"]})
    frames: list[list[int]] = option([[224, 224], [240, 320], [480, 640]], [[32, 48]])  # height, width
    places: int = option(3300, 20)  # of the search; one image each
    fitted_places: int = option(40, 20)  # for methods that learn from their references, whose fit would take too long
    batch: int = option(8, 2)  # frames described, and queries matched, together
    devices: list[str] = field(default_factory=devices_here)
    precisions: list[str] = option(list(PRECISIONS), among=PRECISIONS)  # of networks on a GPU; float32 on a CPU

    def __post_init__(self) -> None:
        """Check that something will be measured."""
        super().__post_init__()
        if not self.devices:
            raise BadInput("devices=[]: give cpu, cuda or both, as in devices=[cpu,cuda]")


QUICK = quick(Settings)


@dataclass(frozen=True)
class Case:
    """A method, the size of the frames that it is shown, and on what and in which numbers it computes."""

    method: str
    frame: tuple[int, int]  # height, width
    device: str
    precision: str
    only_cpu: bool  # nothing else is measured in this run

    def columns(self) -> dict[str, str]:
        """Return the columns by which people find the case."""
        way = self.device if self.device == "cpu" else f"{self.device}, {self.precision}"
        return {"method": self.method, "frame": size(*self.frame), **({} if self.only_cpu else {"on": way})}


@dataclass(frozen=True)
class DescriptorCell:
    """The rates of one method at one size of frame."""

    case: Case
    seen: tuple[int, int] | None  # what a network makes of it; None: the method's own affair
    n_dimensions: int  # numbers of one image's code
    places: int
    batch: int
    seconds: dict[str, list[float]]  # of encoding and matching one image and a batch, a call

    def row(self) -> dict[str, str]:
        """Return the rates of median calls."""
        seconds, together = {name: median(laps) for name, laps in self.seconds.items()}, f"{self.batch} together"
        return {
            **self.case.columns(),
            "seen as": "" if self.seen is None else size(*self.seen),
            "numbers": f"{self.n_dimensions:,}",
            "encode ms": f"{1000 * seconds['encode one']:,.3g}",
            "encode Hz": hertz(1 / seconds["encode one"]),
            f"encode Hz, {together}": hertz(self.batch / seconds["encode batch"]),
            "places": f"{self.places:,}",
            "match Hz": hertz(1 / seconds["match one"]),
            f"match Hz, {together}": hertz(self.batch / seconds["match batch"]),
        }


def measure(settings: Settings, make: Make) -> Report:
    """Measure each method at each size; what cannot be measured becomes a cell that says why."""
    surroundings = machine.capture(settings.devices[-1], settings.threads or len(machine.cores()))
    planned = ((case.columns(), partial(_cell, settings, make, case)) for case in cases(settings, make))
    return Report(settings, surroundings, {"descriptors": list(measured("descriptors", planned))})


def cases(settings: Settings, make: Make) -> Iterator[Case]:
    """Yield what is measured: all on a CPU, on a GPU what takes a device, networks there in all precisions."""
    from vprbench.api.neural import NeuralDescriptor  # PyTorch is slow to import

    for name in settings.methods:
        for device in settings.devices:
            method = make(name, device)
            precisions = ["float32"]
            if device != "cpu":
                neural = isinstance(method, NeuralDescriptor)
                precisions = settings.precisions if neural else precisions * hasattr(method, "device")
            for precision, (height, width) in product(precisions, settings.frames):
                yield Case(name, (height, width), device, precision, settings.devices == ["cpu"])


def _cell(settings: Settings, make: Make, case: Case) -> DescriptorCell:
    route = Route.drawn(max(settings.batch, settings.fitted_places), *case.frame, settings.seed)
    method, places, seen = _fitted(settings, make, case, route)
    images, _ = route.queries(settings.batch, settings.batch)
    codes = method.encode(images)
    calls: dict[str, Callable[[], object]] = {
        "encode one": partial(method.encode, images[:1]),
        "encode batch": partial(method.encode, images),
        "match one": partial(method.match, codes[:1]),
        "match batch": partial(method.match, codes),
    }
    seconds = {}
    for name, call in calls.items():
        call()
        seconds[name] = laps_of(call, _FEWEST, settings.minimum_seconds, device=case.device)
    return DescriptorCell(case, seen, codes[0].size, places, settings.batch, seconds)


def _fitted(settings: Settings, make: Make, case: Case, route: Route) -> tuple[Method, int, tuple[int, int] | None]:
    """Return a method with a map, the number of its places, and the size at which a network sees the frames."""
    from vprbench.api.neural import NeuralDescriptor  # PyTorch is slow to import

    method, seen = make(case.method, case.device), None
    if isinstance(method, NeuralDescriptor):
        own = {} if method.fixed_size else {"height": None, "width": None}  # of the frame
        method = make(case.method, case.device, precision=case.precision, **own)
        assert isinstance(method, NeuralDescriptor)
        method.use(randomised(method.blank(), settings.seed))
        seen = method.target(*case.frame)
        if method.keeps_descriptors():
            n_dimensions = method.encode(route.references(1, 1)[0]).shape[1]
            descriptors = unit_vectors(settings.places, n_dimensions, np.random.default_rng(settings.seed))
            method.fit_descriptors(descriptors, np.arange(settings.places))
            return method, settings.places, seen
    # what it learns with its map is learnt from a few images
    return method.fit(*route.references(settings.fitted_places, 1)), settings.fitted_places, seen


def randomised(network: Any, seed: int) -> Any:
    """Fill a network with random numbers under which its activations stay finite; returns it."""
    import torch

    generator = torch.Generator().manual_seed(seed)
    network = network.to_empty(device="cpu")
    with torch.no_grad():
        for name, values in [*network.named_parameters(), *network.named_buffers()]:
            if not values.is_floating_point():
                values.zero_()
            elif values.ndim > 1:  # weights: the variance of what goes in is kept
                values.normal_(0, math.sqrt(2 / values[0].numel()), generator=generator)
            else:
                values.fill_(0.0 if name.endswith(("bias", "running_mean")) else 1.0)
    return network


def write(report: Report, results: Path) -> None:
    """Print the report as Markdown, and leave it in descriptors.md of the folder `results`."""
    publish(results, {"descriptors.md": to_text(report)})


def to_text(report: Report) -> str:
    """Return a report as Markdown."""
    return report.told("descriptors.md.j2", FEWEST=_FEWEST)

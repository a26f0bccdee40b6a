"""The benchmark of descriptors: how fast each method describes frames of three sizes, and how fast it searches."""

from __future__ import annotations

import gc
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vprbench import progress
from vprbench.api.method import Method
from vprbench.errors import BadInput
from vprbench.plugins import registry
from vprbench.run import machine
from vprbench.run.document import document
from vprbench.run.stopwatch import Protocol, Stopwatch, synchroniser
from vprbench.speed.cells import Failed, attempt
from vprbench.speed.format import hertz, publish, size, table
from vprbench.speed.measure import Make, median
from vprbench.speed.route import Route

PRECISIONS = ("float32", "float16", "bfloat16")

_FEWEST = 3  # calls that a median is taken of


def own_methods() -> list[str]:
    """Return the names of this project's methods but spiking ones, whose training and queries `bench` measures."""
    own = [name for name, entry in registry.entries("method").items() if entry.provider == "vprbench"]
    return [name for name in own if not name.startswith(("vprtempo", "vprsnn"))]


def devices_here() -> list[str]:
    """Return the CPU, and the GPU where PyTorch sees one."""
    import torch

    return ["cpu", "cuda"] if torch.cuda.is_available() else ["cpu"]


@dataclass(frozen=True)
class Settings:
    """What to describe, and how long; raises BadInput where nothing would be."""

    methods: list[str] = field(default_factory=own_methods)
    frames: list[list[int]] = field(default_factory=lambda: [[224, 224], [240, 320], [480, 640]])  # height, width
    places: int = 3300  # of the search; one image each
    fitted_places: int = 40  # for methods that learn from their references, whose fit would take too long
    batch: int = 8  # frames described, and queries matched, together
    minimum_seconds: float = 1.0  # of each rate, and at least three calls
    devices: list[str] = field(default_factory=devices_here)
    precisions: list[str] = field(default_factory=lambda: list(PRECISIONS))  # of networks on a GPU; float32 on a CPU
    quick: bool = False  # tiny sizes: everything runs, no number means anything
    seed: int = 0
    threads: int | None = None  # None: all cores this process may use
    results: str = "results"

    def __post_init__(self) -> None:
        """Check that something will be measured."""
        for name in ("places", "fitted_places", "batch"):
            if getattr(self, name) < 1:
                raise BadInput(f"{name}={getattr(self, name)}: give at least 1")
        if not self.frames or any(len(frame) != 2 or min(frame) < 1 for frame in self.frames):
            raise BadInput(f"frames={self.frames}: give heights and widths in pixels, as in frames=[[480,640]]")
        if not 0 <= self.minimum_seconds < math.inf:
            raise BadInput(f"minimum_seconds={self.minimum_seconds}: give seconds")
        if not self.precisions or not set(self.precisions) <= set(PRECISIONS):
            raise BadInput(f"precisions={self.precisions}: give some of {', '.join(PRECISIONS)}")
        if not self.devices:
            raise BadInput("devices=[]: give cpu, cuda or both, as in devices=[cpu,cuda]")


QUICK: Mapping[str, Any] = {
    "methods": ["hog", "pca"],
    "frames": [[32, 48]],
    "places": 20,
    "fitted_places": 20,
    "batch": 2,
    "minimum_seconds": 0.0,
}


@dataclass(frozen=True)
class Way:
    """On what and in which numbers a method computes."""

    device: str
    precision: str

    def __str__(self) -> str:
        """Return what a person reads."""
        return self.device if self.device == "cpu" else f"{self.device}, {self.precision}"


@dataclass(frozen=True)
class Cell:
    """The rates of one method at one size of frame."""

    method: str
    frame: tuple[int, int]  # height, width
    seen: tuple[int, int] | None  # what a network makes of it; None: the method's own affair
    way: Way
    n_dimensions: int  # numbers of one image's code
    places: int
    encode_one: list[float]  # seconds of a call
    encode_batch: list[float]
    match_one: list[float]
    match_batch: list[float]


@dataclass(frozen=True)
class Report:
    """Everything that one run of the benchmark measured."""

    settings: Settings
    environment: dict[str, Any]
    cells: list[Cell | Failed]

    @property
    def failures(self) -> list[Failed]:
        """What could not be measured."""
        return [cell for cell in self.cells if isinstance(cell, Failed)]


def measure(settings: Settings, make: Make) -> Report:
    """Measure each method at each size; what cannot be measured becomes a cell that says why."""
    surroundings = machine.capture(settings.devices[-1], settings.threads or len(machine.cores()))
    return Report(settings, surroundings, list(_cells(settings, make)))


def _cells(settings: Settings, make: Make) -> Iterator[Cell | Failed]:
    for name in settings.methods:
        for way in _ways(settings, make, name):
            for height, width in settings.frames:
                gc.collect()
                progress.report(f"{name} at {size(height, width)}, {way}", 0.0)
                what = _named(settings, name, (height, width), way)
                yield attempt(what, partial(_cell, settings, make, name, (height, width), way))


def _named(settings: Settings, name: str, frame: tuple[int, int], way: Way) -> dict[str, str]:
    """Return the columns by which a cell is found."""
    on = {} if settings.devices == ["cpu"] else {"on": str(way)}
    return {"method": name, "frame": size(*frame), **on}


def _ways(settings: Settings, make: Make, name: str) -> list[Way]:
    """Return how a method can compute here: any on a CPU, what takes a device on a GPU, networks in all precisions."""
    from vprbench.api.neural import NeuralDescriptor  # PyTorch is slow to import

    ways = []
    for device in settings.devices:
        method = make(name, device)
        precisions = settings.precisions if isinstance(method, NeuralDescriptor) else ["float32"]
        if device == "cpu":
            ways.append(Way(device, "float32"))
        elif hasattr(method, "device"):
            ways += [Way(device, precision) for precision in precisions]
    return ways


def _cell(settings: Settings, make: Make, name: str, frame: tuple[int, int], way: Way) -> Cell:
    route = Route.drawn(max(settings.batch, settings.fitted_places), *frame, settings.seed)
    method, places, seen = _fitted(settings, make, name, frame, way, route)
    images, _ = route.queries(settings.batch, settings.batch)
    single = images[:1]
    codes = method.encode(images)
    timed = [
        (lambda: method.encode(single)),
        (lambda: method.encode(images)),
        (lambda: method.match(codes[:1])),
        (lambda: method.match(codes)),
    ]
    laps = [_laps(call, settings, way.device) for call in timed]
    return Cell(name, frame, seen, way, codes[0].size, places, *laps)


def _fitted(
    settings: Settings, make: Make, name: str, frame: tuple[int, int], way: Way, route: Route
) -> tuple[Method, int, tuple[int, int] | None]:
    """Return a method with a map, the number of its places, and the size at which a network sees the frames."""
    from vprbench.api.neural import NeuralDescriptor  # PyTorch is slow to import

    method = make(name, way.device)
    if not isinstance(method, NeuralDescriptor):
        references, places = route.references(settings.fitted_places, 1)
        return method.fit(references, places), settings.fitted_places, None
    if not method.fixed_size:
        size = [max(1, round(side / method.multiple)) * method.multiple for side in frame]
        method = make(name, way.device, height=size[0], width=size[1], precision=way.precision)
    else:
        method = make(name, way.device, precision=way.precision)
    assert isinstance(method, NeuralDescriptor)
    method.use(randomised(method.blank(), settings.seed))
    seen = method.target(*frame)
    if not method.keeps_descriptors():  # what it learns with its map is learnt from a few images
        references, places = route.references(settings.fitted_places, 1)
        return method.fit(references, places), settings.fitted_places, seen
    n_dimensions = method.encode(route.references(1, 1)[0]).shape[1]
    method.fit_descriptors(_unit(settings.places, n_dimensions, settings.seed), np.arange(settings.places))
    return method, settings.places, seen


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


def _unit(n: int, n_dimensions: int, seed: int) -> npt.NDArray[np.float32]:
    generator = np.random.default_rng(seed)
    vectors = generator.standard_normal((n, n_dimensions), np.float32)
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors


def _laps(call: Callable[[], object], settings: Settings, device: str) -> list[float]:
    """Return the seconds of calls, after one that is not counted."""
    watch = Stopwatch(Protocol(), synchronise=synchroniser(device))
    call()
    laps: list[float] = []
    while len(laps) < _FEWEST or sum(laps) < settings.minimum_seconds:
        with watch.lap() as lap:
            call()
        laps += lap
    return laps


def write(report: Report, results: Path) -> None:
    """Print the report as Markdown, and leave it in descriptors.md of the folder `results`."""
    publish(results, descriptors_md=text_of(report))


def text_of(report: Report) -> str:
    """Return a report as Markdown."""
    return document(
        Path(__file__).with_name("descriptors.md.j2"),
        settings=report.settings,
        rows=table(report.cells, partial(_row, report.settings)),
        machine=machine.machine_lines(report.environment),
        FEWEST=_FEWEST,
    )


def _row(settings: Settings, cell: Cell) -> dict[str, str]:
    return {
        **_named(settings, cell.method, cell.frame, cell.way),
        "seen as": "" if cell.seen is None else size(*cell.seen),
        "numbers": f"{cell.n_dimensions:,}",
        "encode ms": f"{1000 * median(cell.encode_one):,.3g}",
        "encode Hz": hertz(1 / median(cell.encode_one)),
        f"encode Hz, {settings.batch} together": hertz(settings.batch / median(cell.encode_batch)),
        "places": f"{cell.places:,}",
        "match Hz": hertz(1 / median(cell.match_one)),
        f"match Hz, {settings.batch} together": hertz(settings.batch / median(cell.match_batch)),
    }

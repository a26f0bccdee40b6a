"""The benchmark of frames: reading them from files, preprocessing a traverse once and again, and both engines."""

from __future__ import annotations

import os
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, product
from multiprocessing import get_context
from pathlib import Path
from typing import ParamSpec, TypeVar

import cv2
import numpy as np
import psutil
from PIL import Image as PillowImage

from vprbench import progress
from vprbench.api.arrays import Image
from vprbench.api.decoding import read_image
from vprbench.api.images import Images
from vprbench.api.oriented import OrientedEdges
from vprbench.api.preprocess import Engine, PatchNormalisation
from vprbench.runs import machine
from vprbench.speed.measure import interleaved, median, rounded
from vprbench.speed.report import Planned, figures, megabytes, ratio, size
from vprbench.speed.route import Route
from vprbench.speed.settings import ENGINES, FRAME, PATCH, Bench, Settings

Asked = ParamSpec("Asked")
Answer = TypeVar("Answer")
Encoder = PatchNormalisation | OrientedEdges

_TURNS = 8  # of each way of reading
_LEVELS = ((64, 90.0), (16, 40.0), (4, 15.0))  # pixels of a cell, grey levels to either side
_NOISE = 3.0  # grey levels


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

    def row(self) -> dict[str, str]:
        """Return the median rates, memory and shares, which are medians over the turns."""
        turns = list(zip(self.one_loop, self.loops_at_once, self.ahead, strict=True))
        return {
            "frame": size(self.height, self.width),
            "frames": f"{self.frames:,}",
            "cores": str(self.cores),
            "one bare loop: Hz": figures(median(self.one_loop)),
            "loops at once: Hz": figures(median(self.loops_at_once)),
            "ours: Hz": figures(median(self.ahead)),
            "ours / (cores x one loop)": ratio(median(ours / one for one, _, ours in turns), self.cores),
            "ours / loops at once": ratio(median(ours / several for _, several, ours in turns), 1),
            "resident before MB": megabytes(self.memory_before_bytes),
            "peak MB": megabytes(self.peak_memory_bytes),
        }


@dataclass(frozen=True)
class PreprocessingCell:
    """Both engines on the same images, one call of each after the other."""

    into: str  # patches or oriented edges
    height: int
    width: int
    images_per_call: int
    seconds: dict[str, list[float]]  # per call, by engine

    def row(self) -> dict[str, str]:
        """Return the median times of an image by each engine."""
        each = {engine: median(seconds) / self.images_per_call for engine, seconds in self.seconds.items()}
        return {
            "frame": size(self.height, self.width),
            "into": self.into,
            "images a call": str(self.images_per_call),
            **{f"{engine}: us an image": figures(1e6 * seconds) for engine, seconds in each.items()},
            "readable / fused": ratio(each["readable"], each["fused"]),
        }


def reading(bench: Bench) -> Iterator[Planned]:
    """Read files."""
    yield {"frame": size(*bench.settings.frame)}, partial(_reading_cell, bench.settings)


def _reading_cell(settings: Settings) -> ReadingCell:
    with tempfile.TemporaryDirectory(prefix="vprbench-") as folder:
        return in_own_process(reading_cell, settings, frame_files(settings, Path(folder)))


def preprocessing(bench: Bench) -> Iterator[Planned]:
    """Preprocess images in memory by both engines."""
    for height, width in (FRAME, tuple(bench.settings.frame)):
        for into, images_per_call in product(("patches", "oriented edges"), (1, bench.settings.batch)):
            what = {"frame": size(height, width), "into": into, "images a call": str(images_per_call)}
            yield what, partial(_preprocessing_cell, bench.settings, into, height, width, images_per_call)


def _preprocessing_cell(
    settings: Settings, into: str, height: int, width: int, images_per_call: int
) -> PreprocessingCell:
    images, _ = Route.drawn(settings.batch, height, width, settings.seed).references(settings.batch, 1)
    parts = list(images.blocks(images_per_call))
    patches = partial(PatchNormalisation, "C", settings.pixels, settings.pixels, PATCH)
    encoder: Callable[..., Encoder] = patches if into == "patches" else OrientedEdges
    engines = {engine: encoder(engine=engine) for engine in ENGINES}
    for encode in engines.values():
        encode(parts[0])

    def by(engine: Engine) -> Callable[[int], object]:
        return lambda turn: engines[engine](parts[turn % len(parts)])

    laps = interleaved({engine: by(engine) for engine in ENGINES}, settings.rounds, settings.minimum_seconds)
    return PreprocessingCell(into, height, width, images_per_call, laps)


def in_own_process(measure: Callable[Asked, Answer], *arguments: Asked.args, **options: Asked.kwargs) -> Answer:
    """Return the answer of `measure` in a process that has done nothing else."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(measure, *arguments, **options).result()


def frame_files(settings: Settings, folder: Path) -> list[Path]:
    """Write the frames to read: as many different frames as were asked for, then hard links to these files."""
    height, width = settings.frame
    paths = [folder / f"{number:06}.png" for number in range(settings.reading_frames)]
    for number, path in enumerate(paths):
        if number < settings.reading_files:
            progress.report("reading, drawing frames", number / settings.reading_files)
            PillowImage.fromarray(drawn(height, width, [settings.seed, number])).save(path)
        else:
            os.link(paths[number % settings.reading_files], path)
    return paths


def drawn(height: int, width: int, seed: Sequence[int]) -> Image:
    """Return a frame that costs a decoder what a photograph does: large and small shapes, and a camera's noise."""
    generator = np.random.default_rng(seed)
    frame = 128 + generator.normal(0, _NOISE, (height, width, 1)).astype(np.float32)
    for cell, levels in _LEVELS:
        coarse = generator.uniform(-levels, levels, (height // cell + 2, width // cell + 2, 3)).astype(np.float32)
        frame = frame + cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return np.clip(frame, 0, 255).astype(np.uint8)


def reading_cell(settings: Settings, paths: Sequence[Path]) -> ReadingCell:
    """Read all files, in parts between which bare loops read some of them."""
    cores = len(machine.cores())
    some = list(paths[: settings.reading_files])
    ends = [len(paths) * turn // _TURNS for turn in range(_TURNS + 1)]
    parts = [Images.from_files(paths[first:last]) for first, last in pairwise(ends)]
    bare(some[:1])
    machine.reset_peak_memory()
    before = int(psutil.Process().memory_info().rss)
    ways: dict[str, Callable[[int], object]] = {
        "one_loop": lambda _: bare(some),
        "loops_at_once": lambda _: bare_at_once(some, cores),
        "ahead": lambda turn: deque(parts[turn - 1], maxlen=0),
    }
    laps = interleaved(ways, _TURNS, 0.0)
    n_read = {"one_loop": [len(some)] * _TURNS, "loops_at_once": [cores * len(some)] * _TURNS}
    n_read["ahead"] = [len(part) for part in parts]
    hz = {way: rounded(n / seconds for n, seconds in zip(n_read[way], each, strict=True)) for way, each in laps.items()}
    height, width = settings.frame
    peak = machine.peak_memory_bytes()
    return ReadingCell(
        height, width, len(paths), len(some), cores, **hz, memory_before_bytes=before, peak_memory_bytes=peak
    )


def bare(paths: Sequence[Path]) -> None:
    """Decode one file after the other."""
    for path in paths:
        read_image(path)


def bare_at_once(paths: Sequence[Path], loops: int) -> None:
    """Let so many threads decode all files each."""
    with ThreadPoolExecutor(loops) as threads:
        deque(threads.map(bare, [paths] * loops), maxlen=0)

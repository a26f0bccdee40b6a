"""The benchmark of frames: reading them from files, preprocessing a traverse once and again, and both engines."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from itertools import count
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
from vprbench.api.preprocess import Engine, PatchNormalisation
from vprbench.run import machine
from vprbench.run.stopwatch import Protocol, Stopwatch
from vprbench.speed.cells import Failed, PreprocessingCell, ReadingCell, attempt
from vprbench.speed.format import size
from vprbench.speed.measure import rounded
from vprbench.speed.route import Route
from vprbench.speed.settings import ENGINES, FRAME, PATCH, Bench, Settings

Asked = ParamSpec("Asked")
Answer = TypeVar("Answer")

_TURNS = 8  # of each way of reading
_LEVELS = ((64, 90.0), (16, 40.0), (4, 15.0))  # pixels of a cell, grey levels to either side
_NOISE = 3.0  # grey levels


def reading(bench: Bench) -> Iterator[ReadingCell | Failed]:
    """Read files."""
    settings = bench.settings
    frame = {"frame": size(*settings.frame)}
    with tempfile.TemporaryDirectory(prefix="vprbench-") as folder:
        paths = attempt(frame, partial(frame_files, settings, Path(folder)))
        if isinstance(paths, Failed):
            yield paths
            return
        progress.report(f"reading {len(paths)} files", 0.0)
        yield attempt(frame, partial(in_own_process, reading_cell, settings, paths))


def preprocessing(bench: Bench) -> Iterator[PreprocessingCell | Failed]:
    """Preprocess images in memory by both engines."""
    settings = bench.settings
    for height, width in (FRAME, tuple(settings.frame)):
        for images_per_call in (1, settings.batch):
            what = {"frame": size(height, width), "images a call": str(images_per_call)}
            yield attempt(what, partial(_preprocessing_cell, settings, height, width, images_per_call))


def _preprocessing_cell(settings: Settings, height: int, width: int, images_per_call: int) -> PreprocessingCell:
    progress.report(f"preprocessing, {size(height, width)}, {images_per_call} a call", 0.0)
    images, _ = Route.drawn(settings.batch, height, width, settings.seed).references(settings.batch, 1)
    parts = list(images.blocks(images_per_call))
    engines = {engine: PatchNormalisation("C", settings.pixels, settings.pixels, PATCH, engine) for engine in ENGINES}
    for normalise in engines.values():
        normalise(parts[0])
    watch = Stopwatch(Protocol())
    laps: dict[Engine, list[float]] = {engine: [] for engine in ENGINES}
    for turn in count(1):
        for engine, normalise in engines.items():
            with watch.lap() as lap:
                normalise(parts[turn % len(parts)])
            laps[engine] += lap
        if turn >= settings.rounds and sum(laps["readable"]) >= settings.minimum_seconds:
            break
    return PreprocessingCell(
        height, width, images_per_call, {engine: rounded(seconds) for engine, seconds in laps.items()}
    )


def in_own_process(measure: Callable[Asked, Answer], *arguments: Asked.args, **options: Asked.kwargs) -> Answer:
    """Return what is measured in a process that has done nothing else."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as process:
        return process.submit(measure, *arguments, **options).result()


def frame_files(settings: Settings, folder: Path) -> list[Path]:
    """Write the frames that are read; beyond so many different ones they are hard links to these."""
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
    hz: dict[str, list[float]] = {"one loop": [], "loops at once": [], "ahead": []}
    bare(some[:1])
    before = _memory_before()
    for turn in range(_TURNS):
        part = paths[len(paths) * turn // _TURNS : len(paths) * (turn + 1) // _TURNS]
        hz["one loop"].append(len(some) / _seconds(partial(bare, some)))
        hz["loops at once"].append(cores * len(some) / _seconds(partial(bare_at_once, some, cores)))
        hz["ahead"].append(len(part) / _seconds(partial(_look_at, Images.from_files(part))))
    height, width = settings.frame
    return ReadingCell(
        height,
        width,
        len(paths),
        len(some),
        cores,
        rounded(hz["one loop"]),
        rounded(hz["loops at once"]),
        rounded(hz["ahead"]),
        before,
        machine.peak_memory_bytes(),
    )


def bare(paths: Sequence[Path]) -> None:
    """Decode one file after the other."""
    for path in paths:
        read_image(path)


def bare_at_once(paths: Sequence[Path], loops: int) -> None:
    """Let so many threads decode all files each."""
    with ThreadPoolExecutor(loops) as threads:
        for _ in threads.map(bare, [paths] * loops):
            pass


def _look_at(images: Images) -> None:
    for _ in images:
        pass


def _seconds(call: Callable[[], object]) -> float:
    with Stopwatch(Protocol()).lap() as lap:
        call()
    return lap[0]


def _memory_before() -> int:
    machine.reset_peak_memory()
    return int(psutil.Process().memory_info().rss)

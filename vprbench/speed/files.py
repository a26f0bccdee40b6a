"""The benchmark of large datasets: what reading the names, positions and hashes of very many files takes."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from PIL import Image as PillowImage

from vprbench import progress
from vprbench.data.doctor import check_dataset
from vprbench.plugins import registry
from vprbench.runs import machine
from vprbench.runs.identity import data_record, fingerprint, hashed
from vprbench.speed.frames import drawn, in_own_process
from vprbench.speed.report import Planned, figures, megabytes
from vprbench.speed.settings import Bench, Settings

_SHOTS = 300  # different files; the others are hard links to these
_IN_A_FOLDER = 1000
_QUERIES = 1000
_METRES = 12_000.0  # side of the town
_BESIDE = 3.0  # metres to the east and north of a reference, where a query is
_PIXELS = 16
_SETTLED = 2.5  # seconds after which hashes of files are kept


@dataclass(frozen=True)
class FilesCell:
    """A dataset of `dataset=utm_folders` read from its folders, in a process of its own."""

    files: int
    time: str  # first: every file is hashed; second: what was hashed is known
    seconds: dict[str, float]  # of each step
    processor_seconds: float
    memory_before_bytes: int  # resident, with all libraries
    memory_after_bytes: int
    peak_memory_bytes: int  # what was resident before included

    def row(self) -> dict[str, str]:
        """Return the seconds of each step and of all, and the memory."""
        return {
            "files": f"{self.files:,}",
            "time": self.time,
            **{f"{step}: s": figures(seconds) for step, seconds in self.seconds.items()},
            "all: s": figures(sum(self.seconds.values())),
            "processor: s": figures(self.processor_seconds),
            "resident before MB": megabytes(self.memory_before_bytes),
            "after MB": megabytes(self.memory_after_bytes),
            "peak MB": megabytes(self.peak_memory_bytes),
        }


def listing(bench: Bench) -> Iterator[Planned]:
    """Read datasets of growing numbers of files, each twice."""
    for n_files in bench.settings.files:
        yield {"files": f"{n_files:,}"}, partial(_cells, bench.settings, n_files)


def _cells(settings: Settings, n_files: int) -> list[Any]:
    with tempfile.TemporaryDirectory(prefix="vprbench-") as folder:
        top = Path(folder)
        town(top, n_files, settings.seed)
        time.sleep(_SETTLED)
        return [in_own_process(files_cell, top, n_files, which) for which in ("first", "second")]


def town(top: Path, n_files: int, seed: int) -> None:
    """Make folders of as many references, with positions in their names, and of queries beside some of these."""
    random = np.random.default_rng(seed)
    shots = top / "shots"
    shots.mkdir()
    for number in range(min(n_files, _SHOTS)):
        PillowImage.fromarray(drawn(_PIXELS, _PIXELS, [seed, number])).save(shots / f"{number}.png")
    positions = random.uniform(0, _METRES, (n_files, 2))
    for part, taken in (("database", positions), ("queries", positions[:_QUERIES] + _BESIDE)):
        for number, (east, north) in enumerate(taken.tolist()):
            folder = top / part / f"{number // _IN_A_FOLDER:05}"
            if number % _IN_A_FOLDER == 0:
                folder.mkdir(parents=True)
                progress.report(f"files, {part}", number / len(taken))
            place = f"@{543_000 + east:010.2f}@{4_173_000 + north:010.2f}@10@S"
            shot = shots / f"{number % min(n_files, _SHOTS)}.png"
            os.link(shot, folder / f"{place}@@@{number:08}@@{number % 12 * 30}@@@@@@.png")


def files_cell(top: Path, n_files: int, which: str) -> FilesCell:
    """Read the dataset in `top` up to what identifies it; hashes are kept in `top`."""
    os.environ["VPRBENCH_HASHES"] = str(top / "hashes")
    dataset = {"_target_": "vprbench.datasets.utm_folders.utm_folders", "root": str(top)}
    registry.located("dataset", dataset, "utm_folders")  # with all that it imports
    machine.reset_peak_memory()
    process = psutil.Process()
    before, seconds = process.memory_info().rss, dict[str, float]()
    times = process.cpu_times()
    made: list[Any] = []
    steps: dict[str, Callable[[], object]] = {
        "names and positions": lambda: registry.make_dataset(dataset),
        "checks": lambda: check_dataset(made[0]),
        "hashes": lambda: hashed(made[0]),
        "fingerprint": lambda: (fingerprint(made[0], made[2]), data_record(made[0], made[2])),
    }
    for step, call in steps.items():
        started = time.perf_counter()
        made.append(call())
        seconds[step] = time.perf_counter() - started
    now = process.cpu_times()
    busy = now.user + now.system - times.user - times.system
    after = process.memory_info().rss
    return FilesCell(n_files, which, seconds, busy, before, after, machine.peak_memory_bytes())

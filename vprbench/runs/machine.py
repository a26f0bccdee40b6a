"""The machine and software under a run: captured for the record, threads pinned, load observed."""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import platform
import re
import subprocess
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from vprbench.storage.cores import count_cores
from vprbench.storage.folders import checkout_folder

_LIBRARIES = ("torch", "numpy", "scipy", "numba", "opencv-python-headless", "pillow", "scikit-learn", "faiss-cpu")


def describe_machine(device: str, threads: int) -> dict[str, Any]:
    """Return processor, memory, accelerator, libraries, git state and load, as plain values."""
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": read_processor_name(),
        "cores": count_cores(),
        "memory_bytes": psutil.virtual_memory().total,
        "threads": threads,
        "accelerator": _find_accelerator(device),
        "vprbench": _read_version("vprbench"),
        "libraries": list_library_versions(),
        "git": _read_git_state(),
        "load_average": list(psutil.getloadavg()),
        "time_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
    }


@dataclass(frozen=True)
class Machine:
    """The hardware, threads and torch that the times of a run depend on."""

    processor: str | None
    cores: int | None
    accelerator: str | None
    threads: int | None  # that the run might use
    torch: str | None  # its version

    @classmethod
    def of(cls, environment: Mapping[str, Any]) -> Machine:
        """Return the machine of an `environment`; None for parts that it lacks."""
        parts = {name: environment.get(name) for name in ("processor", "cores", "accelerator", "threads")}
        return cls(**parts, torch=(environment.get("libraries") or {}).get("torch"))

    @property
    def hardware(self) -> tuple[str | None, int | None, str | None]:
        """Processor, cores and accelerator, without threads and libraries."""
        return self.processor, self.cores, self.accelerator

    @property
    def line(self) -> str:
        """The machine in one line for people."""
        accelerator = f", {self.accelerator}" if self.accelerator else ""
        return f"{self.processor}, {self.threads} of {self.cores} cores{accelerator}, torch {self.torch}"


def list_library_versions() -> dict[str, str | None]:
    """Return the versions of the libraries that compute, None for those that are not installed."""
    return {name: _read_version(name) for name in _LIBRARIES}


def pin_threads(threads: int) -> None:
    """Limit torch, OpenCV, OpenMP and BLAS to `threads` each, in this process and those it starts."""
    import cv2
    import torch
    from threadpoolctl import threadpool_limits

    for variable in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ[variable] = str(threads)
    torch.set_num_threads(threads)
    cv2.setNumThreads(threads)
    threadpool_limits(threads)


def read_processor_name() -> str:
    """Return the processor's model name."""
    return _find_in_file(r"^model name\s*: *(.+)", "/proc/cpuinfo") or platform.processor() or platform.machine()


def classify_device(device: str) -> str:
    """Return the kind of device and its model, in which stored times are comparable."""
    kind = device.partition(":")[0]
    return f"{kind} {read_processor_name() if kind == 'cpu' else _find_accelerator(device)}"


def format_versions(environment: Mapping[str, Any]) -> str:
    """Return the versions of vprbench, its commit, Python and the libraries."""
    git = environment.get("git") or {}
    changed = " with changes" if git.get("changed") else ""
    versions = {"vprbench": environment.get("vprbench"), "commit": f"{git['commit'][:12]}{changed}" if git else None}
    versions |= {"Python": environment.get("python"), **environment.get("libraries", {})}
    return ", ".join(f"{name} {version}" for name, version in versions.items() if version)


def read_cpu_wait_seconds() -> float | None:
    """Return the seconds since the system started in which some process waited for a core; None if not known.

    Source: Linux's pressure stall information.
    """
    microseconds = _find_in_file(r"^some .*total=(\d+)", "/proc/pressure/cpu")
    return None if microseconds is None else int(microseconds) / 1e6


def time_canary(clock: Callable[[], int] = time.perf_counter_ns) -> float:
    """Return the median time of a fixed numpy computation; a change between two calls shows a disturbed machine."""
    values = np.linspace(1, 0, 50_000)
    scratch = np.empty_like(values)  # allocating anew would time the operating system
    laps = []
    for _ in range(20):
        start = clock()
        np.sqrt(values, out=scratch)
        scratch.sort()
        laps.append(clock() - start)
    return float(np.median(laps[5:])) / 1e9  # the first ones warm up


def reset_peak_memory() -> None:
    """Start a new window for the peak of memory; where the system forbids it the process's start remains."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def measure_peak_memory() -> int:
    """Return the largest resident memory of this process in the window."""
    kibibytes = _find_in_file(r"^VmHWM:\s*(\d+)", "/proc/self/status")
    return int(psutil.Process().memory_info().rss) if kibibytes is None else int(kibibytes) * 1024


def _find_accelerator(device: str) -> str | None:
    """Return the model of a GPU; None for a CPU, and for a GPU that is not there."""
    if not device.startswith("cuda"):
        return None
    import torch

    there = int(device.partition(":")[2] or 0) < torch.cuda.device_count()
    return torch.cuda.get_device_name(device) if there else None


def _read_version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None


def _read_git_state() -> dict[str, Any] | None:
    """Return the commit of the checkout this package runs from, and whether it was changed."""
    root = checkout_folder()
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        state = subprocess.run(command, capture_output=True, text=True, timeout=10, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None
    return {"commit": state.removesuffix("-dirty"), "changed": state.endswith("-dirty")}


def _find_in_file(pattern: str, path: str) -> str | None:
    """Return the group of the first line of a file that a pattern matches; None without such a line or file."""
    with contextlib.suppress(OSError):
        found = re.search(pattern, Path(path).read_text(encoding="utf-8"), re.MULTILINE)
        return None if found is None else found[1]
    return None

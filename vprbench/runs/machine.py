"""The machine and software under a run: captured for the record, threads pinned, load observed."""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import platform
import re
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import psutil

from vprbench.storage.cores import core_count
from vprbench.storage.folders import checkout_folder

_LIBRARIES = ("torch", "numpy", "scipy", "numba", "opencv-python-headless", "pillow", "scikit-learn", "faiss-cpu")


def describe_machine(device: str, threads: int) -> dict[str, Any]:
    """Return processor, memory, accelerator, libraries, git state and load, as plain values."""
    pressure = read_cpu_pressure()
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": processor(),
        "cores": core_count(),
        "governor": _read("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor"),
        "memory_bytes": psutil.virtual_memory().total,
        "threads": threads,
        "device": device,
        **_describe_accelerator(device),
        "vprbench": _read_version("vprbench"),
        "libraries": library_versions(),
        "git": _read_git_state(),
        "load_average": list(psutil.getloadavg()),
        "cpu_pressure_avg10": None if pressure is None else pressure.percent,
        "time_utc": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "command": sys.argv,
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


def library_versions() -> dict[str, str | None]:
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


def processor() -> str:
    """Return the processor's model name."""
    for line in _read("/proc/cpuinfo").splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def device_class(device: str) -> str:
    """Return the kind of device and its model, in which stored times are comparable."""
    kind = device.partition(":")[0]
    return f"{kind} {processor() if kind == 'cpu' else _describe_accelerator(device)['accelerator']}"


def format_software(environment: Mapping[str, Any]) -> str:
    """Return libraries, source and time in one line."""
    git = environment["git"]
    libraries = ", ".join(f"{name} {version or 'missing'}" for name, version in environment["libraries"].items())
    source = "no checkout" if git is None else f"{git['commit']}{', changed' * git['changed']}"
    return (
        f"python {environment['python']}, vprbench {environment['vprbench']}, {libraries}. Source: {source}. "
        f"{environment['time_utc']}."
    )


class CpuPressure(NamedTuple):
    """How long some process waited for a core."""

    percent: float  # of the last 10 s
    seconds: float  # since the system started


def read_cpu_pressure() -> CpuPressure | None:
    """Return Linux's pressure stall information of the cores; None on a system without it."""
    some = re.match(r"some avg10=(\S+) .*total=(\d+)", _read("/proc/pressure/cpu"))
    return None if some is None else CpuPressure(float(some[1]), int(some[2]) / 1e6)


def canary_seconds(clock: Callable[[], int] = time.perf_counter_ns) -> float:
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


def reset_peak_memory(device: str = "cpu") -> None:
    """Start a new window for the peaks of memory; where the system forbids it the process's start remains."""
    with contextlib.suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    if device.startswith("cuda"):
        import torch

        torch.cuda.reset_peak_memory_stats(device)


def peak_memory_bytes() -> int:
    """Return the largest resident memory of this process in the window."""
    for line in _read("/proc/self/status").splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024
    return int(psutil.Process().memory_info().rss)


def peak_device_memory_bytes(device: str) -> int | None:
    """Return the most memory that was in use on an accelerator in the window, None on a CPU."""
    if not device.startswith("cuda"):
        return None
    import torch

    return int(torch.cuda.max_memory_allocated(device))


def _describe_accelerator(device: str) -> dict[str, Any]:
    if not device.startswith("cuda"):
        return {}
    import torch

    if torch.cuda.device_count() <= int(device.partition(":")[2] or 0):
        return {}  # of a run that failed for want of it
    return {
        "accelerator": torch.cuda.get_device_name(device),
        "accelerator_memory_bytes": torch.cuda.get_device_properties(device).total_memory,
        "cuda": torch.version.cuda,
        "driver": _run_command("nvidia-smi", "--query-gpu=driver_version", "--format=csv,noheader"),
    }


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
    commit = _run_command("git", "-C", str(root), "rev-parse", "HEAD")
    changed = _run_command("git", "-C", str(root), "status", "--porcelain", "--untracked-files=no")
    return {"commit": commit or None, "changed": bool(changed)}


def _run_command(*command: str) -> str:
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=10, check=False).stdout.strip()
    except (OSError, subprocess.TimeoutExpired):
        return ""


def _read(path: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8").strip()
    except OSError:
        return ""

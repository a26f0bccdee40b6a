"""Measured joules of a query: counters of processor and GPU read at both ends, idle power subtracted."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

POWERCAP = Path("/sys/class/powercap")
_SECONDS = 2.0  # of rest, and at least of queries; counters move every 1 to 100 ms


class UnreadableError(Exception):
    """No counter of energy can be read; the message says why."""


class Meter(Protocol):
    """Counts joules; `source` says of what, and by what."""

    source: str

    def joules(self) -> float:
        """Return the joules since it was made."""


class Rapl:
    """The counters of Linux's powercap: processor packages and memory, whatever runs on them."""

    def __init__(self, root: Path = POWERCAP) -> None:
        """Find the counters; raises UnreadableError where there is none, or where they may not be read."""
        try:  # domains that do not lie within one another
            names = {zone: (zone / "name").read_text().strip() for zone in sorted(root.glob("*-rapl*:*"))}
            self._zones = [zone for zone, name in names.items() if name.startswith(("package", "dram"))]
            self._last = {zone: _number(zone / "energy_uj") for zone in self._zones}
            self._ranges = {zone: _number(zone / "max_energy_range_uj") for zone in self._zones}
        except (OSError, ValueError) as error:
            raise UnreadableError(f"RAPL cannot be read in {root} ({getattr(error, 'strerror', error)})") from None
        if not self._zones:
            raise UnreadableError(f"{root} has no RAPL counter")
        self._microjoules = 0
        self.source = f"RAPL {', '.join(names[zone] for zone in self._zones)}"

    def joules(self) -> float:
        """Return the joules since it was made; asked before a counter wraps around twice, it misses none."""
        for zone in self._zones:
            now = _number(zone / "energy_uj")
            self._microjoules += (now - self._last[zone]) % self._ranges[zone]
            self._last[zone] = now
        return self._microjoules / 1e6


class Nvml:
    """The energy counter of an NVIDIA GPU (Volta and later), whatever runs on it."""

    source = "NVML"

    def __init__(self, uuid: str) -> None:
        """Find the GPU; raises UnreadableError where its driver has no counter."""
        self._gpu, self._first = ctypes.c_void_p(), 0.0
        try:
            self._library = ctypes.CDLL("libnvidia-ml.so.1")
            self._call("Init_v2")
            self._call("DeviceGetHandleByUUID", f"GPU-{uuid}".encode(), ctypes.byref(self._gpu))
            self._first = self.joules()
        except (OSError, AttributeError) as error:
            raise UnreadableError(f"NVML cannot be read ({error})") from None

    def joules(self) -> float:
        """Return the joules since it was made."""
        millijoules = ctypes.c_ulonglong()
        self._call("DeviceGetTotalEnergyConsumption", self._gpu, ctypes.byref(millijoules))
        return millijoules.value / 1e3 - self._first

    def _call(self, name: str, *arguments: object) -> None:
        if code := getattr(self._library, f"nvml{name}")(*arguments):
            raise OSError(f"nvml{name} gave {code}")


def meter(device: str) -> Meter:
    """Return what counts the joules of a device, the GPU alone or processor and memory; raises UnreadableError."""
    if not device.startswith("cuda"):
        return Rapl()
    import torch

    return Nvml(str(torch.cuda.get_device_properties(device).uuid))


@dataclass(frozen=True)
class Measured:
    """What queries took."""

    joules: float  # a query, less what the machine takes at rest
    idle_watts: float
    watts: float
    queries: int
    seconds: float


def measured(
    meter: Meter,
    ask: Callable[[], None],
    finished: Callable[[], None],
    clock: Callable[[], float] = time.perf_counter,
    sleep: Callable[[float], None] = time.sleep,
) -> Measured:
    """Measure a rest of 2 s, then queries for at least as long; `ask` asks one, `finished` waits for the device."""
    ask()
    finished()
    before, began = meter.joules(), clock()
    sleep(_SECONDS)
    rested, woke = meter.joules(), clock()
    idle, asked = (rested - before) / (woke - began), 0
    while clock() - woke < _SECONDS or not asked:
        ask()
        asked += 1
    finished()
    spent, seconds = meter.joules() - rested, clock() - woke
    return Measured((spent - idle * seconds) / asked, idle, spent / seconds, asked, seconds)


def _number(path: Path) -> int:
    return int(path.read_text())

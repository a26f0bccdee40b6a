"""Measured joules of a query: a counter of processor or GPU read at both ends, idle power subtracted."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

POWERCAP = Path("/sys/class/powercap")
_SECONDS = 2.0  # of rest, and at least of queries; counters move every 1 to 100 ms

Joules = Callable[[], float]  # since an arbitrary moment


class UnreadableError(Exception):
    """No counter of energy can be read; the message says why."""


def rapl(root: Path) -> tuple[str, Joules]:
    """Return the sum of the counters of Linux's powercap, right if asked before one wraps around a second time.

    They count whatever runs there. Raises UnreadableError where there is none, or where they may not be read.
    """
    try:  # domains that do not lie within one another
        names = {zone: (zone / "name").read_text().strip() for zone in sorted(root.glob("*-rapl*:*"))}
        zones = [zone for zone, name in names.items() if name.startswith(("package", "dram"))]
        ranges = [int((zone / "max_energy_range_uj").read_text()) for zone in zones]
        last = [int((zone / "energy_uj").read_text()) for zone in zones]
    except (OSError, ValueError) as error:
        raise UnreadableError(f"RAPL cannot be read in {root} ({getattr(error, 'strerror', error)})") from None
    if not zones:
        raise UnreadableError(f"{root} has no RAPL counter")
    microjoules = 0

    def joules() -> float:
        nonlocal last, microjoules
        now = [int((zone / "energy_uj").read_text()) for zone in zones]
        microjoules += sum((new - old) % most for new, old, most in zip(now, last, ranges, strict=True))
        last = now
        return microjoules / 1e6

    return f"RAPL {', '.join(names[zone] for zone in zones)}", joules


def nvml(device: str) -> tuple[str, Joules]:
    """Return the energy counter of an NVIDIA GPU (Volta and later); raises UnreadableError where it has none."""
    import torch

    gpu, millijoules = ctypes.c_void_p(), ctypes.c_ulonglong()

    def call(name: str, *arguments: object) -> None:
        if code := getattr(library, f"nvml{name}")(*arguments):
            raise OSError(f"nvml{name} gave {code}")

    def joules() -> float:
        call("DeviceGetTotalEnergyConsumption", gpu, ctypes.byref(millijoules))
        return millijoules.value / 1e3

    try:
        library = ctypes.CDLL("libnvidia-ml.so.1")
        call("Init_v2")
        uuid = torch.cuda.get_device_properties(device).uuid  # numbers of devices may differ from the driver's
        call("DeviceGetHandleByUUID", f"GPU-{uuid}".encode(), ctypes.byref(gpu))
        joules()
    except (OSError, AttributeError) as error:
        raise UnreadableError(f"NVML cannot be read ({error})") from None
    return "NVML", joules


def measured(
    joules: Joules,
    ask: Callable[[], Any],
    clock: Joules = time.perf_counter,
    sleep: Callable[[float], None] = time.sleep,
) -> dict[str, float]:
    """Return what a query takes beyond the idle machine; `ask` asks one, and waits for the device.

    After a rest of 2 s queries follow one another for as long, or for as long as one takes.
    """
    ask()
    before, began = joules(), clock()
    sleep(_SECONDS)
    rested, woke = joules(), clock()
    idle, asked = (rested - before) / (woke - began), 0
    while clock() - woke < _SECONDS or not asked:
        ask()
        asked += 1
    spent, seconds = joules() - rested, clock() - woke
    each = (spent - idle * seconds) / asked
    return {"joules": each, "watts": spent / seconds, "idle_watts": idle, "queries": asked, "seconds": seconds}

"""The machine beside a run, before and after it: other runs, load and the peak of memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from vprbench import progress
from vprbench.runs import machine, timing_lock


class MachineWatch:
    """Looks at the machine when it is made, and again whenever `environment` is asked for."""

    def __init__(self, device: str, threads: int) -> None:
        """Look for the first time; the peak of memory counts from now on."""
        self._device = device
        self._undisturbed = timing_lock.undisturbed()
        self._before = machine.describe_machine(device, threads)
        self._canary_seconds = machine.canary_seconds()
        self._peaks: list[tuple[int, int | None]] = []
        self._alone: bool | None = None  # whether it was timed alone; None: it was not timed
        self._waited: tuple[float, float] | None = None
        machine.reset_peak_memory(device)

    def end_fit(self) -> None:
        """Note whether the method was fitted, and asked for the first time, while no other run went on here."""
        self._before |= {"fitted_alone": self._undisturbed()}

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Wait until no other run goes on here; if others did until now, look as if for the first time."""
        was_alone = self._undisturbed()
        if not was_alone:
            progress.report("waiting to be timed", 0.0)
        with timing_lock.alone():
            self._alone = True
            if not was_alone:
                self._canary_seconds, self._waited = machine.canary_seconds(), machine.cpu_waited()
            machine.reset_peak_memory(self._device)
            yield

    def record(self) -> dict[str, Any]:
        """Return the fields `environment` and `peak_memory_bytes` of a run that ends now."""
        after: dict[str, Any] = {
            "canary_slowdown": machine.canary_seconds() / self._canary_seconds,
            "cpu_pressure_avg10_after": machine.cpu_pressure(),
        }
        if self._alone is not None:
            after["timed_alone"] = self._alone
        if self._waited is not None:
            after["cpu_pressure_timed"] = machine.cpu_pressure_since(self._waited)
        self._peaks.append((machine.peak_memory_bytes(), machine.peak_device_memory_bytes(self._device)))
        host, on_device = zip(*self._peaks, strict=True)
        after["device_memory_bytes"] = max((peak for peak in on_device if peak is not None), default=None)
        return {"environment": {**self._before, **after}, "peak_memory_bytes": max(host)}

"""The machine beside a run, before and after it: other runs, load and the peak of memory."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from vprbench import progress
from vprbench.runs import machine
from vprbench.runs.timing_lock import TimingLock


class MachineWatch:
    """Looks at the machine when it is made, when timing begins, and in `record`; for a process that computes."""

    def __init__(self, device: str, threads: int, lock: TimingLock) -> None:
        """Look for the first time; the peak of memory counts from now on."""
        self._lock, self._was_alone = lock, lock.is_only_run()
        self._environment = machine.describe_machine(device, threads)
        machine.reset_peak_memory()
        self._begin_watching()

    def _begin_watching(self) -> None:
        """Look at the load from now on."""
        self._canary_seconds = machine.time_canary()
        self._began, self._pressure = time.perf_counter(), machine.read_cpu_wait_seconds()

    def end_fit(self) -> None:
        """Record whether another run went on here when this one began, or goes on now that its method is fitted."""
        self._environment |= {"fitted_alone": self._was_alone and self._lock.is_only_run()}

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Wait until no other run goes on here, and look at the load from then on."""
        if not self._lock.is_only_run():
            progress.report("waiting to be timed", 0.0)
        with self._lock.hold_alone():
            self._environment |= {"timed_alone": True}
            self._begin_watching()
            yield

    def record(self) -> dict[str, Any]:
        """Return the fields `environment` and `peak_memory_bytes` of a run that ends now."""
        now, waited = machine.read_cpu_wait_seconds(), None
        if now is not None and self._pressure is not None:
            seconds = max(time.perf_counter() - self._began, 1e-9)
            waited = 100 * (now - self._pressure) / seconds
        after = {
            "canary_slowdown": machine.time_canary() / self._canary_seconds,
            "cpu_waited_percent": waited,
        }
        return {"environment": {**self._environment, **after}, "peak_memory_bytes": machine.measure_peak_memory()}

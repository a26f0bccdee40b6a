"""A clock that only tests move, in place of those by which runs are timed, and reading that waits to be waited for."""

import threading
from functools import partial
from types import SimpleNamespace

from vprbench.runs.stopwatch import Stopwatch


class Clock:
    """Stands still until somebody spends time; any thread may."""

    def __init__(self):
        self.now = 0  # nanoseconds
        self._one_at_a_time = threading.Lock()

    def __call__(self):
        return self.now

    def seconds(self):
        return self.now / 1e9

    def spend(self, seconds):
        with self._one_at_a_time:
            self.now += round(seconds * 1e9)

    def replaces_those_of(self, modules, patch):
        """Let modules take the time from this clock, themselves and by the stopwatches that they make."""
        clock = self

        class Stopped(Stopwatch):
            def __init__(self, protocol, **options):
                super().__init__(protocol, clock, **options)

        for module in modules:
            if hasattr(module, "time"):
                patch.setattr(module, "time", SimpleNamespace(perf_counter=self.seconds))
            if hasattr(module, "Stopwatch"):
                patch.setattr(module, "Stopwatch", Stopped)


class ReadersThatWait:
    """In place of a pool of threads: does what it was asked for when the answer is waited for, and not before."""

    def __init__(self, workers):
        self.workers = workers

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.shutdown()

    def submit(self, call, *arguments):
        return SimpleNamespace(result=partial(call, *arguments))

    def shutdown(self, cancel_futures=False):
        """Nothing is under way."""

"""Work on many modules by all threads that PyTorch may use, with its progress and an end when it is interrupted."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from typing import Self, TypeVar

import torch

from vprbench.api import progress

_LOOK_SECONDS = 0.5  # from one report of the progress to the next
Result = TypeVar("Result")
Tell = Callable[[float], None]  # the share of one module that is done, 0 to 1


@dataclass(frozen=True)
class Stage:
    """A stretch of the progress called `name`, from share `begin` to share `end`; None: nothing is reported."""

    name: str | None = None
    begin: float = 0.0
    end: float = 1.0

    def report(self, share: float) -> None:
        """Report that a share of the stretch is done, 0 to 1."""
        if self.name is not None:
            progress.report(self.name, self.begin + (self.end - self.begin) * share)

    def part(self, begin: float, end: float) -> Self:
        """Return the stretch from one share of this one to another."""
        span = self.end - self.begin
        return replace(self, begin=self.begin + span * begin, end=self.begin + span * end)


class _InterruptedError(Exception):
    """Another module failed, or somebody pressed Ctrl-C."""


def for_each_module(work: Callable[[int, Tell], Result], n_modules: int, stage: Stage) -> list[Result]:
    """Return the result of `work` for each module, in order.

    Raises the error of the first module that fails; the others end when they next tell their share.
    """
    shares = [0.0] * n_modules
    stopped = threading.Event()

    def work_on(module: int) -> Result:
        def tell(share: float) -> None:
            shares[module] = share
            if stopped.is_set():
                raise _InterruptedError

        return work(module, tell)

    threads = min(torch.get_num_threads(), n_modules)
    stage.report(0.0)
    if threads < 2 and stage.name is None:
        return [work_on(module) for module in range(n_modules)]
    with ThreadPoolExecutor(max(1, threads)) as pool:
        futures = [pool.submit(work_on, module) for module in range(n_modules)]
        try:
            left = set(futures)
            while left:
                done, left = wait(left, _LOOK_SECONDS, FIRST_COMPLETED)
                for future in done:
                    future.result()
                stage.report(sum(shares) / n_modules)
        except BaseException:
            stopped.set()
            pool.shutdown(wait=True, cancel_futures=True)
            raise
    return [future.result() for future in futures]

"""How much memory something takes, measured in a process of its own: one that ran other tests has memory at hand."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
import psutil
from little import Lookup, journey
from little_runs import run_of, table


def in_a_new_process(measure):
    """Return what a function of this module measures in a process that has done nothing before."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("forkserver")) as pool:
        return pool.submit(measure).result()


@dataclass
class Large(Lookup):
    """Holds 200 MB while it learns, and remembers what was resident before."""

    resident_bytes: int = 0

    def fit(self, references, places):
        self.resident_bytes = psutil.Process().memory_info().rss
        np.ones(200_000_000, np.uint8)
        return self


def peaks_of_runs():
    """Return the resident bytes before a run holds 200 MB, its peak, and the peak of a run after it that holds none."""
    method = Large(table(6, 4))
    large = run_of(method, journey(6, 4)).peak_memory_bytes
    return method.resident_bytes, large, run_of(Lookup(table(6, 4)), journey(6, 4)).peak_memory_bytes

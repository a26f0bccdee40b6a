"""One index on one map, built and asked in a process of its own, whose memory is looked at from outside."""

from __future__ import annotations

import ctypes
import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from vprbench.api.search import Search
from vprbench.errors import BadInput
from vprbench.speed.measure import interleaved, median
from vprbench.speed.simulated import Vectors
from vprbench.storage.shards import Shards

BEST = 10  # places that are asked for

_FEWEST = 3  # queries asked alone that a median is taken of
_SMALL = 1000  # places
_LOOK_EVERY = 0.01  # seconds between looks at the process


@dataclass(frozen=True)
class Case:
    """What to search by which index, and what to ask it."""

    vectors: Shards
    index: str
    rerank: int  # best images of the index that are compared again, exactly; 0: none
    queries: Vectors
    minimum_seconds: float  # of each rate


def searched(case: Case, limit_seconds: float) -> dict[str, Any]:
    """Build and ask an index in a process of its own, which ends with this one.

    Returns "found", the best places of each query (n_queries, 10); seconds of building, of one query alone and of one
    of a batch; bytes of the index a place; bytes of memory that no file backs, at most: while the libraries come, while
    it builds and while it answers (None where the system does not tell); and how many cores other work kept busy.
    Raises what the index raises, and BadInput if it takes longer than `limit_seconds` or ends without an answer.
    """
    here, there = get_context("spawn").Pipe()
    child = get_context("spawn").Process(target=_search, args=(there, case), daemon=True)
    started, busy = time.monotonic(), _busy_seconds()
    child.start()
    there.close()
    told: dict[str, Any] = {}
    try:
        for stage in ("libraries", "building", "answering"):
            peak = 0
            while True:
                peak = max(peak, _anonymous_bytes(child.pid))
                if here.poll(_LOOK_EVERY):
                    break
                if time.monotonic() - started > limit_seconds:
                    raise BadInput(f"{stage} was not done after limit_minutes={limit_seconds / 60:g}")
            if isinstance(word := here.recv(), Exception):
                raise word
            told |= {**word, f"{stage}_bytes": peak or None}
    except EOFError as error:
        child.join()
        code = child.exitcode or 0
        how = f"with exit code {code}" if code >= 0 else f"by signal {-code} ({signal.Signals(-code).name})"
        raise BadInput(f"its process was ended {how} while {stage}") from error
    finally:
        child.kill()
        child.join()
    others = _busy_seconds() - busy - told.pop("processor_seconds")
    return {**told, "others": max(0.0, others / (time.monotonic() - started))}


def _search(there: Connection, case: Case) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG
    try:
        for told in _told(case):
            there.send(told)
    except Exception as error:
        there.send(error)


def _told(case: Case) -> Iterator[dict[str, Any]]:
    """Yield nothing once a small map has loaded and compiled all it needs, then what building and answering tell."""
    small = _built(case, Shards.of(case.vectors[:_SMALL]))
    for queries in (case.queries[:1], case.queries):
        small.nearest(queries, BEST)
    del small
    yield {}
    started = time.perf_counter()
    search = _built(case, case.vectors)
    building_seconds = time.perf_counter() - started
    yield {"building_seconds": building_seconds, "bytes_per_place": search.bytes_per_place}
    _, found = search.nearest(case.queries, BEST)

    def median_seconds(call: Callable[[int], object], fewest: int) -> float:
        return median(interleaved({"": call}, fewest, case.minimum_seconds)[""])

    n = len(case.queries)
    one = median_seconds(lambda turn: search.nearest(case.queries[turn % n :][:1], BEST), _FEWEST)
    batch = median_seconds(lambda _: search.nearest(case.queries, BEST), 1) / n
    seconds = {"query_seconds": one, "batch_seconds": batch, "processor_seconds": time.process_time()}
    yield {"found": found, **seconds}


def _built(case: Case, vectors: Shards) -> Search:
    return Search(vectors, np.arange(len(vectors)), case.index, rerank=case.rerank)  # type: ignore[arg-type]  # it is checked


def _anonymous_bytes(number: int | None) -> int:
    """Return the memory of a process that no file backs; 0 if the system does not tell."""
    try:
        status = Path(f"/proc/{number}/status").read_text(encoding="ascii")
    except OSError:
        return 0
    return next((1024 * int(line.split()[1]) for line in status.splitlines() if line.startswith("RssAnon")), 0)


def _busy_seconds() -> float:
    """Return the seconds in which cores have worked since the machine started."""
    times = psutil.cpu_times()
    return float(sum(times) - times.idle - sum(getattr(times, name, 0.0) for name in ("iowait", "guest", "guest_nice")))

"""Rows of arrays shared among threads."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np


def in_shares(work: Callable[[slice], None], n: int, threads: int, shares: int = 1) -> None:
    """Call `work` with slices that make up 0 to `n`: `shares` of them a thread, whoever is ready first takes the next.

    Without threads to share with there is one slice, and none of nothing. Raises what `work` raises.
    """
    count = min(threads * shares, n) if threads > 1 else min(n, 1)
    parts = [slice(*ends) for ends in pairwise(np.linspace(0, n, count + 1).astype(int).tolist())]
    if count < 2:
        for part in parts:
            work(part)
        return
    with ThreadPoolExecutor(min(threads, count)) as pool:
        list(pool.map(work, parts))
